"""Motor outputs out of bags: what nodes asked of thrusters, and what MAVROS said of servos."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import xitl_cli.logs.signals as signals
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.replay.motor_schedule import schedule_from_file
from xitl_cli.replay.pulse_log import read_pulse_log

STORE = get_typestore(Stores.ROS1_NOETIC)
STORE.register(
    get_types_from_msg("Header header\nuint16[] channels", "mavros_msgs/msg/RCOut")
    | get_types_from_msg("Header header\nbool armed\nstring mode", "mavros_msgs/msg/State")
)
BEGIN_NS = 1_700_000_000 * 10**9
Rows = list[tuple[float, str, str, dict[str, Any]]]


def bag(path: Path, rows: Rows) -> Path:
    """Seconds, topic, type and fields of each message."""
    with Writer(path) as writer:
        connections: dict[str, Any] = {}
        for at_s, topic, kind, fields in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            if "Float" not in kind:
                stamp = STORE.types["builtin_interfaces/msg/Time"](0, 0)
                fields = {"header": STORE.types["std_msgs/msg/Header"](0, stamp, ""), **fields}
            data = STORE.serialize_ros1(STORE.types[kind](**fields), kind)
            writer.write(connections[topic], BEGIN_NS + round(at_s * 1e9), data)
    return path


def thrusts(*given: tuple[float, str, float]) -> Rows:
    return [(at_s, topic, "std_msgs/msg/Float64", {"data": value}) for at_s, topic, value in given]


def replaying(file: Path, *settings: str) -> RunProfile:
    base = ["technique=mitl", "driver.kind=replay", f"driver.file={file}", "autopilot.kind=none"]
    return load_profile("sitl", overrides=[*base, *settings])


def test_thrust_at_rest_becomes_the_speed_that_gives_it(tmp_path: Path) -> None:
    rows = thrusts(
        (0.0, "/wamv/thrusters/left/cmd", 0.0),
        (1.0, "/wamv/thrusters/left/cmd", 25.0),
        (1.5, "/wamv/thrusters/right/thrust", -1e9),
        (2.0, "/wamv/thrusters/left/cmd", 1e9),
    )
    profile = replaying(bag(tmp_path / "boat.bag", rows))
    ahead_n = profile.vehicle.propellers[0].static_thrust_n(profile.environment.water.density_kgpm3)[0]
    schedule = schedule_from_file(profile, profile.vehicle)
    quarter = math.sqrt(25.0 / ahead_n)  # thrust grows with the square of the speed
    assert schedule.at_ns == (0, 500_000_000, 1_000_000_000)  # from the first command that is not neutral on
    assert np.allclose(schedule.motors, [(quarter, 0.0), (quarter, -1.0), (1.0, -1.0)])
    assert schedule.end_ns == 1_000_000_000


def test_shares_are_commands_already(tmp_path: Path) -> None:
    rows = thrusts((0.0, "/thrusters/left/cmd", 0.5), (1.0, "/thrusters/right/cmd", -0.25))
    profile = replaying(bag(tmp_path / "boat.bag", rows), "driver.replay.thrust=share")
    assert schedule_from_file(profile, profile.vehicle).motors == ((0.5, 0.0), (0.5, -0.25))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (thrusts((0.0, "/thrusters/left/cmd", 0.0)), "all thruster commands are zero"),
        (thrusts((0.0, "/thrusters/left/cmd", 1.0), (0.5, "/thrusters/left/cmd", math.nan)), "at 0.500 s"),
        (thrusts((0.0, "/a/thrusters/left/cmd", 1.0), (0.5, "/b/thrusters/left/cmd", 1.0)), "one vessel"),
        (thrusts((0.0, "/speed", 1.0)), "mavros/rc/out"),
    ],
)
def test_a_bag_of_which_nothing_can_be_replayed_is_refused(tmp_path: Path, rows: Rows, said: str) -> None:
    profile = replaying(bag(tmp_path / "boat.bag", rows))
    with pytest.raises(UserError, match=said):
        schedule_from_file(profile, profile.vehicle)


def test_servo_outputs_arming_and_modes_are_those_of_mavros(tmp_path: Path) -> None:
    rows: Rows = [(0.0, "/mavros/state", "mavros_msgs/msg/State", {"armed": False, "mode": "HOLD"})]
    rows += [(1.0, "/mavros/state", "mavros_msgs/msg/State", {"armed": True, "mode": "AUTO"})]
    for at_s, left, right in ((0.5, 1500, 1500), (1.25, 1700, 1300), (2.0, 1900, 1500)):
        channels = np.array([left, 0, right], dtype=np.uint16)
        rows.append((at_s, "/mavros/rc/out", "mavros_msgs/msg/RCOut", {"channels": channels}))
    path = bag(tmp_path / "boat.bag", sorted(rows, key=lambda row: row[0]))
    log = read_pulse_log(path)
    assert log.at_s == (0.5, 1.25, 2.0)
    assert log.pulses_us == {1: (1500.0, 1700.0, 1900.0), 3: (1500.0, 1300.0, 1500.0)}
    assert log.armed_s == 1.0
    schedule = schedule_from_file(replaying(path), load_profile("sitl").vehicle)
    assert schedule.motors == ((0.5, -0.5), (1.0, 0.0))
    with open_log(path) as opened:
        assert [(span.text, span.from_ns - BEGIN_NS) for span in signals.modes(opened)] == [
            ("HOLD", 0),
            ("AUTO", 1_000_000_000),
        ]
