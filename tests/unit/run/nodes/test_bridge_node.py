"""What the host makes of what comes from a bridge, and when it gives up."""

from __future__ import annotations

import io
import json
import lzma
import time
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table

from agent.bridges.counts import BridgeCounts
from agent.mavlink.commands import StatusTextSender
from agent.wire import dialect
from agent.wire.codec import Packer, decode
from sim_core.kinematics import Kinematics
from tests.golden import Golden
from xitl_cli.commands.sim_report import autopilot_rows
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.logs.model.log import LogHealth
from xitl_cli.profile import load_profile
from xitl_cli.record.topics import MotorCommand, TaskTiming
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.nodes.bridge import NO_BRIDGE_NS, BridgeNode, SchedulerRecord, drop_partial_record
from xitl_cli.run.nodes.drivers import MissionItems, NoDriver
from xitl_cli.run.world.world import local_frame

LOGS = Path(__file__).parents[3] / "data" / "logs"
SECOND = 1_000_000_000
STILL = MotorCommand((0.0, 0.0))
EXTERNAL = [
    "autopilot.firmware=external",
    "autopilot.bridge.mavlink=tcp://127.0.0.1:5760",
    "autopilot.bridge.world=udp://127.0.0.1:9002",
]


def at_rest() -> Kinematics:
    zero = np.zeros((1, 3))
    return Kinematics(zero, zero, zero, np.array([[1.0, 0.0, 0.0, 0.0]]), np.eye(3)[None], zero, zero)


BRIDGE_COUNTS = [field.name for field in fields(BridgeCounts)]


class Case:
    def __init__(self, name: str = "sitl-ardupilot", overrides: Sequence[str] = EXTERNAL) -> None:
        profile = load_profile(name, overrides).runnable()
        frame = local_frame(profile.site)
        self.sent: list[Any] = []
        self.view = AgentView(frame, lambda *_: None, lambda *_: None)
        self.bridge = BridgeNode(profile, None)
        driver = NoDriver(AutopilotCommands(self.view, self.sent.append, 1, 1), MissionItems())
        agent: Any = SimpleNamespace(target=(1, 1), inbox=SimpleNamespace(view=self.view, command=STILL))
        self.bridge.preparation(driver, agent, self.sent.append, frame)
        self._packer = Packer(1, 1)

    def hear(self, message: Any) -> None:
        message = decode(self._packer.pack(message))
        self.view.handle(message)
        self.bridge.handle(message)

    def say(self, severity: int, text: str) -> None:
        for message in StatusTextSender().messages(severity, text):
            self.hear(message)

    def status(self, **counts: int) -> None:
        values = {name: counts.get(name, 0) for name in BRIDGE_COUNTS}
        self.hear(dialect.MAVLink_xitl_bridge_status_message(time_usec=1, **values))

    def update(self, sim_ns: int) -> None:
        world: Any = None
        self.bridge.exchange(RunStep(1, sim_ns, world, at_rest()))


def test_the_wrong_vehicle_ends_the_run_and_other_sentences_of_the_bridge_do_not(golden: Golden) -> None:
    case = Case()
    case.status()
    case.say(3, "Bridge: the line to the autopilot is full")
    case.say(6, "Bridge: the autopilot is heard")
    case.update(SECOND)
    case.say(3, "Bridge: the autopilot is a fixed-wing aircraft (MAV_TYPE 1), not a rover or boat")
    with pytest.raises(UserError) as refused:
        case.update(2 * SECOND)
    golden("error", refused.value)


def test_another_make_ends_the_run(golden: Golden) -> None:
    case = Case()
    case.hear(dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_SURFACE_BOAT, dialect.MAV_AUTOPILOT_PX4, 0, 0, 4, 3))
    with pytest.raises(UserError) as refused:
        case.update(SECOND)
    golden("error", refused.value, "12")


def heartbeat(armed: bool) -> Any:
    flags = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_SURFACE_BOAT, 3, flags, 0, 4, 3)


def test_one_that_starts_anew_in_the_mission_ends_the_run_and_before_it_arms_it_does_not() -> None:
    case = Case()
    case.status(restarts=1)
    case.hear(heartbeat(armed=False))
    case.update(SECOND)
    case.hear(heartbeat(armed=True))
    case.update(2 * SECOND)
    case.hear(heartbeat(armed=False))
    case.update(3 * SECOND)  # disarmed by a person
    case.status(restarts=2)
    with pytest.raises(UserError, match=r"^the autopilot restarted during the mission, before 4.0 s"):
        case.update(4 * SECOND)


def test_the_autopilots_utc_is_compared_with_the_hosts() -> None:
    case = Case("hitl-ardupilot-usb", ())
    assert case.bridge.known().utc_offset_s is None
    case.hear(dialect.MAVLink_system_time_message(round((time.time() + 3600.0) * 1e6), 12_000))
    assert case.bridge.known().utc_offset_s == pytest.approx(3600.0, abs=60.0)


def test_nobody_who_asks_for_the_world_is_told_apart_from_one_that_stopped(golden: Golden) -> None:
    case = Case()
    assert case.bridge.silent_s() == 20.0  # time to start it elsewhere
    golden("error", case.bridge.why_silent(20.0, 0.0), "20 s")
    case.hear(heartbeat(armed=False))
    assert case.bridge.silent_s() == 10.0
    golden("second error", case.bridge.why_silent(10.0112, 3.14), "10 s", "3.14 s")


def test_what_the_bridge_complained_of_last_goes_with_the_reason_until_it_is_over() -> None:
    case = Case()
    case.say(4, "Bridge: the script on the autopilot does not answer; set SCR_ENABLE 1 and install it")
    case.say(6, "an autopilot's own sentence, which is so long that it comes in more than one part")
    ending = (
        "cables and its log; the bridge reports: the script on the autopilot does not answer; set SCR_ENABLE 1 and "
    )
    case.hear(heartbeat(armed=False))
    assert ending in str(case.bridge.why_silent(1.0, 2.0))
    case.say(5, "Bridge: the script on the autopilot speaks again")
    assert str(case.bridge.why_silent(1.0, 2.0)).endswith("cables and its log")


def test_an_agent_that_is_no_bridge_is_found_out() -> None:
    case = Case()
    case.hear(dialect.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3))
    case.update(NO_BRIDGE_NS)
    with pytest.raises(UserError, match="and is no bridge"):
        case.update(NO_BRIDGE_NS + 1)
    case.status()
    case.update(NO_BRIDGE_NS + 2)


@pytest.mark.parametrize(
    ("number", "custom", "words"),
    [
        (0x040603FF, b"3fc7011a", "4.6.3 (3fc7011a)"),
        (0x04070000, b"2598e9d4", "4.7.0-dev (2598e9d4)"),
        (0x040700C0, b"\0" * 8, "4.7.0-rc"),
    ],
)
def test_the_report_tells_who_it_was_and_what_the_bridge_counted(number: int, custom: bytes, words: str) -> None:
    case = Case()
    zeros = (0,) * 8
    case.hear(dialect.MAVLink_autopilot_version_message(0, number, 0, 0, 0, list(custom), zeros, zeros, 0, 0, 0))
    case.hear(dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_SURFACE_BOAT, 3, 0, 0, 4, 3))
    case.status(imu_out=200, world_in=1200, world_rate=1200, connected=3)
    report = case.bridge.known()
    assert report.firmware == words
    assert report.vehicle == "surface boat"
    assert report.bridge is not None
    assert report.bridge.imu_out == 200
    assert report.program is None
    assert not report.log


def test_the_summary_is_plain_data_and_the_report_fits_80_columns(tmp_path: Path) -> None:
    case = Case()
    case.hear(dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_SURFACE_BOAT, 3, 0, 0, 4, 3))
    case.status(imu_out=36_782, solution_out=233_182, gnss_out=919, outputs_in=18_667, world_rate=1200, unsent=31)
    case.update(SECOND)
    report = case.bridge.known()
    record = SchedulerRecord(18, ("NLon", "NL", "MaxT", "Load"), 8999, 12, 20_300, 10.2, 31.0)
    tasks = [
        TaskTiming("PS1", "physics", 400.0, 100, 7, 0.0, 0.0, 0.0),
        TaskTiming("LC", "bridge", 10.0, 50, 2, 0.0, 0.0, 0.0),
    ]
    section = type(report)(**{**_fields(report), "scheduler": record}).section(tasks)
    assert json.loads(json.dumps(section, allow_nan=False)) == section
    assert section["time_to_heartbeat_s"] == 1.0
    assert section["time_to_origin_s"] is None
    assert section["agent"] == {"cycles": 50, "missed": 2}
    table = Table.grid(padding=(0, 2))
    for row in autopilot_rows(section):
        table.add_row(*row)
    out = io.StringIO()
    Console(file=out, width=80).print(table)
    text = out.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    for words in (
        "ardupilot surface boat",
        "36782 inertial",
        "31 not accepted",
        "12 long of 8999 loops",
        "missed 2 of 50",
    ):
        assert words in text
    assert "its log stays on its machine" in text
    assert ("", "it wrote no log") in list(autopilot_rows({**section, "program": "/opt/ardurover"}))
    assert list(autopilot_rows(None)) == []


def _fields(report: Any) -> dict[str, Any]:
    return {name: getattr(report, name) for name in type(report).__dataclass_fields__}


@pytest.mark.medium
def test_a_log_whose_last_block_ends_within_a_record_is_cut_to_whole_records(tmp_path: Path) -> None:
    log = tmp_path / "1.bin"
    log.write_bytes(lzma.decompress((LOGS / "boat-auto-external-ahrs.bin.xz").read_bytes()))
    size, before = log.stat().st_size, log_health(log)
    assert drop_partial_record(log) == before.truncated_bytes == 26
    assert log.stat().st_size == size - 26
    after = log_health(log)
    assert (after.records, after.truncated_bytes) == (before.records, 0)
    assert drop_partial_record(log) == 0


def log_health(log: Path) -> LogHealth:
    with open_log(log) as opened:
        return opened.health
