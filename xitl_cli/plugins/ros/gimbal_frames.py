"""Frames of cameras on gimbals in `base_link`, from the recorded poses of images and of the vessel."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from sim_core.frames import Array, matrix_to_quat, quat_to_matrix
from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.plugins.ros.camera_messages import camera_frame
from xitl_cli.plugins.ros.frames import FixedFrame, flu
from xitl_cli.record.topics import VESSEL_FRAME

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
