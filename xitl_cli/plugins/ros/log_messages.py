"""Motion and sensors in a log of an autopilot, as ROS messages in the frames of `frames`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores.ros2_jazzy import (
    builtin_interfaces__msg__Time as Time,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Point as Point,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Pose as Pose,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__PoseWithCovariance as PoseWithCovariance,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Quaternion as Quaternion,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Transform as Transform,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__TransformStamped as TransformStamped,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Twist as Twist,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__TwistWithCovariance as TwistWithCovariance,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Vector3 as Vector3,
)
from rosbags.typesys.stores.ros2_jazzy import (
    nav_msgs__msg__Odometry as Odometry,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__Imu as Imu,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__NavSatFix as NavSatFix,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__NavSatStatus as NavSatStatus,
)
from rosbags.typesys.stores.ros2_jazzy import (
    std_msgs__msg__Header as Header,
)
from rosbags.typesys.stores.ros2_jazzy import (
    std_msgs__msg__String as String,
)
from rosbags.typesys.stores.ros2_jazzy import (
    tf2_msgs__msg__TFMessage as TFMessage,
)

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
    return [made(log, shift_ns) for made in (_fixes, _odometry, _imu, _modes)]


def _modes(log: Log, shift_ns: int) -> Iterator[LogMessage]:
    for mode in signals.modes(log):
        yield LogMessage(OUTPUTS["mode"], String(data=mode.text), mode.from_ns + shift_ns)


def _fixes(log: Log, shift_ns: int) -> Iterator[LogMessage]:
    """Yield fixes. Altitudes are those of the log, mostly above mean sea level; the accuracy is unknown."""
    found = signals.position_geodetic(log)
    if found is None:
        return
    status = NavSatStatus(status=NavSatStatus.STATUS_FIX, service=NavSatStatus.SERVICE_GPS)
    for stamp_ns, (latitude, longitude, altitude) in zip(
        (found.stamp_ns + shift_ns).tolist(), found.values.tolist(), strict=True
    ):
        fix = NavSatFix(
            header=_header(stamp_ns, GNSS_FRAME),
            status=status,  # type: ignore[arg-type]  # as in Dashing
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=np.zeros(9),
            position_covariance_type=NavSatFix.COVARIANCE_TYPE_UNKNOWN,
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
    rest = Transform(translation=Vector3(0.0, 0.0, 0.0), rotation=Quaternion(0.0, 0.0, 0.0, 1.0))
    first_ns = int(stamps[0]) + shift_ns
    fixed = TransformStamped(_header(first_ns, MAP_FRAME), ODOM_FRAME, rest)
    yield LogMessage(OUTPUTS["/tf_static"], TFMessage(transforms=[fixed]), first_ns)
    known = np.isfinite(turn).all(axis=1)
    for row in np.flatnonzero(known).tolist():
        stamp_ns = int(stamps[row]) + shift_ns
        east, north, up = place[row].tolist()
        w, x, y, z = turn[row].tolist()
        attitude, header = Quaternion(x, y, z, w), _header(stamp_ns, ODOM_FRAME)
        twist = Twist(linear=Vector3(*linear[row].tolist()), angular=Vector3(0.0, 0.0, 0.0))
        odometry = Odometry(
            header=header,
            child_frame_id=VESSEL_FRAME,
            pose=PoseWithCovariance(pose=Pose(Point(east, north, up), attitude), covariance=_UNKNOWN_COVARIANCE),
            twist=TwistWithCovariance(twist=twist, covariance=_UNKNOWN_COVARIANCE),
        )
        yield LogMessage(OUTPUTS["odometry"], odometry, stamp_ns)
        moved = TransformStamped(header, VESSEL_FRAME, Transform(Vector3(east, north, up), attitude))
        yield LogMessage(OUTPUTS["/tf"], TFMessage(transforms=[moved]), stamp_ns)


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
        there = turn is not None and bool(np.isfinite(turn[row]).all())
        w, x, y, z = turn[row].tolist() if turn is not None and there else (1.0, 0.0, 0.0, 0.0)
        message = Imu(
            header=_header(stamp_ns, IMU_FRAME),
            orientation=Quaternion(x, y, z, w),
            orientation_covariance=unknown if there else not_given,
            angular_velocity=Vector3(*gyro[row].tolist()),
            angular_velocity_covariance=unknown,
            linear_acceleration=Vector3(*accel[row].tolist()),
            linear_acceleration_covariance=unknown,
        )
        yield LogMessage(OUTPUTS["imu/data"], message, stamp_ns)


def attitudes(log: Log, stamp_ns: Stamps) -> Array | None:
    """Return (N, 4) w x y z from FRD to NED at instants (N,), NaN outside the log; None without attitudes."""
    angles = [signals.roll(log), signals.pitch(log), signals.yaw(log)]
    found = [angle.interpolated(stamp_ns) for angle in angles if angle is not None]
    return euler_to_quat(np.radians(np.stack(found, axis=-1))) if len(found) == 3 else None


def _header(stamp_ns: int, frame: str) -> Any:
    return Header(stamp=Time(*divmod(stamp_ns, 1_000_000_000)), frame_id=frame)
