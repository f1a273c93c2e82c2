"""Checks of the graph's nodes and links: known names, no link to an absent node."""

from __future__ import annotations

import difflib
from collections.abc import Iterator

from xitl_cli.errors import UserError
from xitl_cli.profile.files.catalogue import find_profile
from xitl_cli.profile.files.entry import KeyPath, dotted, finding, shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.graph import COMPLETE, MEANINGS, architecture, is_node_name


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield unknown nodes, links to absent nodes, too few vertices, and an unknown reference."""
    if profile.graph is None:
        return
    nodes = profile.graph.nodes
    for name, node in nodes.items():
        path = ("graph", "nodes", name)
        if not is_node_name(name):
            yield path, f"{dotted(path)} is not a node; {_suggestion(name)}"
        elif node.kind is None:
            yield path, f"{dotted(path)} needs 'kind'; add it"
        elif node.kind == "absent" and node.weight:
            sentence = f"{dotted(path)}.weight = {node.weight:g} is for an absent node; use kind: real or virtual"
            yield (*path, "weight"), sentence
    for name, others in profile.graph.links.items():
        path = ("graph", "links", name)
        yield from _link_end(profile, name, path, dotted(path))
        for number, other in enumerate(others):
            yield from _link_end(profile, other, (*path, number), f"{dotted(path)}: {shown(other)}")
    reference = profile.graph.reference
    if reference not in (None, COMPLETE):
        try:
            find_profile(reference)
        except (UserError, ValueError, OSError) as error:
            yield finding("graph.reference", f"= {shown(reference)}: {error}")
    weighty = sum(node.kind != "absent" and node.weight != 0 for node in nodes.values())
    vertices = profile.graph.vertices
    if isinstance(vertices, int) and vertices < weighty:
        yield finding(
            "graph.vertices", f"= {vertices} is fewer than the {weighty} nodes present; use {weighty} or more"
        )


def _link_end(profile: Profile, name: str, path: KeyPath, where: str) -> Iterator[tuple[KeyPath, str]]:
    assert profile.graph is not None
    node = profile.graph.nodes.get(name)
    if not is_node_name(name):
        yield path, f"{where} is not a node; {_suggestion(name)}"
    elif node is None or node.kind == "absent":
        yield (
            path,
            f"{where} is an absent node; remove the link, or set graph.nodes.{name}.kind to real or virtual "
            "(with weight: 0 if only its links count)",
        )


def _suggestion(name: str) -> str:
    if name == "PS":
        return "number the simulators: PS1, PS2, ..."
    close = difflib.get_close_matches(name.upper(), [*MEANINGS, "PS1"], n=1)
    hint = f"did you mean {close[0]!r}? " if close and is_node_name(close[0]) else ""
    return f"{hint}the nodes are {', '.join(architecture())} (PS2, PS3, ... for more simulators)"
