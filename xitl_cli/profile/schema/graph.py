"""`graph`: the nodes of the architecture and the links between them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from xitl_cli.profile.schema.group import Group


def _count(value: object) -> object:
    whole = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= 1000
    if whole or (isinstance(value, str) and value in ("architecture", "present")):
        return value
    raise PydanticCustomError("sentence", "is not a count of vertices; write architecture, present or 1 to 1000")


class Node(Group):
    """One node; its weight is 1 (real), 0.5 (virtual) or 0 (absent) unless given."""

    kind: Literal["real", "virtual", "absent"]
    runs_on: str = ""
    does: str = ""
    weight: Annotated[float, Field(ge=0, le=1)] | None = None


class NodeGraph(Group):
    """Nodes by name and, per node, the nodes it is linked to. A pair may be written once or twice."""

    nodes: dict[str, Node] = {}  # noqa: RUF012 - pydantic copies it
    links: dict[str, tuple[str, ...]] = {}  # noqa: RUF012 - pydantic copies it
    reference: str = "complete"
    vertices: Annotated[Literal["architecture", "present"] | int, BeforeValidator(_count)] = "architecture"
