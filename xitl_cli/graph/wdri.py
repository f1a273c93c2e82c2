"""WDRI: how close the weighted degree of a simulation comes to that of a reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from xitl_cli.errors import UserError
from xitl_cli.graph.graph import Graph

Vertices: TypeAlias = Literal["architecture", "present"] | int
"""Which count of vertices averages the degrees: all of the architecture, those that weigh, or a number."""


@dataclass(frozen=True, slots=True)
class Wdri:
    """The index, what it was computed from, and the graphs behind it. Nothing is rounded."""

    wdri: float
    d_w_sim: float
    d_w_ref: float
    n: int
    n_ref: int
    reference: str
    graph: Graph

    def as_json(self) -> dict[str, object]:
        """The same as plain values for `--json`."""
        degrees = self.graph.degrees()
        return {
            "wdri": self.wdri,
            "d_w_sim": self.d_w_sim,
            "d_w_ref": self.d_w_ref,
            "n": self.n,
            "n_ref": self.n_ref,
            "reference": self.reference,
            "nodes": [
                {
                    "name": vertex.name,
                    "kind": vertex.kind,
                    "runs_on": vertex.runs_on,
                    "does": vertex.does,
                    "weight": vertex.weight,
                    "degree": degree,
                }
                for vertex, degree in zip(self.graph.vertices, degrees, strict=True)
            ],
            "adjacency": [list(row) for row in self.graph.adjacency],
        }


def vertex_count(graph: Graph, vertices: Vertices, of: str) -> int:
    """`vertices` as a number for `graph`; UserError, naming the graph as `of`, for one that makes no sense."""
    present = graph.present()
    if present == 0:
        raise UserError(f"{of}: no node of its graph is present; give one under graph.nodes a kind: real or virtual")
    if vertices == "architecture":
        return len(graph.vertices)
    if vertices == "present":
        return present
    if vertices < present:
        raise UserError(f"{of}: n = {vertices} is fewer than the {present} nodes present; use {present} or more")
    return vertices


def index(d_w_sim: float, d_w_ref: float) -> float:
    """`1 - |d_w_sim - d_w_ref| / d_w_ref`, not below 0 (eq 23 of the paper); `d_w_ref` must be positive."""
    if not d_w_ref > 0:
        raise ValueError(f"the reference's weighted degree is {d_w_ref:g}; the index needs one above 0")
    return max(0.0, 1.0 - abs(d_w_sim - d_w_ref) / d_w_ref)
