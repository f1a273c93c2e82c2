"""Motion and sensors in a log of an autopilot, as ROS messages in the frames of `frames`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import xitl_cli.logs.signals as signals
from sim_core.frames import (
    euler_to_quat,
    frd_to_flu,
    ned_to_enu,
    quat_ned_frd_to_enu_flu,
    quat_to_matrix,
)
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.signals.sensors import inertial_units
from xitl_cli.plugins.ros import msg
from xitl_cli.plugins.ros.frames import GNSS_FRAME, IMU_FRAME
from xitl_cli.plugins.ros.outputs import OUTPUTS, RosTopic
from xitl_cli.record.topics import MAP_FRAME, ODOM_FRAME, UNKNOWN_VARIANCE, VESSEL_FRAME

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
_UNKNOWN_COVARIANCE = np.diag([UNKNOWN_VARIANCE] * 6).reshape(36)


class LogMessage(NamedTuple):
    """A message of a topic, with its instant."""

    topic: RosTopic
    message: Any
    stamp_ns: int


def log_messages(log: Log, shift_ns: int = 0) -> list[Iterator[LogMessage]]:
    """Return fixes, odometry with its transforms, the first inertial unit, modes: each in the order of time.

    shift_ns: added to all stamps of the log. A log of topics gives nothing, because it contains messages already.
    """
    if log.of_topics:
        return []
    return [read(log, shift_ns) for read in (_fixes, _odometry, _imu, _modes)]


def _modes(log: Log, shift_ns: int) -> Iterator[LogMessage]:
    for mode in signals.modes(log):
        yield LogMessage(OUTPUTS["mode"], msg.String(data=mode.text), mode.from_ns + shift_ns)


def _fixes(log: Log, shift_ns: int) -> Iterator[LogMessage]:
    """Yield fixes. Altitudes are those of the log, mostly above mean sea level; the accuracy is unknown."""
    positions = signals.position_geodetic(log)
    if positions is None:
        return
    status = msg.NavSatStatus(status=msg.NavSatStatus.STATUS_FIX, service=msg.NavSatStatus.SERVICE_GPS)
    for stamp_ns, (latitude, longitude, altitude) in zip(
        (positions.stamp_ns + shift_ns).tolist(), positions.values.tolist(), strict=True
    ):
        fix = msg.NavSatFix(
            header=msg.header(stamp_ns, GNSS_FRAME),
            status=status,  # type: ignore[arg-type]  # as in Dashing
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=np.zeros(9),
            position_covariance_type=msg.NavSatFix.COVARIANCE_TYPE_UNKNOWN,
        )
        yield LogMessage(OUTPUTS["fix"], fix, stamp_ns)


def _odometry(log: Log, shift_ns: int) -> Iterator[LogMessage]:
    """Yield positions with the attitudes of those instants; the velocity is the slope of the positions.

    Turn rates are zero, and all variances are UNKNOWN_VARIANCE.
    """
    position = signals.position_ned(log)
    if position is None or len(position.path.stamp_ns) < 2:
        return
    stamps = position.path.stamp_ns
    turn_ned = attitudes(log, stamps)
    if turn_ned is None:
        return
    seconds = (stamps - stamps[0]).astype(np.float64) * 1e-9
    velocity_ned = np.gradient(position.path.values, seconds, axis=0)
    rotation = quat_to_matrix(turn_ned)
    linear = frd_to_flu(np.einsum("nij,ni->nj", rotation, velocity_ned))
    place, turn = ned_to_enu(position.path.values), quat_ned_frd_to_enu_flu(turn_ned)
    rest = msg.Transform(translation=msg.Vector3(0.0, 0.0, 0.0), rotation=msg.Quaternion(0.0, 0.0, 0.0, 1.0))
    first_ns = int(stamps[0]) + shift_ns
    fixed = msg.TransformStamped(msg.header(first_ns, MAP_FRAME), ODOM_FRAME, rest)
    yield LogMessage(OUTPUTS["/tf_static"], msg.TFMessage(transforms=[fixed]), first_ns)
    known = np.isfinite(turn).all(axis=1)
    for row in np.flatnonzero(known).tolist():
        stamp_ns = int(stamps[row]) + shift_ns
        east, north, up = place[row].tolist()
        w, x, y, z = turn[row].tolist()
        attitude, header = msg.Quaternion(x, y, z, w), msg.header(stamp_ns, ODOM_FRAME)
        twist = msg.Twist(linear=msg.Vector3(*linear[row].tolist()), angular=msg.Vector3(0.0, 0.0, 0.0))
        odometry = msg.Odometry(
            header=header,
            child_frame_id=VESSEL_FRAME,
            pose=msg.PoseWithCovariance(
                pose=msg.Pose(msg.Point(east, north, up), attitude), covariance=_UNKNOWN_COVARIANCE
            ),
            twist=msg.TwistWithCovariance(twist=twist, covariance=_UNKNOWN_COVARIANCE),
        )
        yield LogMessage(OUTPUTS["odometry"], odometry, stamp_ns)
        moved = msg.TransformStamped(header, VESSEL_FRAME, msg.Transform(msg.Vector3(east, north, up), attitude))
        yield LogMessage(OUTPUTS["/tf"], msg.TFMessage(transforms=[moved]), stamp_ns)


def _imu(log: Log, shift_ns: int) -> Iterator[LogMessage]:
    unit = next(
        (unit for unit in inertial_units(log) if unit.gyro_radps is not None and unit.accel_mps2 is not None), None
    )
    if unit is None or unit.gyro_radps is None or unit.accel_mps2 is None:
        return
    gyro, accel = frd_to_flu(unit.gyro_radps), frd_to_flu(unit.accel_mps2)
    turn_ned = attitudes(log, unit.stamp_ns)
    turn = None if turn_ned is None else quat_ned_frd_to_enu_flu(turn_ned)
    unknown, not_given = np.zeros(9), np.array([-1.0, *[0.0] * 8])
    for row in np.flatnonzero(np.isfinite(gyro + accel).all(axis=1)).tolist():
        stamp_ns = int(unit.stamp_ns[row]) + shift_ns
        known = turn is not None and bool(np.isfinite(turn[row]).all())
        w, x, y, z = turn[row].tolist() if turn is not None and known else (1.0, 0.0, 0.0, 0.0)
        message = msg.Imu(
            header=msg.header(stamp_ns, IMU_FRAME),
            orientation=msg.Quaternion(x, y, z, w),
            orientation_covariance=unknown if known else not_given,
            angular_velocity=msg.Vector3(*gyro[row].tolist()),
            angular_velocity_covariance=unknown,
            linear_acceleration=msg.Vector3(*accel[row].tolist()),
            linear_acceleration_covariance=unknown,
        )
        yield LogMessage(OUTPUTS["imu/data"], message, stamp_ns)


def attitudes(log: Log, stamp_ns: Stamps) -> Array | None:
    """Return (N, 4) w x y z from FRD to NED at instants (N,), NaN outside the log; None without attitudes."""
    angles = [signals.roll(log), signals.pitch(log), signals.yaw(log)]
    known_deg = [angle.interpolated(stamp_ns) for angle in angles if angle is not None]
    return euler_to_quat(np.radians(np.stack(known_deg, axis=-1))) if len(known_deg) == 3 else None
