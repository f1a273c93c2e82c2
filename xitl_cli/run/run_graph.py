"""The measured graph of a run and the graph that its profile claims: written to and read from summary.json."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.graph.graph import AgentTraffic, Edge, Graph, Vertex, build_graph, measured_graph
from xitl_cli.graph.wdri import VertexCount, Wdri, graph_from_profile, graph_wdri, profile_wdri
from xitl_cli.profile import RunProfile, load_profile
from xitl_cli.profile.files.catalogue import is_shipped
from xitl_cli.profile.schema.graph import COMPLETE
from xitl_cli.run.core.directory import PROFILE, SUMMARY


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """The measured and the claimed WDRI of a run, and the links and nodes in which they differ."""

    wdri: Wdri
    claimed_wdri: float
    missing: tuple[str, ...]
    unclaimed: tuple[str, ...]
    overclaimed: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """Return the keys of Wdri and the differences."""
        return {
            **self.wdri.as_json(),
            "claimed_wdri": self.claimed_wdri,
            "missing": list(self.missing),
            "unclaimed": list(self.unclaimed),
            "overclaimed": list(self.overclaimed),
        }


def graph_section(profile: RunProfile, agents: Sequence[AgentTraffic], edges: Iterable[Edge]) -> dict[str, Any]:
    """Return `graph` of summary.json: claimed, measured, and their differences. docs/recording.md explains the keys.

    agents: traffic of the agents. edges: links inside this machine, as the nodes of the run declare and report them.
    """
    claimed = profile_wdri(profile)
    graph = measured_graph(agents, edges)
    measured = None
    present = graph.present()
    if present > 0:  # nothing was measured in a run that failed before it began
        vertices: VertexCount = profile.graph.vertices
        if isinstance(vertices, int):
            vertices = max(vertices, present)
        measured = graph_wdri(graph, profile.graph.reference or COMPLETE, vertices, f"{profile.name} as it ran")
    claimed_links, measured_links = claimed.graph.link_names(), graph.link_names()
    return {
        "reference": claimed.reference,
        "claimed": {"wdri": claimed.wdri, "links": claimed_links},
        "measured": {
            "wdri": None if measured is None else measured.wdri,
            "d_w_sim": None if measured is None else measured.d_w_sim,
            "d_w_ref": claimed.d_w_ref,
            "n": None if measured is None else measured.n,
            "n_ref": claimed.n_ref,
            "links": measured_links,
            "nodes": [
                {"name": vertex.name, "kind": vertex.kind, "runs_on": vertex.runs_on, "weight": vertex.weight}
                for vertex in graph.vertices
                if vertex.kind != "absent"
            ],
        },
        "missing": [link for link in claimed_links if link not in measured_links],
        "unclaimed": [link for link in measured_links if link not in claimed_links],
        "overclaimed": list(_overclaimed(claimed.graph, graph)),
    }


def _overclaimed(claimed: Graph, measured: Graph) -> tuple[str, ...]:
    """Return the nodes that are real in `claimed` and virtual in `measured`."""
    real = {vertex.name for vertex in claimed.vertices if vertex.kind == "real"}
    return tuple(vertex.name for vertex in measured.vertices if vertex.kind == "virtual" and vertex.name in real)


def is_run(name: str) -> bool:
    """Whether `name` is the directory of a run and not the name of a shipped profile."""
    try:
        return (Path(name) / SUMMARY).is_file() and not is_shipped(name)
    except (OSError, ValueError):
        return False


def vessels_of_run(folder: Path) -> tuple[str, ...]:
    """Return the vessel names of a fleet's run; empty for a single vessel. Raises UserError without a summary."""
    return tuple(_summary(folder / SUMMARY).get("vessels", {}))


def measured_run(
    folder: Path, reference: str | None = None, vertices: VertexCount | None = None, vessel: str | None = None
) -> MeasuredRun:
    """Return the measured graph in `folder`.

    `reference` and `vertices` are as in `profile_wdri`; default: those of its profile.

    vessel: name of a vessel in a fleet's run. Raises UserError when the folder holds no measured graph.
    """
    section = _section(folder / SUMMARY, vessel)
    try:
        graph = _graph(section["measured"])
        claimed = float(section["claimed"]["wdri"])
        missing, unclaimed = (tuple(str(link) for link in section[key]) for key in ("missing", "unclaimed"))
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{folder / SUMMARY}: its graph cannot be read ({error}); run again with this xitl") from None
    if graph.present() == 0:
        raise UserError(f"{folder}: nothing was measured, the run ended before it began; {SUMMARY} says why")
    profile = load_profile(str(folder / PROFILE))
    if vessel is not None:
        profile = profile.vessel(vessel)
    if profile.graph is None:
        raise UserError(f"{folder / PROFILE}: has no graph to compare with; name one with --reference")
    count = profile.graph.vertices if vertices is None else vertices
    if vertices is None and isinstance(count, int):
        count = max(count, graph.present())
    reference = (profile.graph.reference or COMPLETE) if reference is None else reference
    overclaimed = _overclaimed(graph_from_profile(profile.graph), graph)
    return MeasuredRun(graph_wdri(graph, reference, count, str(folder)), claimed, missing, unclaimed, overclaimed)


def _summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{path}: cannot be read ({error}); run again") from None
    return summary if isinstance(summary, dict) else {}


def _section(path: Path, vessel: str | None) -> dict[str, Any]:
    part = _summary(path)
    if vessel is not None:
        vessels = part.get("vessels", {})
        if vessel not in vessels:
            there = f"it has {', '.join(vessels)}" if vessels else "it is of one vessel alone, leave the name out"
            raise UserError(f"{path}: has no vessel {vessel!r}; {there}")
        part = vessels[vessel]
    section = part.get("graph")
    if not isinstance(section, dict):
        raise UserError(f"{path}: holds no graph, it is of an older xitl; run again")
    return section


def _graph(measured: dict[str, Any]) -> Graph:
    vertices = [
        Vertex(str(node["name"]), str(node["kind"]), float(node["weight"]), str(node["runs_on"]))
        for node in measured["nodes"]
    ]
    links = [str(link).split("-") for link in measured["links"]]
    return build_graph(vertices, [(one, other) for one, other in links])
