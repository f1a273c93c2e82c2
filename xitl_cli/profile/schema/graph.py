"""`graph`: the nodes of the architecture and the links between them.

D driver · PS1...PSn system simulators · LS LC LA low-level sensing, control, actuation · HS HC HA the same at high
level · M monitor (Ribeiro et al., Robotica, 2024).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import field
from typing import Annotated, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import Share, Specification, ValueProblem

MOST_VERTICES = 1000

MEANINGS = {
    "D": "driver",
    "PS": "system simulator",
    "LS": "low-level sensing",
    "LC": "low-level control",
    "LA": "low-level actuation",
    "HS": "high-level sensing",
    "HC": "high-level control",
    "HA": "high-level actuation",
    "M": "monitor",
}
KIND_WEIGHTS = {"real": 1.0, "virtual": 0.5, "absent": 0.0}
COMPLETE = "complete"
"""As a reference: every node real and linked to every node."""

_SIMULATOR = re.compile(r"PS([1-9][0-9]{0,2})")


def is_node_name(name: str) -> bool:
    """Return True if `name` is a node of the architecture."""
    return (name in MEANINGS and name != "PS") or _SIMULATOR.fullmatch(name) is not None


def node_meaning(name: str) -> str:
    """Return the meaning of the node `name`."""
    return MEANINGS["PS" if _SIMULATOR.fullmatch(name) else name]


def architecture(names: Iterable[str] = ()) -> tuple[str, ...]:
    """Return all vertices in the architecture's order: 8 and every simulator among `names` (PS1 without one)."""
    simulators = {int(match[1]) for name in names if (match := _SIMULATOR.fullmatch(name))} or {1}
    return ("D", *(f"PS{number}" for number in sorted(simulators)), "LS", "LC", "LA", "HS", "HC", "HA", "M")


def _vertices_problem(value: object) -> str | None:
    whole = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_VERTICES
    if whole or value in ("architecture", "present"):
        return None
    return f"is not a count of vertices; write architecture, present or 1 to {MOST_VERTICES}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Node(Specification):
    """One node: the differences from the node that follows from the run's composition."""

    kind: Annotated[
        Literal["real", "virtual", "absent"] | None, "null: as composed; required for a node that is not composed"
    ] = None
    runs_on: Annotated[str | None, "null: as composed"] = None
    does: Annotated[str | None, "null: as composed"] = None
    weight: Annotated[Share | None, "null: 1 for real, 0.5 for virtual, 0 for absent"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeGraph(Specification):
    """Differences from the graph that follows from driver, autopilot, companion and their locations.

    `xitl profiles show` and `xitl wdri` show the whole graph.
    """

    nodes: Annotated[dict[str, Node], "D, PS1, PS2 ..., LS, LC, LA, HS, HC, HA and M, by name"] = field(
        default_factory=dict
    )
    links: Annotated[
        dict[str, tuple[str, ...]],
        "for each node, the nodes that it exchanges data with; they replace the derived links; a pair may appear once "
        "or twice",
    ] = field(default_factory=dict)
    reference: Annotated[
        str | None,
        "a profile, or complete; null: paper/eq24-general-use for a profile that can run, otherwise complete",
    ] = None
    vertices: Annotated[
        Literal["architecture", "present"] | int, ValueProblem(_vertices_problem), f"or a number, 1 to {MOST_VERTICES}"
    ] = "architecture"
