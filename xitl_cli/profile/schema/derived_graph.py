"""The node graph that follows from what a profile composes: one entry for each part of a run that brings nodes.

A profile's `graph` group holds only what differs from it. A new part of a run is a function here and a row of `_PARTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Literal, Protocol
from urllib.parse import urlsplit

from xitl_cli.profile.schema.graph import COMPLETE, Node, NodeGraph, architecture

if TYPE_CHECKING:
    from xitl_cli.profile.schema.agents import AutopilotSpec, CompanionSpec, DriverSpec

REFERENCE = "paper/eq24-general-use"
"""Default reference of a profile that can run."""

THIS_MACHINE = "this machine"
_HERE = ("127.0.0.1", "localhost", "::1")
_PROGRAMS = {"ardupilot": "ardurover", "px4": "PX4", "other": "autopilot"}
_ORDERS = {
    "mission": "uploads the mission and starts it",
    "ground-station": "a person at a ground station gives the orders",
    "script": "plays a timed script",
    "replay": "plays recorded motor outputs",
    "follow": "keeps a position relative to another vessel",
    "ros": "ROS nodes give the orders",
}


class ProfileGroups(Protocol):
    """The groups of a profile that a graph follows from."""

    @property
    def driver(self) -> DriverSpec | None: ...
    @property
    def vehicle(self) -> object | None: ...
    @property
    def autopilot(self) -> AutopilotSpec | None: ...
    @property
    def companion(self) -> CompanionSpec | None: ...
    @property
    def graph(self) -> NodeGraph | None: ...
    def missing_for_run(self) -> tuple[str, ...]: ...


Part = Iterator[tuple[str, Node, tuple[str, ...]]]
"""Nodes of one part of a run, each with its links; a link to a node that is not there is left out."""


def _driver(profile: ProfileGroups) -> Part:
    if profile.driver is None or profile.driver.kind == "none":
        return
    orders = _ORDERS.get(profile.driver.kind, "a driver of another package gives the orders")
    if _autopilot_kind(profile) == "none":
        does = "steers the mission from the true state" if profile.driver.kind == "mission" else orders
        yield "D", _node(does), ("PS1", "M")  # motor commands to the vessel and into the recording
    else:
        yield "D", _node(orders), ("LC",)  # mission and commands


def _simulator(profile: ProfileGroups) -> Part:
    if profile.vehicle is None:
        return
    senses = _autopilot_kind(profile) != "none"
    does = "simulates vessel, surroundings and sensors" if senses else "simulates vessel and surroundings"
    # sensors out, motor commands in, clouds and pings out, truth to the recording
    yield "PS1", _node(does), ("LS", "LA", "HS", "M")


def _autopilot(profile: ProfileGroups) -> Part:
    autopilot = profile.autopilot
    if autopilot is None or autopilot.kind == "none":
        return
    kind, runs_on = _autopilot_place(autopilot)
    sensors = "the sensors"
    if autopilot.kind != "embedded":
        sensors = "its own simulated sensors" if autopilot.bridge.sensors is None else "our sensors"
    yield "LS", _node(f"estimates the motion from {sensors}", kind, runs_on), ("LC", "M")
    yield "LC", _node("follows the mission", kind, runs_on), ("LA", "M")
    yield "LA", _node("allocates thrust to the propellers", kind, runs_on), ("M",)


def _companion(profile: ProfileGroups) -> Part:
    if profile.companion is None:
        return
    kind, runs_on = _agent_place(profile.companion.runs, "companion")
    if not profile.companion.is_ours:
        runs_on = runs_on if kind == "real" else THIS_MACHINE
        yield "HS", _node("ROS nodes perceive by lidar and sonar", kind, runs_on), ("HC",)
        yield "HC", _node("ROS nodes plan", kind, runs_on), ("LS", "LC", "HA")
        yield "HA", _node("ROS nodes give the autopilot its orders", kind, runs_on), ("LC", "M")
        return
    yield "HS", _node("maps and tracks obstacles by lidar and sonar", kind, runs_on), ("LC", "HC", "M")
    yield "HC", _node("plans the way around obstacles", kind, runs_on), ("LS", "LC", "HA", "M")
    yield "HA", _node("gives the autopilot its orders", kind, runs_on), ("LC", "M")


def _monitor(profile: ProfileGroups) -> Part:
    if profile.vehicle is not None:
        yield "M", _node("records and shows the run"), ()


_PARTS: tuple[Callable[[ProfileGroups], Part], ...] = (_driver, _simulator, _autopilot, _companion, _monitor)


def complete_graph_group(profile: ProfileGroups) -> NodeGraph | None:
    """Return the complete `graph` group of `profile`; None for a part of a profile without the group.

    For a profile that can run, nodes and links follow from its groups. Written values of a node and written links of
    a node replace the derived ones, and derived links to absent nodes are dropped. For another profile, the result is
    the written group, with the derived kinds of its nodes.
    """
    runs, written = not profile.missing_for_run(), profile.graph or NodeGraph()
    if profile.graph is None and not runs:
        return None
    derived = {name: (node, links) for part in _PARTS for name, node, links in part(profile)}
    names = [*derived, *(name for name in written.nodes if name not in derived)] if runs else [*written.nodes]
    bases = {name: node if runs else Node(kind=node.kind) for name, (node, _) in derived.items()}
    # Written values over derived ones. Values that neither has are empty.
    nodes = {
        name: Node(**{"runs_on": "", "does": "", **_values(bases.get(name)), **_values(written.nodes.get(name))})
        for name in names
    }
    links = dict(written.links)
    if runs:
        # Each pair of present nodes once, under the node that comes first in the architecture.
        present = {name: others for name, (_, others) in derived.items() if nodes[name].kind != "absent"}
        pairs = {frozenset((name, other)) for name, others in present.items() for other in others if other in present}
        order = architecture()
        derived_links = {
            name: tuple(other for other in order[rank:] if frozenset((name, other)) in pairs)
            for rank, name in enumerate(order)
        }
        links = {**{name: others for name, others in derived_links.items() if others}, **links}
    reference = written.reference or (REFERENCE if runs else COMPLETE)
    return NodeGraph(nodes=nodes, links=links, reference=reference, vertices=written.vertices)


def _values(node: Node | None) -> dict[str, Any]:
    return {} if node is None else {name: value for name, value in asdict(node).items() if value is not None}


def _node(does: str, kind: Literal["real", "virtual"] = "virtual", runs_on: str = THIS_MACHINE) -> Node:
    return Node(kind=kind, runs_on=runs_on, does=does)


def _autopilot_kind(profile: ProfileGroups) -> str:
    return "none" if profile.autopilot is None else profile.autopilot.kind


def _agent_place(runs: str, name: str) -> tuple[Literal["real", "virtual"], str]:
    if runs == "board":
        return "real", f"{name} board"
    return "virtual", THIS_MACHINE if runs == "in-process" else f"{name} process on {THIS_MACHINE}"


def _autopilot_place(autopilot: AutopilotSpec) -> tuple[Literal["real", "virtual"], str]:
    """Return kind and place of an autopilot: on a board, at the end of a cable, or virtual."""
    standby = autopilot.standby
    if autopilot.runs == "board" or (standby is not None and standby.runs == "board"):
        return "real", "autopilot board"
    if autopilot.kind == "embedded":
        return _agent_place(autopilot.runs, "agent")
    address = urlsplit(autopilot.bridge.mavlink)
    if address.scheme == "serial":
        return "real", "PX4 on the board" if autopilot.kind == "px4" else "autopilot board"
    where = THIS_MACHINE if address.hostname in (None, *_HERE) else address.hostname
    return "virtual", f"{_PROGRAMS[autopilot.kind]} on {where}"
