"""A gimbal between the mount of a camera and its axes: yaw, then pitch, with limits and a largest rate."""

from __future__ import annotations

import math

import numpy as np

from sim_core import frames
from sim_core.frames import Array
from sim_core.sensors.camera_spec import CameraSpec, GimbalSpec

ROT_FRD_OPTICAL = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Turns the optical axes (x right, y down, z ahead) into forward, right, down of the camera, (3, 3)."""


def mount_rotation(camera: CameraSpec) -> Array:
    """Return the (3, 3) rotation from the axes of the mount (forward, right, down) to the vessel's."""
    angles_rad = np.radians([camera.roll_deg, camera.pitch_deg, camera.yaw_deg])
    rotation: Array = frames.quat_to_matrix(frames.euler_to_quat(angles_rad))
    return rotation


class Gimbal:
    """The axes of a camera on its mount. Without keys of a gimbal, the camera is fixed."""

    def __init__(self, camera: CameraSpec) -> None:
        self._keys: GimbalSpec | None = camera.gimbal
        self._mount = mount_rotation(camera)
        self.pitch_deg, self.yaw_deg = 0.0, 0.0
        self._wanted_deg = (0.0, 0.0)

    def command(self, pitch_deg: float, yaw_deg: float) -> None:
        """Turn to a pitch angle, up positive, and a yaw angle from the mount, clockwise, within the limits.

        The pitch is over the horizon for a stabilised gimbal, otherwise over the mount.
        """
        if self._keys is not None:
            low, high = zip(self._keys.pitch_limits_deg, self._keys.yaw_limits_deg, strict=True)
            pitch, yaw = np.clip((pitch_deg, yaw_deg), low, high).tolist()
            self._wanted_deg = pitch, yaw

    def advance(self, dt_s: float) -> None:
        """Turn toward the commanded angles for a time."""
        if self._keys is not None:
            most = self._keys.rate_degps * dt_s
            pitch, yaw = self._wanted_deg
            self.pitch_deg += min(max(pitch - self.pitch_deg, -most), most)
            self.yaw_deg += min(max(yaw - self.yaw_deg, -most), most)

    def rot_ned_optical(self, rot_ned_frd: Array) -> Array:
        """Return the (3, 3) rotation from the optical axes to NED, from that of the vessel."""
        mount = rot_ned_frd @ self._mount
        if self._keys is None:
            return np.asarray(mount @ ROT_FRD_OPTICAL)
        if self._keys.stabilised:
            ahead = mount[:, 0]
            mount = _turned(0.0, math.degrees(math.atan2(ahead[1], ahead[0])))
        return np.asarray(mount @ _turned(self.pitch_deg, self.yaw_deg) @ ROT_FRD_OPTICAL)


def _turned(pitch_deg: float, yaw_deg: float) -> Array:
    rotation: Array = frames.quat_to_matrix(frames.euler_to_quat(np.radians([0.0, pitch_deg, yaw_deg])))
    return rotation
