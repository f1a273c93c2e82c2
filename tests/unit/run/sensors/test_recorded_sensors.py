"""Samples of a bag in place of simulated ones: axes, units, times."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from xitl_cli.errors import UserError
from xitl_cli.profile.schema.sensors import RecordedSensorsSpec
from xitl_cli.profile.schema.world import SiteSpec
from xitl_cli.run.sensors import sensor_messages
from xitl_cli.run.sensors.recorded import RecordedChannel, read_samples

STORE = get_typestore(Stores.ROS1_NOETIC)
T = STORE.types
BEGIN_NS = 1_700_000_000 * 10**9
SITE = SiteSpec(name="harbour", latitude_deg=52.0, longitude_deg=4.0, altitude_m=0.0)
NINE = np.zeros(9)


def vector(*xyz: float) -> Any:
    return T["geometry_msgs/msg/Vector3"](*xyz)


def header(stamp_ns: int) -> Any:
    return T["std_msgs/msg/Header"](0, T["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9), "link")


def imu(stamp_ns: int, yaw_rate_radps: float) -> Any:
    turn = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return T["sensor_msgs/msg/Imu"](
        header(stamp_ns), turn, NINE, vector(0.1, 0.2, yaw_rate_radps), NINE, vector(1.0, 2.0, 9.8), NINE
    )


def fix(stamp_ns: int, latitude_deg: float, status: int = 0) -> Any:
    covariance = np.diag([9.0, 16.0, 36.0]).ravel()
    return T["sensor_msgs/msg/NavSatFix"](
        header(stamp_ns), T["sensor_msgs/msg/NavSatStatus"](status, 1), latitude_deg, 4.0, 3.0, covariance, 2
    )


def bag(path: Path, *rows: tuple[str, int, Any]) -> Path:
    """Topic, when it came (ns) and message; it came 20 ms after it was made."""
    with Writer(path) as writer:
        connections: dict[str, Any] = {}
        for topic, stamp_ns, message in sorted(rows, key=lambda row: row[1]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], stamp_ns + 20_000_000, STORE.serialize_ros1(message, kind))
    return path


def sent(channel: RecordedChannel, until_ns: int, step_ns: int = 2_500_000) -> list[tuple[int, Any]]:
    still: Any = None  # nothing is measured
    found = []
    for now_ns in range(step_ns, until_ns + 1, step_ns):
        message = channel.message(now_ns, still, np.zeros((1, 3)))
        if message is not None:
            found.append((now_ns, message))
    return found


def test_samples_come_at_their_times_in_our_axes_and_units(tmp_path: Path) -> None:
    stamps = [BEGIN_NS + number * 10_000_000 for number in range(5)]
    field = T["sensor_msgs/msg/MagneticField"](header(stamps[0]), vector(2e-5, 1e-5, -4e-5), NINE)
    pressure = T["sensor_msgs/msg/FluidPressure"](header(stamps[0]), 101_000.0, 0.0)
    rows = [("/imu", stamp, imu(stamp, 0.01 * number)) for number, stamp in enumerate(stamps)]
    path = bag(tmp_path / "boat.bag", *rows, ("/mag", stamps[0], field), ("/air", stamps[0], pressure))
    # Counted from the first message that came, 20 ms after the first was made.
    found = read_samples(RecordedSensorsSpec(file=str(path)), SITE)
    assert found["gnss"].stamp_ns.tolist() == []  # it is silent, not simulated
    assert found["imu"].stamp_ns.tolist() == [0, 10_000_000, 20_000_000]
    channel = RecordedChannel(found["imu"], sensor_messages.imu)
    came = sent(channel, 30_000_000)
    assert [now_ns for now_ns, _ in came] == [2_500_000, 10_000_000, 20_000_000]
    assert [message.time_usec for _, message in came] == [0, 10_000, 20_000]
    assert np.allclose(came[0][1].gyro, (0.1, -0.2, -0.02))
    assert np.allclose(came[0][1].accel, (1.0, -2.0, -9.8))
    assert channel.skipped == 0


def test_magnetic_field_and_pressure_are_converted(tmp_path: Path) -> None:
    field = T["sensor_msgs/msg/MagneticField"](header(BEGIN_NS + 10**8), vector(2e-5, 1e-5, -4e-5), NINE)
    pressure = T["sensor_msgs/msg/FluidPressure"](header(BEGIN_NS + 10**8), 101_000.0, 0.0)
    early = ("/imu", BEGIN_NS, imu(BEGIN_NS, 0.0))
    path = bag(tmp_path / "boat.bag", early, ("/mag", BEGIN_NS + 10**8, field), ("/air", BEGIN_NS + 10**8, pressure))
    found = read_samples(RecordedSensorsSpec(file=str(path), barometer="/air", imu="simulated"), SITE)
    assert set(found) == {"gnss", "magnetometer", "barometer"}
    assert np.allclose(found["magnetometer"].sample(0).field_frd_gauss, [[0.2, -0.1, 0.4]])
    assert found["barometer"].sample(0).pressure_pa.tolist() == [101_000.0]


def test_fixes_have_their_accuracy_and_the_velocity_from_one_to_the_next(tmp_path: Path) -> None:
    times = [BEGIN_NS + number * 10**9 for number in range(4)]
    degree_m = 2 * math.pi * 6_378_137.0 / 360.0
    rows = [("/fix", at, fix(at, 52.0 + 5.0 * number / degree_m)) for number, at in enumerate(times[:3])]
    early = ("/imu", BEGIN_NS - 10**9, imu(BEGIN_NS - 10**9, 0.0))
    path = bag(tmp_path / "boat.bag", early, *rows, ("/fix", times[3], fix(times[3], math.nan, -1)))
    gnss = read_samples(RecordedSensorsSpec(file=str(path), from_s=0.5), SITE)["gnss"]
    assert gnss.stamp_ns.tolist() == [480_000_000 + number * 10**9 for number in range(4)]
    second, lost = gnss.sample(1), gnss.sample(3)
    assert second.vel_ned_mps[0] == pytest.approx([5.0, 0.0, 0.0], rel=5e-3, abs=1e-3)  # the Earth is no sphere
    assert second.horizontal_accuracy_m[0] == 5.0
    assert second.vertical_accuracy_m[0] == 6.0
    assert second.fix_type[0] == 3
    assert lost.fix_type[0] == 1
    assert lost.satellites[0] == 0


def test_of_a_faster_sensor_the_newest_is_sent_and_the_others_counted(tmp_path: Path) -> None:
    rows = [("/imu", stamp, imu(stamp, 0.0)) for stamp in range(BEGIN_NS, BEGIN_NS + 100_000_000, 1_000_000)]
    found = read_samples(RecordedSensorsSpec(file=str(bag(tmp_path / "boat.bag", *rows))), SITE)
    channel = RecordedChannel(found["imu"], sensor_messages.imu)
    came = sent(channel, 100_000_000)
    assert channel.skipped + len(came) == len(found["imu"].stamp_ns) == 80


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"gnss": "/gps"}, "for sensors.recorded.gnss"),
        ({"from_s": 100.0}, "another sensors.recorded.from_s"),
        ({"file": "no.bag"}, "does not exist"),
        ({}, "site.latitude_deg: 10.00000"),
        ({"gnss": "simulated"}, "select one of them by sensors.recorded.imu"),
    ],
)
def test_what_cannot_be_injected_is_refused(tmp_path: Path, given: dict[str, Any], said: str) -> None:
    rows = [("/fix", BEGIN_NS, fix(BEGIN_NS, 10.0)), ("/imu/a", BEGIN_NS + 10**8, imu(BEGIN_NS + 10**8, 0.0))]
    if given.get("gnss") == "simulated":
        rows.append(("/imu/b", BEGIN_NS + 10**8, imu(BEGIN_NS, 0.0)))
    rows.append(("/fix", BEGIN_NS + 10**9, fix(BEGIN_NS + 10**9, 10.0)))
    path = bag(tmp_path / "boat.bag", *rows)
    with pytest.raises(UserError, match=said):
        read_samples(RecordedSensorsSpec(**{"file": str(path), **given}), SITE)
