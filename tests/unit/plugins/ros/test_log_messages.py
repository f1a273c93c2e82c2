"""Messages of ROS from a log of an autopilot, against scipy's rotations."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from agent.fcu.dataflash import records
from agent.fcu.dataflash.format import FORMATS, header
from sim_core.geodesy import LocalFrame
from xitl_cli.logs import open_log
from xitl_cli.plugins.ros.log_messages import LogMessage, log_messages

LAT_DEG, LON_DEG, ALT_M = -8.8, -63.95, 60.0
ROLL_DEG, PITCH_DEG, YAW_DEG = 10.0, -5.0, 30.0
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])
BODY = Rotation.from_euler("ZYX", [YAW_DEG, PITCH_DEG, ROLL_DEG], degrees=True).as_matrix()
SHIFT_NS = 1_000_000_000_000
# The vessel goes 10 m/s to the north and 4 m/s to the east, and rises by 1 m/s.
SECONDS = (10, 11, 12, 13)
PLACES_NED_M = np.array([[10.0 * step, 4.0 * step, -1.0 * step] for step in range(4)])
GYRO, ACCEL = (0.1, 0.2, -0.3), (0.5, -0.25, -9.75)


def imu(time_us: int, gyro: tuple[float, ...] = GYRO) -> bytes:
    return FORMATS["IMU"].pack(time_us, 0, *gyro, *ACCEL, 25.0, time_us)


def geodetic(place_ned_m: Any) -> tuple[float, float, float]:
    lat_deg, lon_deg, alt_m = LocalFrame(LAT_DEG, LON_DEG, ALT_M).geodetic(place_ned_m[None])
    return float(lat_deg[0]), float(lon_deg[0]), float(alt_m[0])


def written(path: Path, attitudes: bool = True, positions: int = 4) -> Path:
    parts = [header(FORMATS, 0), FORMATS["MSG"].pack(9_000_000, b"xitl 1, messages and modes as ArduRover V4")]
    parts += [FORMATS["MODE"].pack(9_500_000, 4, 4, 0), FORMATS["MODE"].pack(11_500_000, 10, 10, 0)]
    parts.append(records.position_mark(9_600_000, records.ORIGIN, LAT_DEG, LON_DEG, ALT_M))
    for second, place in list(zip(SECONDS, PLACES_NED_M, strict=True))[:positions]:
        parts.append(FORMATS["POS"].pack(second * 1_000_000, *geodetic(place), 0.0, 0.0))
    for second in SECONDS if attitudes else ():
        parts.append(FORMATS["ATT"].pack(second * 1_000_000, 0.0, ROLL_DEG, 0.0, PITCH_DEG, 0.0, YAW_DEG))
    parts += [imu(9_000_000), imu(10_500_000), imu(11_000_000, (math.nan, 0.0, 0.0)), imu(12_250_000)]
    path.write_bytes(b"".join(parts))
    return path


def read(path: Path) -> dict[str, list[LogMessage]]:
    found: dict[str, list[LogMessage]] = {}
    with open_log(path) as log:
        for messages in log_messages(log, SHIFT_NS):
            for message in messages:
                found.setdefault(message.topic.name, []).append(message)
    return found


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[LogMessage]]:
    return read(written(tmp_path_factory.mktemp("log") / "log.bin"))


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def rotation(quaternion: Any) -> Any:
    return Rotation.from_quat([quaternion.x, quaternion.y, quaternion.z, quaternion.w]).as_matrix()


def test_modes_are_sent_at_each_change(found: dict[str, list[LogMessage]]) -> None:
    assert [(one.message.data, one.stamp_ns - SHIFT_NS) for one in found["mode"]] == [
        ("HOLD", 9_500_000_000),
        ("AUTO", 11_500_000_000),
    ]


def test_fixes_have_the_place_of_the_log_and_no_accuracy(found: dict[str, list[LogMessage]]) -> None:
    for second, place, one in zip(SECONDS, PLACES_NED_M, found["fix"], strict=True):
        assert one.stamp_ns == stamp_ns(one.message) == SHIFT_NS + second * 1_000_000_000
        lat_deg, lon_deg, alt_m = geodetic(place)
        # Stored in 1e-7 degrees.
        assert (one.message.latitude, one.message.longitude) == pytest.approx((lat_deg, lon_deg), abs=0.6e-7)
        assert one.message.altitude == pytest.approx(alt_m, abs=1e-5)
        assert (one.message.status.status, one.message.status.service) == (0, 1)
        assert one.message.position_covariance_type == 0
        assert not one.message.position_covariance.any()
        assert one.message.header.frame_id == "gnss_link"


def test_odometry_has_the_place_in_enu_and_the_velocity_in_the_vessel_s_axes(
    found: dict[str, list[LogMessage]],
) -> None:
    forward = FLU_FROM_FRD @ BODY.T @ np.array([10.0, 4.0, -1.0])
    for second, place, one, moved in zip(SECONDS, PLACES_NED_M, found["odometry"], found["/tf"], strict=True):
        message = one.message
        assert one.stamp_ns == moved.stamp_ns == stamp_ns(message) == SHIFT_NS + second * 1_000_000_000
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        assert xyz(message.pose.pose.position) == pytest.approx(ENU_FROM_NED @ place, abs=0.02)
        assert rotation(message.pose.pose.orientation) == pytest.approx(ENU_FROM_NED @ BODY @ FLU_FROM_FRD, abs=1e-5)
        assert xyz(message.twist.twist.linear) == pytest.approx(forward, abs=0.03)
        assert xyz(message.twist.twist.angular) == [0.0, 0.0, 0.0]
        variances = np.diag(message.pose.covariance.reshape(6, 6))
        assert (variances > 1e3).all()
        assert np.count_nonzero(message.pose.covariance) == 6
        assert message.twist.covariance.tolist() == message.pose.covariance.tolist()
        (transform,) = moved.message.transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
        assert xyz(transform.transform.translation) == xyz(message.pose.pose.position)
        assert transform.transform.rotation == message.pose.pose.orientation
    (static,) = found["/tf_static"]
    (fixed,) = static.message.transforms
    assert static.stamp_ns == SHIFT_NS + SECONDS[0] * 1_000_000_000
    assert (fixed.header.frame_id, fixed.child_frame_id) == ("map", "odom")
    assert xyz(fixed.transform.translation) == [0.0, 0.0, 0.0]
    assert rotation(fixed.transform.rotation).tolist() == np.eye(3).tolist()


def test_the_inertial_unit_has_an_orientation_while_there_are_attitudes(found: dict[str, list[LogMessage]]) -> None:
    """The sample that is not a number is left out."""
    messages = [one.message for one in found["imu/data"]]
    stamps = [one.stamp_ns - SHIFT_NS for one in found["imu/data"]]
    assert stamps == [9_000_000_000, 10_500_000_000, 12_250_000_000]
    for message in messages:
        assert message.header.frame_id == "imu_link"
        assert xyz(message.angular_velocity) == pytest.approx(FLU_FROM_FRD @ GYRO)
        assert xyz(message.linear_acceleration) == pytest.approx(FLU_FROM_FRD @ ACCEL)
        assert not message.angular_velocity_covariance.any()
        assert not message.linear_acceleration_covariance.any()
    before, *during = messages
    assert before.orientation_covariance.tolist() == [-1.0] + [0.0] * 8
    assert rotation(before.orientation).tolist() == np.eye(3).tolist()
    for message in during:
        assert not message.orientation_covariance.any()
        assert rotation(message.orientation) == pytest.approx(ENU_FROM_NED @ BODY @ FLU_FROM_FRD, abs=1e-5)


def test_without_attitudes_there_is_no_odometry_and_no_orientation(tmp_path: Path) -> None:
    found = read(written(tmp_path / "log.bin", attitudes=False))
    assert set(found) == {"fix", "imu/data", "mode"}
    assert all(one.message.orientation_covariance[0] == -1.0 for one in found["imu/data"])


@pytest.mark.parametrize(("positions", "there"), [(1, False), (2, True)])
def test_a_velocity_needs_two_positions(tmp_path: Path, positions: int, there: bool) -> None:
    found = read(written(tmp_path / "log.bin", positions=positions))
    assert ("odometry" in found) is there
    assert len(found["fix"]) == positions


def test_a_log_of_topics_has_messages_already() -> None:
    assert log_messages(cast(Any, SimpleNamespace(of_topics=True))) == []
