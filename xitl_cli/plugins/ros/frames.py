"""Frames of ROS: their names and the tree `map → odom → base_link → imu_link, lidar_link, …` (REP 105, REP 103).

`map` is the site's ENU, `base_link` the vessel's origin, forward, left, up. The autopilot's estimate is already in the
map, so `map → odom` is constant. With more than one vessel, all names but `map` begin with the vessel's name.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sim_core.frames import euler_to_quat, frd_to_flu, matrix_to_quat, quat_to_matrix
from sim_core.sensors.camera_spec import CameraSpec
from sim_core.sensors.spec import LidarSpec, RangefinderSpec
from xitl_cli.plugins.ros.camera_messages import camera_frame, cameras_of
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import MAP_FRAME, VESSEL_FRAME, vessel_name

IMU_FRAME, GNSS_FRAME, LIDAR_FRAME, SONAR_FRAME = "imu_link", "gnss_link", "lidar_link", "sonar_link"
RADAR_FRAME = "radar_link"

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""x y z w, as in ROS."""

_FRD_OPTICAL = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
_FLU_FRD = np.diag([1.0, -1.0, -1.0])
NO_TURN: Quaternion = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class FixedFrame:
    """A frame with a constant pose in its parent."""

    parent: str
    name: str
    position_m: Vector
    """Position in the parent, in metres."""
    turn: Quaternion = NO_TURN
    """Rotation from this frame to the parent."""


def frame_name(frame: str, vessel: str) -> str:
    """Return the name in messages: `alpha/base_link`, and `map` for all."""
    return frame if frame == MAP_FRAME else vessel_name(frame, vessel)


def rangefinder_frame(number: int) -> str:
    """Return the frame of one of `sensors.rangefinders`; its x axis is the beam."""
    return f"rangefinder_{number}_link"


def sensor_frames(profile: RunProfile) -> Iterator[FixedFrame]:
    """Yield the frame of each sensor of the profile, in `base_link`, at its mounting place. Names omit the vessel's."""
    sensors = profile.sensors
    if sensors is None:
        return
    yield _mounted(IMU_FRAME, sensors.imu.position_frd_m)
    yield _mounted(GNSS_FRAME, sensors.gnss.antenna_frd_m)
    for number, rangefinder in enumerate(sensors.rangefinders):
        yield _mounted(rangefinder_frame(number), rangefinder.position_frd_m, looking_turn(rangefinder))
    if sensors.lidar is not None:
        yield _mounted(LIDAR_FRAME, sensors.lidar.position_frd_m, lidar_turn(sensors.lidar))
    if sensors.sonar is not None:
        heading_rad = math.radians(sensors.sonar.heading_deg)
        yield _mounted(SONAR_FRAME, sensors.sonar.position_frd_m, flu_turn(0.0, 0.0, heading_rad))
    for camera in cameras_of(profile):
        if camera.gimbal is None:
            yield _mounted(camera_frame(camera.name), camera.position_frd_m, optical_turn(camera))
    if sensors.radar is not None:
        yield _mounted(RADAR_FRAME, sensors.radar.position_frd_m)


def named_frame(frame: FixedFrame, vessel: str) -> FixedFrame:
    """Return the frame with its names in messages."""
    return replace(frame, parent=frame_name(frame.parent, vessel), name=frame_name(frame.name, vessel))


def flu(vector_frd: Vector) -> Vector:
    """Convert forward, right, down to forward, left, up."""
    forward, left, up = frd_to_flu(np.asarray(vector_frd, dtype=np.float64)).tolist()
    return forward, left, up


def flu_turn(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """Return the rotation in FLU of roll, pitch and yaw in FRD (starboard down, bow up, to starboard)."""
    w, x, y, z = euler_to_quat(np.array([roll_rad, pitch_rad, yaw_rad])).tolist()
    return x, -y, -z, w


def lidar_turn(lidar: LidarSpec) -> Quaternion:
    """Return the rotation from the lidar's axes to body axes, FLU."""
    return flu_turn(math.radians(lidar.roll_deg), math.radians(lidar.pitch_deg), math.radians(lidar.yaw_deg))


def optical_turn(camera: CameraSpec) -> Quaternion:
    """Return the rotation from the optical axes of a fixed camera (x right, y down, z ahead) to body axes, FLU."""
    angles_rad = np.radians([camera.roll_deg, camera.pitch_deg, camera.yaw_deg])
    rot_frd_optical = quat_to_matrix(euler_to_quat(angles_rad)) @ _FRD_OPTICAL
    w, x, y, z = matrix_to_quat(_FLU_FRD @ rot_frd_optical).tolist()
    return x, y, z, w


def looking_turn(rangefinder: RangefinderSpec) -> Quaternion:
    """Return the rotation from axes with x along the beam to body axes, FLU: yaw, then pitch."""
    forward, right, down = rangefinder.direction_frd
    return flu_turn(0.0, math.atan2(-down, math.hypot(forward, right)), math.atan2(right, forward))


def _mounted(name: str, position_frd_m: Vector, turn: Quaternion = NO_TURN) -> FixedFrame:
    return FixedFrame(VESSEL_FRAME, name, flu(position_frd_m), turn)
