"""The graph that a run had, from counts of messages small enough to check by hand."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from agent.bridges.counts import BridgeCounts
from agent.wire import dialect
from tests.golden import Golden
from xitl_cli.commands.wdri import wdri
from xitl_cli.errors import UserError
from xitl_cli.graph.graph import FROM_AGENT, TO_AGENT, AgentTraffic, measured_graph
from xitl_cli.graph.wdri import profile_wdri
from xitl_cli.profile import load_profile, resolved_yaml
from xitl_cli.profile.schema.graph import is_node_name
from xitl_cli.record.topics import LinkReport
from xitl_cli.run.core.reports import NodeReport
from xitl_cli.run.links.link_accounts import agent_traffic
from xitl_cli.run.nodes.bridge import traffic_behind
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.nodes.drivers import GroundStationDriver
from xitl_cli.run.run_graph import graph_section, measured_run
from xitl_cli.run.session import run

IMU, COMMAND, RUN = (
    dialect.MAVLINK_MSG_ID_XITL_IMU,
    dialect.MAVLINK_MSG_ID_COMMAND_LONG,
    dialect.MAVLINK_MSG_ID_XITL_RUN,
)
ACTUATORS, ATTITUDE, HEARTBEAT = (
    dialect.MAVLINK_MSG_ID_XITL_ACTUATORS,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
    dialect.MAVLINK_MSG_ID_HEARTBEAT,
)
EVERYTHING = {"tx": {IMU: 9, COMMAND: 1, RUN: 2}, "rx": {ACTUATORS: 5, ATTITUDE: 3, HEARTBEAT: 1}}


def seen(nodes: str = "LS,LC,LA", kind: str = "virtual", **other: Any) -> AgentTraffic:
    values = {"to_agent": EVERYTHING["tx"], "from_agent": EVERYTHING["rx"], "estimates": 4, "efforts": 4, **other}
    return AgentTraffic(nodes, kind, "board", **values)


def links(reports: list[LinkReport] | None = None) -> list[LinkReport]:
    return reports or [LinkReport("sensors", 12, 12, 0), LinkReport("actuators", 9, 9, 0)]


def node(**values: Any) -> NodeReport:
    return NodeReport("LS,LC,LA", "board", "1", None, 0, **{"estimates": 4, "efforts": 4, **values})


RECORDED = ("PS1", "M")


def section(name: str = "sitl", traffic: Any = None, nodes: Any = None, reports: Any = None) -> dict[str, Any]:
    frames = {"agent": EVERYTHING} if traffic is None else traffic
    agents = [agent_traffic(own, links(reports), frames[own.link]) for own in ([node()] if nodes is None else nodes)]
    return graph_section(load_profile(name).runnable(), agents, [RECORDED])


def test_a_whole_run_measures_what_it_claims() -> None:
    graph = measured_graph([seen()], [("PS1", "M")])
    assert graph.link_names() == ["D-LC", "PS1-LS", "PS1-LA", "PS1-M", "LS-LC", "LS-M", "LC-LA", "LC-M", "LA-M"]
    found = section()
    assert (found["missing"], found["unclaimed"]) == ([], [])
    assert found["measured"]["wdri"] == found["claimed"]["wdri"] == profile_wdri(load_profile("sitl")).wdri


def test_what_keeps_the_link_going_is_no_traffic() -> None:
    graph = measured_graph([seen(to_agent={RUN: 5}, from_agent={}, estimates=0, efforts=0)], [])
    assert graph.link_names() == []
    assert graph.present() == 3  # the nodes said that they are there


@pytest.mark.parametrize(
    ("lacks", "missing"),
    [
        ({"to_agent": {COMMAND: 1}}, "PS1-LS"),
        ({"to_agent": {IMU: 1}}, "D-LC"),
        ({"to_agent": {dialect.MAVLINK_MSG_ID_XITL_TRUTH: 1, COMMAND: 1}}, ""),
        ({"from_agent": {ATTITUDE: 1, HEARTBEAT: 1}}, "PS1-LA LA-M"),
        ({"from_agent": {ACTUATORS: 1, HEARTBEAT: 1}}, "LS-M"),
        ({"from_agent": {ACTUATORS: 1, ATTITUDE: 1, HEARTBEAT: 0}}, "LC-M"),
        ({"estimates": 0}, "LS-LC"),
        ({"efforts": 0}, "LC-LA"),
    ],
)
def test_a_link_that_carried_nothing_is_not_there(lacks: dict[str, Any], missing: str) -> None:
    whole = measured_graph([seen()], [("PS1", "M")]).link_names()
    without = measured_graph([seen(**lacks)], [("PS1", "M")]).link_names()
    assert [link for link in whole if link not in without] == missing.split()


def test_kinds_come_from_what_the_board_announced() -> None:
    graph = measured_graph([seen(kind="real")], [("PS1", "M")])
    kinds = {vertex.name: (vertex.kind, vertex.weight, vertex.runs_on) for vertex in graph.vertices}
    assert kinds["LS"] == kinds["LC"] == kinds["LA"] == ("real", 1.0, "board")
    assert kinds["D"] == kinds["PS1"] == kinds["M"] == ("virtual", 0.5, "this machine")
    assert kinds["HS"] == ("absent", 0.0, "")
    # (1 (3 - 1) for LS, 1 (4 - 1) for LC, 1 (3 - 1) for LA, 0.5 (1 - 1) D, 0.5 (3 - 1) PS1, 0.5 (4 - 1) M) / 9
    assert graph.weighted_degree(9) == pytest.approx((2 + 3 + 2 + 0 + 1 + 1.5) / 9)
    assert section(nodes=[node(kind="real")])["measured"]["wdri"] > section()["measured"]["wdri"]


@pytest.mark.medium
def test_a_board_that_is_none_is_no_real_node_whatever_the_profile_claims(tmp_path: Path) -> None:
    found = section("hitl-beaglebone", nodes=[node(kind="virtual")])
    assert found["overclaimed"] == ["LS", "LC", "LA"]
    assert found["measured"]["wdri"] == section("hitl-virtual-board")["claimed"]["wdri"]
    assert measured_run(run_directory(tmp_path, found)).overclaimed == ("LS", "LC", "LA")
    assert section("hitl-beaglebone", nodes=[node(kind="real")])["overclaimed"] == []
    assert section("hitl-virtual-board")["overclaimed"] == []


def test_a_companion_is_the_high_level() -> None:
    companion = seen("HS,HC,HA", "real", to_agent={}, from_agent={HEARTBEAT: 3}, estimates=0, efforts=0)
    graph = measured_graph([seen(), companion], [])
    assert "HC-M" in graph.link_names()
    assert {vertex.name: vertex.kind for vertex in graph.vertices}["HC"] == "real"


def test_of_two_agents_for_the_same_nodes_the_real_one_counts() -> None:
    for agents in ([seen(kind="real"), seen()], [seen(), seen(kind="real")]):
        graph = measured_graph(agents, [])
        assert {vertex.kind for vertex in graph.vertices if vertex.name in ("LS", "LC", "LA")} == {"real"}


def test_nothing_announced_and_nonsense_announced() -> None:
    assert measured_graph([], []).present() == 0
    graph = measured_graph([seen("LS,XX,,PS0", "imaginary", from_agent={}, to_agent={}, estimates=0, efforts=0)], [])
    assert [vertex.name for vertex in graph.vertices if vertex.kind == "virtual"] == ["LS"]


def test_the_tables_name_messages_of_the_dialect_and_nodes_of_the_architecture() -> None:
    level = {"S": "LS", "C": "LC", "A": "LA"}
    for table in (TO_AGENT, FROM_AGENT):
        for message_id, pairs in table.items():
            assert message_id in dialect.mavlink_map
            assert all(is_node_name(level.get(end, end)) for pair in pairs for end in pair)


def test_frames_that_never_arrived_carried_nothing() -> None:
    cut = [LinkReport("sensors", 12, 0, 12), LinkReport("actuators", 9, 9, 0)]
    assert section(reports=cut)["missing"] == ["D-LC", "PS1-LS"]


BRIDGE_WORDS = dialect.MAVLINK_MSG_ID_STATUSTEXT
SAID_BY_THE_BRIDGE = {"tx": EVERYTHING["tx"], "rx": {ACTUATORS: 1, BRIDGE_WORDS: 2}}


def behind(
    name: str,
    counts: BridgeCounts,
    traffic: Any = EVERYTHING,
    overrides: tuple[str, ...] = (),
    heard: bool = True,
    **values: Any,
) -> dict[str, Any]:
    profile = load_profile(name, list(overrides)).runnable()
    bridge = agent_traffic(node(**values), links(), traffic)
    return graph_section(profile, [traffic_behind(profile, heard, counts, bridge)], [RECORDED])


def test_an_autopilot_that_was_never_heard_is_not_there_though_its_bridge_is() -> None:
    counts = BridgeCounts(imu_out=1000)
    found = behind("sitl-ardupilot", counts, SAID_BY_THE_BRIDGE, heard=False, estimates=0, efforts=0)
    assert found["measured"]["links"] == ["PS1-M"]
    assert [node["name"] for node in found["measured"]["nodes"]] == ["PS1", "M"]


def test_what_did_not_get_past_the_bridge_reached_no_sensing_and_no_motor() -> None:
    found = behind("sitl-ardupilot", BridgeCounts(imu_out=0), efforts=0)
    assert found["missing"] == ["PS1-LS", "PS1-LA", "LC-LA", "LA-M"]
    assert behind("sitl-ardupilot", BridgeCounts(solution_out=9))["missing"] == []


def test_hil_messages_count_when_the_script_has_got_them() -> None:
    name = "hitl-ardupilot-usb-loopback"
    assert behind(name, BridgeCounts(imu_out=9))["missing"] == ["PS1-LS"]
    assert behind(name, BridgeCounts(imu_out=9, script_in=8))["missing"] == []


def test_an_autopilot_at_the_end_of_a_cable_is_a_board_whatever_runs_the_bridge() -> None:
    name = "hitl-ardupilot-ahrs"
    found = behind(name, BridgeCounts(imu_out=9))
    assert found["measured"]["wdri"] == found["claimed"]["wdri"]
    kinds = {node["name"]: (node["kind"], node["runs_on"]) for node in found["measured"]["nodes"]}
    assert kinds["LS"] == kinds["LC"] == kinds["LA"] == ("real", "board at /dev/ttyACM0")


def test_an_autopilot_on_this_machine_is_no_board() -> None:
    started = behind("sitl-ardupilot", BridgeCounts(imu_out=9))
    by_terminal = behind(
        "hitl-ardupilot-ahrs",
        BridgeCounts(imu_out=9),
        overrides=("autopilot.bridge.mavlink=serial:///dev/pts/7?baud=115200",),
    )
    for found in (started, by_terminal):
        assert {node["kind"] for node in found["measured"]["nodes"]} == {"virtual"}


def test_a_standby_counts_its_own_link() -> None:
    both = {"agent": {"tx": {}, "rx": {}}, "standby": EVERYTHING}
    nodes = [node(estimates=0, efforts=0), node(link="standby")]
    reports = [*links(), LinkReport("standby sensors", 1, 1, 0), LinkReport("standby actuators", 1, 1, 0)]
    assert section(traffic=both, nodes=nodes, reports=reports)["missing"] == []
    reports[2] = LinkReport("standby sensors", 1, 0, 1)
    assert section(traffic=both, nodes=nodes, reports=reports)["missing"] == ["D-LC", "PS1-LS"]


@pytest.mark.medium
def test_without_an_autopilot_the_driver_reaches_vessel_and_recording(tmp_path: Path) -> None:
    for driver, measured in (("mission", ["D-PS1", "D-M", "PS1-M"]), ("none", ["PS1-M"])):
        found = short_run(tmp_path / driver, "mitl", [f"driver.kind={driver}"])
        assert found["measured"]["links"] == measured
        assert found["missing"] == [link for link in found["claimed"]["links"] if link not in measured]
        assert found["unclaimed"] == []


def short_run(folder: Path, name: str, overrides: Sequence[str]) -> Any:
    run(load_profile(name, [*overrides, "clock.duration_s=0.5"]), folder, False, NoDisplay, timed=True)
    return json.loads((folder / "summary.json").read_text())["graph"]


def test_a_person_at_a_ground_station_has_given_orders_once_the_vessel_was_armed() -> None:
    view = SimpleNamespace(armed=False, mode="MANUAL", reached_seqs=set(), target_seq=None)
    download = SimpleNamespace(poll=lambda sim_ns: [], done=False)
    commands = SimpleNamespace(view=view, download=lambda: download, send_all=lambda messages: None)
    driver = GroundStationDriver(cast(Any, commands), cast(Any, None), (), stay=True)
    driver.update(0)
    assert driver.report() == {}
    view.armed = True
    driver.update(1)
    assert driver.report() == {"edges": [("D", "LC")]}


def test_a_run_that_failed_before_it_began_has_no_measured_index() -> None:
    profile = load_profile("sitl").runnable()
    found = graph_section(profile, [], [])
    assert found["measured"]["wdri"] is None
    assert found["missing"] == found["claimed"]["links"]
    json.dumps(found, allow_nan=False)


def run_directory(tmp_path: Path, graph: Any, name: str = "hitl-beaglebone") -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps({"graph": graph}))
    (folder / "profile.yaml").write_text(resolved_yaml(load_profile(name)))
    return folder


def test_the_graph_of_a_run_directory(tmp_path: Path) -> None:
    found = section("hitl-beaglebone", traffic={"agent": {**EVERYTHING, "tx": {IMU: 1}}}, nodes=[node(kind="real")])
    run = measured_run(run_directory(tmp_path, found))
    assert run.missing == ("D-LC",)
    assert run.wdri.wdri == found["measured"]["wdri"]
    assert run.wdri.d_w_sim == found["measured"]["d_w_sim"]
    assert run.claimed_wdri == profile_wdri(load_profile("hitl-beaglebone")).wdri
    assert run.wdri.wdri < run.claimed_wdri


@pytest.mark.medium
def test_the_graphs_of_a_fleets_directory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = section("hitl-beaglebone", traffic={"agent": {**EVERYTHING, "tx": {IMU: 1}}}, nodes=[node(kind="real")])
    board = section("hitl-beaglebone", traffic={"agent": EVERYTHING}, nodes=[node(kind="real")])
    folder = run_directory(tmp_path, found, "fleet-crossing")
    summary = {"vessels": {"own": {"graph": found}, "target": {"graph": board}}}
    (folder / "summary.json").write_text(json.dumps(summary))
    wdri(str(folder), as_json=True)
    document = json.loads(capsys.readouterr().out)
    indices = {name: one["wdri"] for name, one in document["vessels"].items()}
    assert indices == {"own": found["measured"]["wdri"], "target": board["measured"]["wdri"]}
    assert document["wdri"] == sum(indices.values()) / 2
    wdri(str(folder), vessel="own", as_json=True)
    assert json.loads(capsys.readouterr().out)["missing"] == ["D-LC"]
    with pytest.raises(UserError, match="barge"):
        wdri(str(folder), vessel="barge")


def test_the_command_shows_a_run_within_80_columns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for variable in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(variable, raising=False)
    found = section(traffic={"agent": {**EVERYTHING, "tx": {}}})
    folder = run_directory(tmp_path, found, "sitl")
    wdri(str(folder))
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80
    assert "D-LC, PS1-LS" in text
    assert f"{found['claimed']['wdri']:.4f}" in text
    assert f"{found['measured']['wdri']:.4f}" in text
    wdri(str(folder), reference="complete", as_json=True)
    document = json.loads(capsys.readouterr().out)
    assert (document["reference"], document["missing"]) == ("complete", ["D-LC", "PS1-LS"])


def test_run_directories_that_cannot_be_shown(tmp_path: Path, golden: Golden) -> None:
    folder = run_directory(tmp_path, {"measured": {}})
    with pytest.raises(UserError) as refused:
        wdri(str(folder))
    golden("error", refused.value)
    (folder / "summary.json").write_text("{}")
    with pytest.raises(UserError) as refused:
        wdri(str(folder))
    golden("second error", refused.value)
    (folder / "summary.json").write_text("{")
    with pytest.raises(UserError, match=r"summary.json: cannot be read"):
        wdri(str(folder))
    with pytest.raises(UserError, match="is a finished run, which --set cannot change"):
        wdri(str(folder), overrides=["a=b"])
    found = section(traffic={}, nodes=[])
    found["measured"] = {**found["measured"], "nodes": [], "links": []}
    (folder / "summary.json").write_text(json.dumps({"graph": found}))
    with pytest.raises(UserError, match="nothing was measured, the run ended before it began"):
        wdri(str(folder))
