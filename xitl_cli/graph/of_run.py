"""The graph that a finished run had, from what it left behind."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.graph.graph import Graph, Vertex, build_graph
from xitl_cli.graph.of_profile import wdri_of_graph
from xitl_cli.graph.wdri import Vertices, Wdri
from xitl_cli.profile import load_profile
from xitl_cli.profile.catalogue import shipped_profiles
from xitl_cli.run.directory import PROFILE, SUMMARY


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """The WDRI of a run as it was, the one its profile claims, and the links in which they differ."""

    wdri: Wdri
    claimed_wdri: float
    missing: tuple[str, ...]
    unclaimed: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """As Wdri, with the rest beside it."""
        return {
            **self.wdri.as_json(),
            "claimed_wdri": self.claimed_wdri,
            "missing": list(self.missing),
            "unclaimed": list(self.unclaimed),
        }


def is_run(name: str) -> bool:
    """Whether `name` is a directory that a run left behind, and not the name of a shipped profile."""
    try:
        return (Path(name) / SUMMARY).is_file() and name not in shipped_profiles()
    except (OSError, ValueError):
        return False


def measured_run(folder: Path, reference: str | None = None, vertices: Vertices | None = None) -> MeasuredRun:
    """The measured graph in `folder`; `reference` and `vertices` as in `wdri_of`, by default those of its profile.

    Raises UserError when the folder holds no measured graph.
    """
    section = _section(folder / SUMMARY)
    try:
        graph = _graph(section["measured"])
        claimed = float(section["claimed"]["wdri"])
        missing, unclaimed = (tuple(str(link) for link in section[key]) for key in ("missing", "unclaimed"))
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{folder / SUMMARY}: its graph cannot be read ({error}); run again with this xitl") from None
    if graph.present() == 0:
        raise UserError(f"{folder}: nothing was measured, the run ended before it began; {SUMMARY} says why")
    profile = load_profile(str(folder / PROFILE))
    if profile.graph is None:
        raise UserError(f"{folder / PROFILE}: has no graph to compare with; name one with --reference")
    count = profile.graph.vertices if vertices is None else vertices
    if vertices is None and isinstance(count, int):
        count = max(count, graph.present())
    reference = profile.graph.reference if reference is None else reference
    return MeasuredRun(wdri_of_graph(graph, reference, count, str(folder)), claimed, missing, unclaimed)


def _section(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({error}); run again") from None
    section = summary.get("graph") if isinstance(summary, dict) else None
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
