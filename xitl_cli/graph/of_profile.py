"""The graph and the WDRI of a profile."""

from __future__ import annotations

from xitl_cli.errors import UserError
from xitl_cli.graph.graph import Graph, Vertex, build_graph, complete_graph
from xitl_cli.graph.nodes import KIND_WEIGHTS
from xitl_cli.graph.wdri import Vertices, Wdri, index, vertex_count
from xitl_cli.profile import Profile, RunProfile, load_profile
from xitl_cli.profile.schema.graph import NodeGraph

COMPLETE = "complete"


def graph_of(nodes: NodeGraph) -> Graph:
    """The graph that a profile's `graph` group describes."""
    vertices = [
        Vertex(
            name=name,
            kind=node.kind,
            weight=KIND_WEIGHTS[node.kind] if node.weight is None else node.weight,
            runs_on=node.runs_on,
            does=node.does,
        )
        for name, node in nodes.nodes.items()
    ]
    return build_graph(vertices, [(one, other) for one, others in nodes.links.items() for other in others])


def wdri_of(profile: Profile | RunProfile, reference: str | None = None, vertices: Vertices | None = None) -> Wdri:
    """The WDRI of `profile` against `reference`: a profile's name or path, or `complete` (default: the profile's own).

    `vertices` is the count that averages the degrees of `profile` (default: as the profile says); a reference profile
    keeps its own. Raises UserError where a graph is missing or the index is undefined.
    """
    if profile.graph is None:
        raise UserError(f"{profile.name}: has no graph; add a `graph:` group with nodes and links")
    count = profile.graph.vertices if vertices is None else vertices
    return wdri_of_graph(
        graph_of(profile.graph), profile.graph.reference if reference is None else reference, count, profile.name
    )


def wdri_of_graph(graph: Graph, reference: str, vertices: Vertices, of: str) -> Wdri:
    """The WDRI of a graph, called `of` in errors, against `reference`; see wdri_of."""
    n = vertex_count(graph, vertices, of)
    if reference == COMPLETE:
        names = tuple(vertex.name for vertex in graph.vertices)
        reference_graph, n_ref = complete_graph(names), len(names)
    else:
        other = load_profile(reference)
        if other.graph is None:
            raise UserError(f"{other.name}: has no graph to be held against; name a profile that has, or {COMPLETE!r}")
        reference = other.name
        reference_graph = graph_of(other.graph)
        n_ref = vertex_count(reference_graph, other.graph.vertices, other.name)
    d_w_sim, d_w_ref = graph.weighted_degree(n), reference_graph.weighted_degree(n_ref)
    try:
        value = index(d_w_sim, d_w_ref)
    except ValueError as error:
        raise UserError(f"{reference}: {error}; choose a reference with more links") from None
    return Wdri(value, d_w_sim, d_w_ref, n, n_ref, reference, graph)
