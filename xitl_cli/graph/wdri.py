"""WDRI: how close the weighted degree of a simulation's graph comes to that of a reference."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, TypeAlias

from xitl_cli.errors import UserError
from xitl_cli.graph.graph import Graph, Vertex, build_graph, complete_graph
from xitl_cli.profile import Profile, RunProfile, load_profile
from xitl_cli.profile.files.catalogue import shipped_profiles
from xitl_cli.profile.schema.graph import COMPLETE, KIND_WEIGHTS, NodeGraph

VertexCount: TypeAlias = Literal["architecture", "present"] | int
"""Which count of vertices averages the degrees: all of the architecture, those that weigh, or a number."""


@dataclass(frozen=True, slots=True)
class Wdri:
    """The index, the values that it was computed from, and its graph. Nothing is rounded."""

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


@dataclass(frozen=True, slots=True)
class FleetWdri:
    """The indices of the vessels of a fleet, by name; scripted ones have no graph.

    The fleet's is their mean: each vessel counts alike, one on a board lifts it by its share, and none makes up for
    another, as degrees averaged over all nodes would let it.
    """

    vessels: dict[str, Wdri]

    @property
    def wdri(self) -> float:
        """Of the fleet."""
        return sum(one.wdri for one in self.vessels.values()) / len(self.vessels)

    def as_json(self) -> dict[str, object]:
        """The same as plain values for `--json`."""
        return {"wdri": self.wdri, "vessels": {name: one.as_json() for name, one in self.vessels.items()}}


def fleet_wdri(profile: Profile, reference: str | None = None, vertices: VertexCount | None = None) -> FleetWdri:
    """The WDRI of each vessel of a fleet; as `profile_wdri`, with its name in errors."""
    return FleetWdri({name: profile_wdri(one, reference, vertices) for name, one in profile.sailed.items()})


def profile_wdri(
    profile: Profile | RunProfile, reference: str | None = None, vertices: VertexCount | None = None
) -> Wdri:
    """The WDRI of `profile` against `reference`: a profile's name or path, or `complete` (default: the profile's own).

    `vertices` is the count that averages the degrees of `profile` (default: as the profile says); a reference profile
    keeps its own. Raises UserError where a graph is missing or the index is undefined.
    """
    if isinstance(profile, Profile) and profile.vessels is not None:
        raise UserError(f"{profile.name}: has several vessels, each with a graph of its own; name one of them")
    if profile.graph is None:
        raise UserError(f"{profile.name}: has no graph; add a `graph:` group with nodes and links")
    count = profile.graph.vertices if vertices is None else vertices
    reference = (profile.graph.reference or COMPLETE) if reference is None else reference
    return graph_wdri(graph_from_profile(profile.graph), reference, count, profile.name)


def graph_wdri(graph: Graph, reference: str, vertices: VertexCount, name: str) -> Wdri:
    """The WDRI of a graph, called `name` in errors, against `reference`; see profile_wdri."""
    n = count_vertices(graph, vertices, name)
    if reference == COMPLETE:
        names = tuple(vertex.name for vertex in graph.vertices)
        reference_graph, n_ref = complete_graph(names), len(names)
    else:
        find = _shipped_reference if reference in shipped_profiles() else _reference_graph
        reference, reference_graph, n_ref = find(reference)
    d_w_sim, d_w_ref = graph.weighted_degree(n), reference_graph.weighted_degree(n_ref)
    try:
        value = realism_index(d_w_sim, d_w_ref)
    except ValueError as error:
        raise UserError(f"{reference}: {error}; choose a reference with more links") from None
    return Wdri(value, d_w_sim, d_w_ref, n, n_ref, reference, graph)


def _reference_graph(reference: str) -> tuple[str, Graph, int]:
    """The name, the graph and the count of vertices of the profile that is held against."""
    other = load_profile(reference)
    if other.graph is None:
        raise UserError(f"{other.name}: has no graph to be held against; name a profile that has, or {COMPLETE!r}")
    graph = graph_from_profile(other.graph)
    return other.name, graph, count_vertices(graph, other.graph.vertices, other.name)


_shipped_reference = lru_cache(_reference_graph)  # asked for by each vessel of a fleet, three times


def graph_from_profile(group: NodeGraph) -> Graph:
    """The graph that a profile's `graph` group describes."""
    vertices = []
    for name, node in group.nodes.items():
        kind = node.kind or "absent"
        weight = KIND_WEIGHTS[kind] if node.weight is None else node.weight
        vertices.append(Vertex(name, kind, weight, node.runs_on or "", node.does or ""))
    return build_graph(vertices, [(one, other) for one, others in group.links.items() for other in others])


def count_vertices(graph: Graph, vertices: VertexCount, name: str) -> int:
    """`vertices` as a number for `graph`; UserError, naming the graph, for one that makes no sense."""
    present = graph.present()
    if present == 0:
        raise UserError(f"{name}: no node of its graph is present; give one under graph.nodes a kind: real or virtual")
    if vertices == "architecture":
        return len(graph.vertices)
    if vertices == "present":
        return present
    if vertices < present:
        raise UserError(f"{name}: n = {vertices} is fewer than the {present} nodes present; use {present} or more")
    return vertices


def realism_index(d_w_sim: float, d_w_ref: float) -> float:
    """`1 - |d_w_sim - d_w_ref| / d_w_ref`, not below 0 (eq 23 of the paper); `d_w_ref` must be positive."""
    if not d_w_ref > 0:
        raise ValueError(f"the reference's weighted degree is {d_w_ref:g}; the index needs one above 0")
    return max(0.0, 1.0 - abs(d_w_sim - d_w_ref) / d_w_ref)
