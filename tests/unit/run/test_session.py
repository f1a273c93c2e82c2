"""What is left behind when something breaks inside a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from agent.wire import dialect
from tests.free_ports import free_port
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.profile import load_profile
from xitl_cli.record.recorder import Recorder
from xitl_cli.run import session
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.links.connection import AgentConnection
from xitl_cli.run.nodes.autopilot import AutopilotNode
from xitl_cli.run.nodes.direct_control import IdealControl
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.nodes.drivers import MissionItems, NoDriver
from xitl_cli.seeds import Seeds


@pytest.mark.medium
def test_a_fault_of_our_own_is_seen_and_still_leaves_summary_and_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exchange = IdealControl.exchange

    def breaks(self, step):
        if step.now_ns > 500_000_000:
            raise ZeroDivisionError("a fault")
        exchange(self, step)

    monkeypatch.setattr(IdealControl, "exchange", breaks)
    with pytest.raises(ZeroDivisionError, match="a fault"):
        session.run(load_profile("mitl"), tmp_path / "run", False, NoDisplay)
    told = json.loads((tmp_path / "run/summary.json").read_text())
    assert told["ended"] == "failed"
    assert "ZeroDivisionError" in told["error"]
    with (tmp_path / "run/run.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file).iter_messages(topics=["/truth/state"])) == 25
    with open_log(tmp_path / "run/run.mcap") as log:
        assert log.tables["/log"].values("message")[-1] == told["error"]


@pytest.mark.medium
def test_a_recording_that_cannot_be_begun_ends_in_a_sentence_and_a_summary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(recorder: Recorder, name: str, media_type: str, data: bytes) -> None:
        raise UserError("run.mcap: the recording cannot be written (No space left on device); free space")

    monkeypatch.setattr(Recorder, "attach", full)
    result = session.run(load_profile("sitl"), tmp_path / "run", False, NoDisplay)
    assert result.exit_code == session.USER_ERROR
    told = json.loads((tmp_path / "run/summary.json").read_text())
    assert "No space left on device" in told["error"]
    assert [clock["node"] for clock in told["clocks"]] == ["LC", "PS1"]


def test_a_folder_that_is_taken_is_refused_before_a_live_output_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "live_outputs", lambda profiles: pytest.fail("ROS was entered"))
    (tmp_path / "run.mcap").touch()
    profile = load_profile("sitl", ["ros.enabled=true"])
    with pytest.raises(UserError, match=r"already contains a run \(run.mcap\)"):
        session.run(profile, tmp_path, False, NoDisplay)


@pytest.mark.medium
def test_ctrl_c_is_heeded_while_an_autopilot_started_elsewhere_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session.Interruption, "__call__", lambda self: True)
    urls = [f"autopilot.bridge.mavlink=tcp://127.0.0.1:{free_port()}"]
    urls += [f"autopilot.bridge.world=udp://127.0.0.1:{free_port()}"]
    profile = load_profile("sitl-ardupilot", ["autopilot.firmware=external", *urls])
    result = session.run(profile, tmp_path / "run", False, NoDisplay)
    assert result.exit_code == session.INTERRUPTED
    assert (result.summary["ended"], result.summary["error"]) == ("interrupted", None)


def test_an_agent_still_at_the_run_of_another_host_can_be_reached() -> None:
    """What it believes of that run is nothing to this one, which has not begun."""
    profile = load_profile("sitl").runnable()
    autopilot = AutopilotNode(profile, Seeds(1), lambda commands, agent: NoDriver(commands, MissionItems()))
    view = autopilot.agents[0].inbox.view
    view.handle(dialect.MAVLink_gps_global_origin_message(-88_000_000, -639_500_000, 70_000, 0))
    view.handle(dialect.MAVLink_attitude_quaternion_message(500, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    view.handle(dialect.MAVLink_local_position_ned_message(500, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0))
    assert autopilot.position_error_m is None


@pytest.mark.medium
def test_the_clock_is_asked_for_ahead_of_samples_at_any_rate_of_exchange(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind them the request would wait until the agent is done with them, for milliseconds on a slow board."""
    said: list[tuple[str, int]] = []
    step_ns = 0
    sense, request_time, send_sensors = AutopilotNode.sense, AgentConnection.request_time, AgentConnection.send_sensors

    def noting_step(node: AutopilotNode, step: RunStep) -> None:
        nonlocal step_ns
        step_ns = step.now_ns
        sense(node, step)

    def noting_request(agent: AgentConnection) -> None:
        said.append(("request", step_ns))
        request_time(agent)

    def noting_samples(agent: AgentConnection, messages: list[Any]) -> None:
        said.append(("samples", step_ns))
        send_sensors(agent, messages)

    monkeypatch.setattr(AutopilotNode, "sense", noting_step)
    monkeypatch.setattr(AgentConnection, "request_time", noting_request)
    monkeypatch.setattr(AgentConnection, "send_sensors", noting_samples)
    profile = load_profile("hitl-loopback", ["clock.exchange_rate_hz=10", "clock.duration_s=1"])
    session.run(profile, tmp_path / "run", False, NoDisplay)
    in_the_run = [number for number, (kind, at_ns) in enumerate(said) if kind == "request" and at_ns]
    assert len(in_the_run) >= 8
    assert all(said[number - 1][1] < said[number][1] for number in in_the_run)
