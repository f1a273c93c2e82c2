"""WDRI: closeness of the weighted degree of a simulation's graph to that of a reference, from 0 to 1."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal, TypeAlias

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.graph.graph import Graph, Vertex, build_graph, complete_graph
from xitl_cli.profile import Profile, RunProfile, load_profile
from xitl_cli.profile.files.catalogue import is_shipped
from xitl_cli.profile.schema.graph import COMPLETE, KIND_WEIGHTS, NodeGraph

VertexCount: TypeAlias = Literal["architecture", "present"] | int
"""Number of vertices for the average degree: all of the architecture, the present ones, or a number."""


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
    """The indices of the vessels of a fleet, by name; scripted vessels have no graph.

    The fleet's index is their mean, so each vessel counts equally. A vessel on a board raises the index by its share.
    No vessel compensates for another, as it could with degrees averaged over all nodes.
    """

    vessels: dict[str, Wdri]

    @property
    def wdri(self) -> float:
        """Index of the fleet."""
        return sum(one.wdri for one in self.vessels.values()) / len(self.vessels)

    def as_json(self) -> dict[str, object]:
        """Return plain values for `--json`."""
        return {"wdri": self.wdri, "vessels": {name: one.as_json() for name, one in self.vessels.items()}}


def fleet_wdri(profile: Profile, reference: str | None = None, vertices: VertexCount | None = None) -> FleetWdri:
    """Return the WDRI of each vessel of a fleet, as `profile_wdri`, with its name in errors."""
    return FleetWdri({name: profile_wdri(one, reference, vertices) for name, one in profile.sailed.items()})


def profile_wdri(
    profile: Profile | RunProfile, reference: str | None = None, vertices: VertexCount | None = None
) -> Wdri:
    """Return the WDRI of `profile` against `reference`: a profile's name or path, or `complete`.

    Default: the profile's own.

    `vertices`: number of vertices for the average degree of `profile`; default: that of the profile. A reference
    profile keeps its own number. Raises UserError when a graph is missing or the index is undefined.
    """
    if isinstance(profile, Profile) and profile.vessels is not None:
        raise UserError(f"{profile.name}: has several vessels, each with a graph of its own; name one of them")
    if profile.graph is None:
        raise UserError(f"{profile.name}: has no graph; add a `graph:` group with nodes and links")
    count = profile.graph.vertices if vertices is None else vertices
    reference = (profile.graph.reference or COMPLETE) if reference is None else reference
    return graph_wdri(graph_from_profile(profile.graph), reference, count, profile.name)


def graph_wdri(graph: Graph, reference: str, vertices: VertexCount, name: str) -> Wdri:
    """Return the WDRI of a graph, called `name` in errors, against `reference`; see profile_wdri."""
    n = count_vertices(graph, vertices, name)
    if reference == COMPLETE:
        names = tuple(vertex.name for vertex in graph.vertices)
        reference_graph, n_ref = complete_graph(names), len(names)
    else:
        find = _shipped_reference if is_shipped(reference) else _reference_graph
        reference, reference_graph, n_ref = find(reference)
    d_w_sim, d_w_ref = graph.weighted_degree(n), reference_graph.weighted_degree(n_ref)
    try:
        value = realism_index(d_w_sim, d_w_ref)
    except ValueError as error:
        raise UserError(f"{reference}: {error}; choose a reference with more links") from None
    return Wdri(value, d_w_sim, d_w_ref, n, n_ref, reference, graph)


def _reference_graph(reference: str) -> tuple[str, Graph, int]:
    """Return name, graph and number of vertices of the reference profile."""
    other = load_profile(reference)
    if other.graph is None:
        raise UserError(f"{other.name}: has no graph to be held against; name a profile that has, or {COMPLETE!r}")
    graph = graph_from_profile(other.graph)
    return other.name, graph, count_vertices(graph, other.graph.vertices, other.name)


_shipped_reference = lru_cache(_reference_graph)  # each vessel of a fleet needs it three times


def graph_from_profile(group: NodeGraph) -> Graph:
    """Return the graph of a profile's `graph` group."""
    vertices = []
    for name, node in group.nodes.items():
        kind = node.kind or "absent"
        weight = KIND_WEIGHTS[kind] if node.weight is None else node.weight
        vertices.append(Vertex(name, kind, weight, node.runs_on or "", node.does or ""))
    return build_graph(vertices, [(one, other) for one, others in group.links.items() for other in others])


def count_vertices(graph: Graph, vertices: VertexCount, name: str) -> int:
    """Return `vertices` as a number for `graph`. Raises UserError, with the name, for an invalid number."""
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
    """Return `1 - |d_w_sim - d_w_ref| / d_w_ref`, at least 0 (eq 23 of the paper); `d_w_ref` must be positive."""
    if not d_w_ref > 0:
        raise ValueError(f"the reference's weighted degree is {d_w_ref:g}; the index needs one above 0")
    return max(0.0, 1.0 - abs(d_w_sim - d_w_ref) / d_w_ref)
