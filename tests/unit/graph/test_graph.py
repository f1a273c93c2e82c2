"""Graphs small enough to count by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xitl_cli.graph.graph import Vertex, build_graph, complete_graph
from xitl_cli.graph.wdri import realism_index
from xitl_cli.profile.schema.graph import architecture, is_node_name


def _real(*names: str) -> list[Vertex]:
    return [Vertex(name, "real", 1.0) for name in names]


def test_the_architecture_has_nine_vertices_and_one_more_per_further_simulator() -> None:
    assert architecture() == ("D", "PS1", "LS", "LC", "LA", "HS", "HC", "HA", "M")
    assert architecture(["PS10", "PS2", "D"]) == ("D", "PS2", "PS10", "LS", "LC", "LA", "HS", "HC", "HA", "M")


@pytest.mark.parametrize("name", ["PS", "PS0", "PS01", "ps1", "L", "", "PS1 ", "PS1234"])
def test_names_that_are_no_nodes(name: str) -> None:
    assert not is_node_name(name)


def test_a_chain_of_three_by_hand() -> None:
    graph = build_graph(_real("D", "PS1", "M"), [("D", "PS1"), ("PS1", "M")])
    assert graph.degrees() == (1, 2, 0, 0, 0, 0, 0, 0, 1)
    assert graph.weighted_degree(9) == (0 + 1 + 0) / 9
    assert graph.weighted_degree(3) == 1 / 3
    assert graph.present() == 3


def test_a_self_loop_counts_once_and_a_pair_written_twice_is_one_link() -> None:
    graph = build_graph(_real("D", "M"), [("D", "D"), ("D", "M"), ("M", "D"), ("D", "M")])
    assert graph.degrees() == (2, 0, 0, 0, 0, 0, 0, 0, 1)
    assert graph.weighted_degree(1) == 1.0


def test_a_vertex_without_weight_contributes_nothing_but_its_links_count_for_others() -> None:
    vertices = [Vertex("D", "real", 1.0), Vertex("HS", "virtual", 0.0), Vertex("M", "virtual", 0.5)]
    graph = build_graph(vertices, [("D", "HS"), ("HS", "M"), ("D", "M")])
    assert graph.weighted_degree(1) == 1.0 * (2 - 1) + 0.5 * (2 - 1)
    assert graph.present() == 2


def test_a_present_vertex_without_links_weighs_against_the_graph() -> None:
    assert build_graph(_real("D"), []).weighted_degree(9) == -1 / 9


def test_the_complete_graph_of_the_architecture_weighs_eight() -> None:
    assert complete_graph(architecture()).weighted_degree(9) == 8.0
    assert complete_graph(architecture(["PS1", "PS2"])).weighted_degree(10) == 9.0


def test_a_second_simulator_stands_beside_the_first() -> None:
    graph = build_graph(_real("PS2", "PS1", "M"), [("PS1", "PS2"), ("PS2", "M")])
    assert [vertex.name for vertex in graph.vertices[:3]] == ["D", "PS1", "PS2"]
    assert len(graph.vertices) == 10
    assert graph.degrees()[1:3] == (1, 2)


def test_graphs_that_cannot_be_built() -> None:
    with pytest.raises(ValueError, match="the node D is given twice"):
        build_graph(_real("D", "D"), [])
    with pytest.raises(ValueError, match="XX is not a node"):
        build_graph(_real("XX"), [])
    with pytest.raises(ValueError, match="the link D-PS2 has an end that is not a node"):
        build_graph(_real("D"), [("D", "PS2")])
    with pytest.raises(ValueError, match="n = 0"):
        build_graph(_real("D"), []).weighted_degree(0)


def test_the_index_by_hand_and_its_clamp() -> None:
    assert realism_index(4, 8) == 0.5
    assert realism_index(8, 8) == 1.0
    assert realism_index(12, 8) == 0.5
    assert realism_index(16, 8) == 0.0
    assert realism_index(17, 8) == 0.0
    assert realism_index(-1, 8) == 0.0
    for reference in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="the index needs one above 0"):
            realism_index(1, reference)


NAMES = architecture(["PS1", "PS2"])


@pytest.mark.medium
@given(st.lists(st.tuples(st.sampled_from(NAMES), st.sampled_from(NAMES)), max_size=40))
def test_adjacency_is_symmetric_and_degrees_count_each_link_at_both_ends(links: list[tuple[str, str]]) -> None:
    graph = build_graph(_real(*NAMES), links)
    assert graph.adjacency == tuple(zip(*graph.adjacency, strict=True))
    pairs = {frozenset(link) for link in links}
    assert sum(graph.degrees()) == sum(len(pair) for pair in pairs)
    assert graph.weighted_degree(10) == pytest.approx((sum(graph.degrees()) - 10) / 10)
