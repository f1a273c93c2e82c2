"""`xitl wdri` as a user sees it."""

from __future__ import annotations

import json

import pytest

from tests.golden import Golden
from xitl_cli.commands.wdri import wdri
from xitl_cli.errors import UserError
from xitl_cli.graph.wdri import profile_wdri
from xitl_cli.profile import load_profile


def test_json_is_one_object_of_unrounded_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    wdri("paper/eq35-full-hitl", as_json=True)
    document = json.loads(capsys.readouterr().out)
    assert {"wdri", "d_w_sim", "d_w_ref", "n", "reference", "nodes", "adjacency"} <= set(document)
    assert document == profile_wdri(load_profile("paper/eq35-full-hitl")).as_json()


@pytest.mark.parametrize("name", ["sitl", "paper/eq33-hitl-injected", "paper/eq24-general-use"])
def test_tables_fit_80_columns_and_need_no_colour(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for variable in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(variable, raising=False)
    wdri(name)
    text = capsys.readouterr().out
    result = profile_wdri(load_profile(name))
    assert "\x1b" not in text
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 80
    for expected in (f"{result.wdri:.4f}", f"{result.d_w_sim:.4f}", f"{result.d_w_ref:.4f}", result.reference):
        assert expected in text


def test_options_reach_the_index(capsys: pytest.CaptureFixture[str]) -> None:
    wdri("sitl", reference="complete", vertices="present", overrides=["graph.nodes.M.kind=real"], as_json=True)
    document = json.loads(capsys.readouterr().out)
    assert (document["n"], document["reference"], document["d_w_ref"]) == (6, "complete", 8.0)
    assert document["d_w_sim"] == pytest.approx(7.5 / 6)  # 6 and another half of M's 4 - 1


@pytest.mark.parametrize("vertices", ["0", "-1", "all", "1001", "9.0", ""])
def test_counts_that_are_none(vertices: str, golden: Golden) -> None:
    with pytest.raises(UserError) as refused:
        wdri("sitl", vertices=vertices)
    golden("error", refused.value, "1000")


def test_a_fleet_has_the_mean_of_its_vessels(capsys: pytest.CaptureFixture[str]) -> None:
    board = ["vessels.target.autopilot.runs=board", "vessels.target.autopilot.link=udp://192.168.7.2:14660"]
    realtime = [*board, "technique=hitl", "clock.mode=realtime"]
    wdri("fleet-crossing", overrides=realtime, as_json=True)
    document = json.loads(capsys.readouterr().out)
    own, target = (document["vessels"][name] for name in ("own", "target"))
    assert own == profile_wdri(load_profile("sitl")).as_json()
    assert target["wdri"] == profile_wdri(load_profile("hitl-beaglebone")).wdri > own["wdri"]
    assert document["wdri"] == (own["wdri"] + target["wdri"]) / 2


def test_the_table_of_a_fleet_names_the_lowest(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    wdri("fleet-crossing")
    lines = capsys.readouterr().out.splitlines()
    assert any(line.split()[:3] == ["own", "0", "6"] for line in lines)
    assert lines[-1].split()[0] == "lowest"
    assert max(map(len, lines)) <= 80


def test_one_vessel_of_a_fleet_has_nodes_and_links(capsys: pytest.CaptureFixture[str], golden: Golden) -> None:
    wdri("fleet-convoy", vessel="follower_2", as_json=True)
    nodes = {node["name"]: node["does"] for node in json.loads(capsys.readouterr().out)["nodes"]}
    assert nodes["D"] == "keeps a position relative to another vessel"
    with pytest.raises(UserError) as refused:
        wdri("fleet-convoy", vessel="follower")
    golden("error", refused.value)
    with pytest.raises(UserError, match="sitl: has a single vessel without a name; remove the name"):
        wdri("sitl", vessel="own")
