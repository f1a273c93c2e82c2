"""An undirected graph of weighted nodes, self-loops allowed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from xitl_cli.profile.schema.graph import architecture


@dataclass(frozen=True, slots=True)
class Vertex:
    """One node."""

    name: str
    kind: str
    weight: float
    """1 real, 0.5 virtual, 0 absent."""
    runs_on: str = ""
    does: str = ""
    """Its task."""


@dataclass(frozen=True, slots=True)
class Graph:
    """Vertices in the architecture's order and their symmetric 0/1 adjacency."""

    vertices: tuple[Vertex, ...]
    adjacency: tuple[tuple[int, ...], ...]

    def degrees(self) -> tuple[int, ...]:
        """Links per vertex; a self-loop counts once."""
        return tuple(sum(row) for row in self.adjacency)

    def present(self) -> int:
        """Return the number of vertices with a weight above 0."""
        return sum(vertex.weight > 0 for vertex in self.vertices)

    def link_names(self) -> list[str]:
        """Return every link once, as `PS1-LS`, in the architecture's order."""
        names = [vertex.name for vertex in self.vertices]
        return [
            f"{name}-{other}"
            for row, name in enumerate(names)
            for column, other in enumerate(names)
            if column >= row and self.adjacency[row][column]
        ]

    def weighted_degree(self, n: int) -> float:
        """Return the weighted average degree `sum(w (d - 1)) / n` over `n` vertices (eq 22 of the paper)."""
        if n < 1:
            raise ValueError(f"a weighted degree over n = {n} vertices is undefined; n must be at least 1")
        pairs = zip(self.vertices, self.degrees(), strict=True)
        return sum(vertex.weight * (degree - 1) for vertex, degree in pairs if vertex.weight > 0) / n


def build_graph(vertices: Iterable[Vertex], links: Iterable[tuple[str, str]]) -> Graph:
    """Return the graph of `vertices` joined by `links`, in any direction. Other nodes of the architecture are absent.

    Raises ValueError for a duplicate vertex or a link to an unknown name.
    """
    given: dict[str, Vertex] = {}
    for vertex in vertices:
        if vertex.name in given:
            raise ValueError(f"the node {vertex.name} is given twice")
        given[vertex.name] = vertex
    order = architecture(given)
    if unknown := set(given) - set(order):
        raise ValueError(f"{min(unknown)} is not a node; the nodes are {', '.join(order)}")
    index = {name: position for position, name in enumerate(order)}
    rows = [[0] * len(order) for _ in order]
    for one, other in links:
        if one not in index or other not in index:
            raise ValueError(f"the link {one}-{other} has an end that is not a node; the nodes are {', '.join(order)}")
        rows[index[one]][index[other]] = rows[index[other]][index[one]] = 1
    return Graph(
        vertices=tuple(given.get(name, Vertex(name, "absent", 0.0)) for name in order),
        adjacency=tuple(tuple(row) for row in rows),
    )


def complete_graph(names: Iterable[str]) -> Graph:
    """Return a graph with every vertex real and joined to every vertex, itself included: weighted degree n - 1."""
    names = tuple(names)
    vertices = tuple(Vertex(name, "real", 1.0) for name in names)
    return Graph(vertices, tuple((1,) * len(names) for _ in names))
