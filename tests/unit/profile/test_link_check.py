"""Links that are none, that do not go with where the agent runs, and that are too slow for what the profile wants."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from agent.assembly import assemble
from agent.node import PROTOCOL
from agent.options import Options
from agent.wire import dialect
from agent.wire.can_transfer import CanLine, Segmenter
from agent.wire.codec import Packer
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from sim_core.sensors.spec import ObstacleScannerSpec, OdometrySpec, RangefinderSpec
from tests.golden import Golden
from xitl_cli.profile import ProfileError, load_profile
from xitl_cli.profile.checks.link import MOST_SHARE, bytes_per_s, load_of
from xitl_cli.profile.schema.sensors import GpsInputSpec, MessagesSpec, SensorsSpec

Write = Callable[..., Path]


@pytest.fixture
def sensors() -> SensorsSpec:
    found = load_profile("hitl-loopback").sensors
    assert found is not None
    return found


def problem_of(write: Write, link: str, runs: str = "process", more: str = "") -> str:
    """The problem's sentence, empty for none."""
    path = write(f"extends: hitl-loopback\nautopilot:\n  runs: {runs}\n  link: {link}\n{more}")
    try:
        load_profile(str(path))
    except ProfileError as error:
        return " ".join(problem.sentence for problem in error.problems)
    return ""


@pytest.mark.parametrize(
    ("link", "runs"),
    [
        ("udp://127.0.0.1:14660", "process"),
        ("udp://127.0.0.1:0", "process"),
        ("tcp://[::1]:0", "process"),
        ("udp://[fe80::1%25usb0]:14660", "board"),
        ("tcp://beaglebone.local:14660", "board"),
        ("serial://pty?baud=921600", "process"),
        ("serial:///dev/ttyACM0?baud=921600", "board"),
        ("can://slcan/pty?bitrate=1000000", "process"),
        ("can://slcan/dev/ttyACM0?bitrate=1000000", "board"),
        ("can://socketcan/can0?bitrate=1000000&fd=true&data_bitrate=5000000", "board"),
        ("can://socketcan/vcan0?bitrate=1000000", "process"),
        ("can://udp_multicast/239.74.163.2?bitrate=1000000", "process"),
    ],
)
def test_good_links(write: Write, link: str, runs: str) -> None:
    assert problem_of(write, link, runs) == ""


@pytest.mark.parametrize(
    ("link", "runs"),
    [
        ("smoke://hill", "board"),
        ("udp://h", "board"),
        ("udp://h:0", "board"),
        ("udp://h:1/x", "board"),
        ("serial:///dev/ttyS1", "board"),
        ("can://socketcan/can0", "board"),
        ("serial:///dev/ttyS1?baud=921600", "process"),
        ("serial://pty?baud=921600", "board"),
        ("can://virtual/x?bitrate=1000000", "process"),
    ],
)
def test_bad_links(write: Write, link: str, runs: str, golden: Golden) -> None:
    golden("problem", problem_of(write, link, runs), f"autopilot.link = '{link}'")


def test_the_link_of_a_standby_is_checked_too(write: Write, golden: Golden) -> None:
    more = "  standby: {runs: board, link: 'serial://pty?baud=921600'}\n"
    golden("problem", problem_of(write, "udp://127.0.0.1:14660", more=more))
    more = "  standby: {runs: board, link: 'serial:///dev/ttyS1?baud=115200'}\n"
    assert "lower sensors.imu.rate_hz to 100 or use baud=230400" in problem_of(write, "udp://127.0.0.1:1", more=more)


def test_a_bus_with_both_agents_carries_the_traffic_of_both(write: Write, golden: Golden) -> None:
    """One agent takes 44 % of classic CAN at 1 Mbit/s, two take 87 %."""
    bus = "can://socketcan/can0?bitrate=1000000"
    assert problem_of(write, bus, "board") == ""
    own = f"  standby: {{runs: board, link: '{bus.replace('can0', 'can1')}&peer=3'}}\n"
    assert problem_of(write, bus, "board", own) == ""
    shared = f"  standby: {{runs: board, link: '{bus}&peer=3'}}\n"
    sentence = problem_of(write, bus, "board", shared)
    golden("finding", sentence, "40068 bytes/s", "2 agents", "400 Hz × 48 = 19200")
    assert "use bitrate=1000000&fd=true&data_bitrate=2000000" in sentence
    lower = re.search(r"lower sensors\.imu\.rate_hz to ([0-9.]+)", sentence)
    assert lower is not None
    assert problem_of(write, bus, "board", shared + f"sensors:\n  imu: {{rate_hz: {lower[1]}}}\n") == ""


def test_a_serial_line_that_is_too_slow_says_so_with_the_arithmetic(write: Write, golden: Golden) -> None:
    sentence = problem_of(write, "serial://pty?baud=115200")
    golden("problem", sentence, "11520 bytes/s", "80%", "(9216)", "13330 bytes/s", "100 or use baud=230400")


@pytest.mark.parametrize(
    "link", ["serial://pty?baud=115200", "can://slcan/pty?bitrate=500000", "can://slcan/pty?bitrate=250000"]
)
def test_what_the_sentence_advises_is_enough(write: Write, link: str) -> None:
    sentence = problem_of(write, link)
    lower = re.search(r"lower sensors\.imu\.rate_hz to ([0-9.]+)", sentence)
    if lower is not None:
        assert problem_of(write, link, more=f"sensors:\n  imu: {{rate_hz: {lower[1]}}}\n") == ""
    rates = re.search(r"use ((?:baud|bitrate)=[a-z0-9&=_]+)", sentence)
    assert rates is not None
    assert problem_of(write, link.partition("?")[0] + "?" + rates[1]) == ""


def test_a_bus_that_is_too_slow_counts_both_ways(write: Write, golden: Golden) -> None:
    sentence = problem_of(write, "can://slcan/pty?bitrate=250000")
    golden("finding", sentence, "11430 bytes/s")
    assert "the data need 20034 bytes/s (imu 200 Hz × 48 = 9600, " in sentence
    assert "actuators 50 Hz × 74 = 3700" in sentence


@pytest.mark.parametrize(
    ("runs", "more"), [("process", "clock: {mode: lockstep}\n"), ("in-process", "technique: sitl\n")]
)
def test_only_real_time_over_the_line_needs_its_capacity(write: Write, runs: str, more: str) -> None:
    assert problem_of(write, "serial://pty?baud=9600", runs, more) == ""


def test_the_load_is_what_the_messages_take(sensors: SensorsSpec) -> None:
    """Frames of messages without trailing zeros, which MAVLink 2 does not send."""
    imu = dialect.MAVLink_xitl_imu_message(1, [1.1] * 3, [2.2] * 3, 33.3)
    actuators = dialect.MAVLink_xitl_actuators_message(2**63, 1, 1, 1, [0.7] * 8, 2, 1)
    load = load_of(sensors)
    assert load.to_agent[0].frame_bytes == len(Packer(1, 1).pack(imu))
    assert load.to_host[0].frame_bytes == len(Packer(1, 1).pack(actuators))
    signed = load_of(sensors, signed=True)
    assert signed.to_agent[0].frame_bytes == load.to_agent[0].frame_bytes + 13
    assert bytes_per_s(signed.to_host) > bytes_per_s(load.to_host)
    line = CanLine(1_000_000)
    frames = Segmenter(1, 2, False).cut(bytes(load.to_agent[0].frame_bytes))
    alone = sum(line.frame_s(len(frame.data)) for frame in frames)
    faster = load_of(sensors, imu_rate_hz=sensors.imu.rate_hz + 1.0)
    assert faster.can_share(line) - load.can_share(line) == pytest.approx(alone)


def test_further_sensors_are_in_the_load(sensors: SensorsSpec) -> None:
    more = replace(
        sensors,
        rangefinders=(RangefinderSpec(rate_hz=5.0), RangefinderSpec(rate_hz=20.0)),
        messages=MessagesSpec(
            gps_input=GpsInputSpec(**asdict(sensors.gnss)),
            obstacle_distance=ObstacleScannerSpec(),
            odometry=OdometrySpec(),
        ),
    )
    usual = load_of(sensors).to_agent
    further = [flow for flow in load_of(more).to_agent if flow not in usual]
    assert [(flow.name, flow.rate_hz) for flow in further] == [
        ("rangefinders.0", 5.0),
        ("rangefinders.1", 20.0),
        ("messages.gps_input", sensors.gnss.rate_hz),
        ("messages.obstacle_distance", 10.0),
        ("messages.odometry", 20.0),
    ]


def test_every_task_of_an_agent_with_ground_stations_is_in_the_load(sensors: SensorsSpec, tmp_path: Path) -> None:
    here, there = memory_pair()
    with ExitStack() as opened:
        node = assemble(there, Options(ground=("tcp://127.0.0.1:0",), log_dir=tmp_path), opened)
        host = Link(here, 255, 190)
        for command in (dialect.XITL_RUN_COMMAND_START, dialect.XITL_RUN_COMMAND_STOP):
            host.send(dialect.MAVLink_xitl_run_message(0, b"", command, dialect.XITL_CLOCK_MODE_REALTIME, PROTOCOL))
            node.poll()
        told = [
            message.task for message in host.receive() if message.get_msgId() == dialect.MAVLINK_MSG_ID_XITL_TASK_STATS
        ]
    (flow,) = [flow for flow in load_of(sensors).to_host if flow.name == "task statistics"]
    assert flow.rate_hz == len(set(told)) > 4


def test_what_is_planned_with_leaves_room(sensors: SensorsSpec) -> None:
    assert MOST_SHARE == 0.8
    load = load_of(sensors)
    baud = 115_200
    assert load.serial_share(baud) == pytest.approx(bytes_per_s(load.to_agent) * 10 / baud)
