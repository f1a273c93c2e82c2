"""Frames of ROS: their names and the tree `map → odom → base_link → imu_link, lidar_link, …` (REP 105, REP 103).

`map` is the site's ENU, `base_link` the vessel's origin, forward, left, up. The autopilot's estimate is already in the
map, so `map → odom` is constant. With more than one vessel, all names but `map` begin with the vessel's name.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array, euler_to_quat, frd_to_flu, matrix_to_quat, quat_to_matrix
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


FRAMES = "/cameras/frames"
KEPT = 256
"""Poses of the vessel that are kept for late images: five seconds at the usual rate."""
_ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_HEADER_BYTES = 4
_STAMP, _LENGTH, _POSE = struct.Struct("<iI"), struct.Struct("<I"), struct.Struct("<q3d4d")
_ALIGNED = 8


class TurnedFrame(NamedTuple):
    """The frame of a camera at the instant of an image."""

    stamp_ns: int
    frame: FixedFrame


class GimbalFrames:
    """Frames of the cameras of a vessel that are on gimbals.

    The attitude of the vessel at an image is interpolated. An image therefore waits for the next attitude.
    """

    def __init__(self, cameras: Iterable[CameraSpec]) -> None:
        self._cameras = {camera.name: camera for camera in cameras if camera.gimbal is not None}
        self._attitudes: deque[tuple[int, Array]] = deque(maxlen=KEPT)
        self._waiting: deque[tuple[int, str, Array]] = deque(maxlen=KEPT)

    @property
    def wanted(self) -> bool:
        """Whether a camera of the vessel is on a gimbal."""
        return bool(self._cameras)

    def attitude(self, stamp_ns: int, quat_enu_flu: Array) -> Iterator[TurnedFrame]:
        """Add a true attitude of the vessel, w x y z. Yield the frames of the images that waited for it."""
        self._attitudes.append((stamp_ns, quat_enu_flu))
        while self._waiting and self._waiting[0][0] <= stamp_ns:
            yield self._turned(*self._waiting.popleft())

    def image(self, payload: bytes) -> Iterator[TurnedFrame]:
        """Add a message of `FRAMES`. Yield its frame if the attitude of the vessel is known."""
        stamp_ns, name, quat_ned_optical = read_frame_pose(payload)
        if name not in self._cameras or not self._attitudes:
            return
        if self._attitudes[-1][0] < stamp_ns:
            self._waiting.append((stamp_ns, name, quat_ned_optical))
            return
        yield self._turned(stamp_ns, name, quat_ned_optical)

    def _turned(self, stamp_ns: int, name: str, quat_ned_optical: Array) -> TurnedFrame:
        rot_enu_flu = quat_to_matrix(self._attitude_at(stamp_ns))
        w, x, y, z = matrix_to_quat(rot_enu_flu.T @ _ENU_NED @ quat_to_matrix(quat_ned_optical)).tolist()
        place = flu(self._cameras[name].position_frd_m)
        return TurnedFrame(stamp_ns, FixedFrame(VESSEL_FRAME, camera_frame(name), place, (x, y, z, w)))

    def _attitude_at(self, stamp_ns: int) -> Array:
        """Return the attitude between two known ones, w x y z. Before the first one, it is the first one."""
        after_ns, after = self._attitudes[-1]
        for before_ns, before in reversed(self._attitudes):
            if before_ns <= stamp_ns:
                share = (stamp_ns - before_ns) / (after_ns - before_ns) if after_ns > before_ns else 0.0
                sign = 1.0 if before @ after >= 0.0 else -1.0
                blended = (1.0 - share) * before + share * sign * after
                unit: Array = blended / np.linalg.norm(blended)
                return unit
            after_ns, after = before_ns, before
        return after


def read_frame_pose(payload: bytes) -> tuple[int, str, Array]:
    """Return stamp, camera and rotation from optical axes to NED, w x y z, of a message of `FRAMES` in CDR."""
    seconds, nanoseconds = _STAMP.unpack_from(payload, _HEADER_BYTES)
    at = _STAMP.size
    (length,) = _LENGTH.unpack_from(payload, _HEADER_BYTES + at)
    at += _LENGTH.size
    name = payload[_HEADER_BYTES + at : _HEADER_BYTES + at + length - 1].decode()
    at = -(-(at + length) // _ALIGNED) * _ALIGNED
    values = _POSE.unpack_from(payload, _HEADER_BYTES + at)
    return seconds * 1_000_000_000 + nanoseconds, name, np.array(values[4:])
