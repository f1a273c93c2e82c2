"""`graph`: the nodes of the architecture and the links between them.

D driver · PS1...PSn system simulators · LS LC LA low-level sensing, control, actuation · HS HC HA the same at high
level · M monitor (Ribeiro et al., Robotica, 2024).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from xitl_cli.profile.schema.group import Group

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
    """Whether `name` is a node of the architecture."""
    return (name in MEANINGS and name != "PS") or _SIMULATOR.fullmatch(name) is not None


def node_meaning(name: str) -> str:
    """The node `name` in words."""
    return MEANINGS["PS" if _SIMULATOR.fullmatch(name) else name]


def architecture(names: Iterable[str] = ()) -> tuple[str, ...]:
    """All vertices in the architecture's order: 8 and every simulator among `names` (PS1 if there is none)."""
    simulators = {int(match[1]) for name in names if (match := _SIMULATOR.fullmatch(name))} or {1}
    return ("D", *(f"PS{number}" for number in sorted(simulators)), "LS", "LC", "LA", "HS", "HC", "HA", "M")


def _count(value: object) -> object:
    whole = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= 1000
    if whole or (isinstance(value, str) and value in ("architecture", "present")):
        return value
    raise PydanticCustomError("sentence", "is not a count of vertices; write architecture, present or 1 to 1000")


class Node(Group):
    """One node; its weight is 1 (real), 0.5 (virtual) or 0 (absent) unless given. None: see `complete_graph_group`."""

    kind: Literal["real", "virtual", "absent"] | None = None
    runs_on: str = ""
    does: str = ""
    weight: Annotated[float, Field(ge=0, le=1)] | None = None


class NodeGraph(Group):
    """Nodes by name and, per node, the nodes it is linked to. A pair may be written once or twice."""

    nodes: dict[str, Node] = {}  # noqa: RUF012 - pydantic copies it
    links: dict[str, tuple[str, ...]] = {}  # noqa: RUF012 - pydantic copies it
    reference: str = COMPLETE
    vertices: Annotated[Literal["architecture", "present"] | int, BeforeValidator(_count)] = "architecture"
