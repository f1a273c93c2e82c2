"""WDRI from profiles: the eight values of the paper, the choices of n and reference, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.graph.wdri import VertexCount, profile_wdri
from xitl_cli.profile import ProfileError, load_profile


# Values to four decimals from the exact sums of the paper's tables; it prints two.
@pytest.mark.parametrize(
    ("name", "value", "d_w_sim", "d_w_ref", "n"),
    [
        ("paper/eq24-general-use", 0.5000, 4.0000, 8.0000, 9),
        ("paper/eq26-simple-sitl", 0.2500, 1.0000, 4.0000, 4),
        ("paper/eq30-scale-vessel", 0.3571, 0.8333, 2.3333, 9),
        ("paper/eq31-sitl-own-sensors", 0.2778, 1.1111, 4.0000, 9),
        ("paper/eq32-sitl-injected", 0.4167, 1.6667, 4.0000, 9),
        ("paper/eq33-hitl-injected", 0.5833, 2.3333, 4.0000, 9),
        ("paper/eq34-full-sitl", 0.5417, 2.1667, 4.0000, 9),
        ("paper/eq35-full-hitl", 0.9306, 3.7222, 4.0000, 9),
    ],
)
def test_the_eight_values_of_the_paper(name: str, value: float, d_w_sim: float, d_w_ref: float, n: int) -> None:
    result = profile_wdri(load_profile(name))
    assert (round(result.wdri, 4), round(result.d_w_sim, 4), round(result.d_w_ref, 4)) == (value, d_w_sim, d_w_ref)
    assert result.n == n


def test_eq26_over_the_nine_vertices_of_the_architecture() -> None:
    result = profile_wdri(load_profile("paper/eq26-simple-sitl"), vertices="architecture")
    assert (result.n, result.d_w_sim, result.n_ref) == (9, pytest.approx(4 / 9), 9)
    assert result.wdri == pytest.approx(1 / 9)


@pytest.mark.parametrize(("vertices", "n"), [("architecture", 9), ("present", 6), (6, 6), (12, 12)])
def test_choices_of_n(vertices: VertexCount, n: int) -> None:
    result = profile_wdri(load_profile("sitl"), reference="complete", vertices=vertices)
    assert result.n == n
    assert result.d_w_sim == pytest.approx(6 / n)  # half of (1 + 3 + 3 + 4 + 3 + 4) - 6
    assert result.d_w_ref == 8.0
    assert result.wdri == pytest.approx(6 / n / 8)


def test_a_profile_is_as_real_as_itself() -> None:
    assert profile_wdri(load_profile("paper/eq35-full-hitl"), reference="paper/eq35-full-hitl").wdri == 1.0


def test_the_index_does_not_go_below_zero() -> None:
    result = profile_wdri(load_profile("paper/eq24-general-use"), reference="mitl")
    assert result.d_w_sim > 2 * result.d_w_ref
    assert result.wdri == 0.0


def test_moving_nodes_to_a_board_raises_the_index() -> None:
    values = [profile_wdri(load_profile(name)).wdri for name in ("mitl", "sitl", "hitl-loopback", "hitl-beaglebone")]
    assert values[0] < values[1] == values[2] < values[3]


def test_two_simulators_make_ten_vertices(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    path.write_text(
        "graph:\n  nodes: {PS1: {kind: virtual}, PS2: {kind: virtual}, M: {kind: real}}\n"
        "  links: {PS1: [PS2, M], PS2: [M]}\n",
        encoding="utf-8",
    )
    result = profile_wdri(load_profile(str(path)))
    assert (result.n, result.n_ref, result.d_w_ref) == (10, 10, 9.0)
    assert result.d_w_sim == (0.5 + 0.5 + 1.0) / 10


def test_what_json_carries_is_not_rounded() -> None:
    result = profile_wdri(load_profile("paper/eq31-sitl-own-sensors"))
    document = result.as_json()
    assert document["wdri"] == result.wdri == pytest.approx(10 / 36, abs=1e-15)
    assert document["reference"] == "paper/eq24-general-use"
    nodes = document["nodes"]
    assert isinstance(nodes, list)
    assert [node["name"] for node in nodes] == ["D", "PS1", "LS", "LC", "LA", "HS", "HC", "HA", "M"]
    assert nodes[1] == {
        "name": "PS1",
        "kind": "virtual",
        "runs_on": "host",
        "does": "the vessel in its surroundings",
        "weight": 0.5,
        "degree": 5,
    }
    adjacency = document["adjacency"]
    assert isinstance(adjacency, list)
    assert adjacency[0] == [0, 1, 1, 1, 1, 0, 0, 0, 0]
    assert [sum(row) for row in adjacency] == [node["degree"] for node in nodes]


@pytest.mark.parametrize(
    ("name", "reference", "vertices"),
    [
        ("calm", None, None),
        ("sitl", "calm", None),
        ("sitl", "nope", None),
        ("sitl", None, 5),
        ("boards/beaglebone", None, 2),
        ("sitl", "boards/beaglebone", None),
    ],
)
def test_what_has_no_index(name: str, reference: str | None, vertices: VertexCount | None, golden: Golden) -> None:
    with pytest.raises(UserError) as caught:
        profile_wdri(load_profile(name), reference, vertices)
    golden("error", caught.value)


def test_a_graph_with_nothing_present_has_no_index(tmp_path: Path) -> None:
    path = tmp_path / "empty.yaml"
    path.write_text("graph:\n  nodes: {D: {kind: absent}}\n", encoding="utf-8")
    with pytest.raises(UserError, match="no node of its graph is present"):
        profile_wdri(load_profile(str(path)))


def test_a_link_to_an_absent_node_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("extends: paper/eq33-hitl-injected\ngraph:\n  nodes:\n    HS: {kind: absent}\n", encoding="utf-8")
    with pytest.raises(ProfileError, match=r"injected-sensors\.yaml:\d+: graph\.links\.D: 'HS' is an absent node"):
        load_profile(str(path))
