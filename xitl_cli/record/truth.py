"""The true motion of vessels, converted for its four topics for all vessels of an instant together.

Most messages of a run are on these topics. They have a fixed layout, so their payloads are joined from parts: the bytes
equal those of the encoders in `cdr` and of foxglove's classes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
from foxglove import messages

from sim_core import frames
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from xitl_cli.record.cdr import stamp_head
from xitl_cli.record.topics import MAP_FRAME, TOPICS

STATE, ODOMETRY, POSE, TRANSFORM = "/truth/state", "/truth/odometry", "/truth/pose", "/tf"
_POSE_BYTES, _TWIST_BYTES, _COVARIANCE_BYTES = 7 * 8, 6 * 8, 36 * 8
_EXACT = (0.0,) * 36  # covariance of the truth
_NO_COVARIANCE = bytes(_COVARIANCE_BYTES)
# Position and orientation as fields 1 and 2 of foxglove.Pose, each a message of doubles with their tags
_PLACE = struct.Struct("<3sdcdcd3sdcdcdcd")
_POSITION, _ORIENTATION = b"\x0a\x1b\x09", b"\x12\x24\x09"
_TRANSLATION, _ROTATION = b"\x22\x1b\x09", b"\x2a\x24\x09"  # fields 4 and 5 of foxglove.FrameTransform


class TruthTable:
    """True motion of N vessels in the axes of the topics, with the state of their actuators (N, C)."""

    def __init__(self, motion: Kinematics, rotor: Array) -> None:
        pos_ned_m, vel_ned_mps, gyro = motion.pos_ned_m, motion.vel_ned_mps, motion.gyro_frd_radps
        vel_frd_mps = (vel_ned_mps[:, None, :] @ motion.rot_ned_frd)[:, 0]
        attitude = frames.quat_ned_frd_to_enu_flu(motion.quat_ned_frd)
        pose = np.concatenate([frames.ned_to_enu(pos_ned_m), attitude[:, 1:], attitude[:, :1]], axis=1)
        twist = np.concatenate([frames.frd_to_flu(vel_frd_mps), frames.frd_to_flu(gyro)], axis=1)
        self._state = pos_ned_m, vel_ned_mps, motion.acc_ned_mps2, motion.quat_ned_frd, gyro, rotor
        self._motion = np.concatenate(self._state[:5], axis=1)
        self._actuators = rotor.shape[1]
        self._pose, self._twist = pose, twist
        self._poses: list[list[float]] = pose.tolist()  # x y z of the position, x y z w of the attitude

    # Values of a vessel's messages

    def state(self, row: int) -> tuple[list[float], ...]:
        """Return the values of /truth/state."""
        return tuple(values[row].tolist() for values in self._state)

    def odometry(self, row: int, frame: str) -> tuple[Any, ...]:
        """Return the values of /truth/odometry. frame: of the body."""
        pose = self._poses[row]
        return MAP_FRAME, frame, pose[:3], pose[3:], _EXACT, self._twist[row].tolist(), _EXACT

    def pose(self, stamp_ns: int, row: int) -> messages.PoseInFrame:
        """Return the message of /truth/pose."""
        x, y, z, *attitude = self._poses[row]
        pose = messages.Pose(position=messages.Vector3(x=x, y=y, z=z), orientation=_quaternion(*attitude))
        return messages.PoseInFrame(timestamp=timestamp(stamp_ns), frame_id=MAP_FRAME, pose=pose)

    def transform(self, stamp_ns: int, row: int, frame: str) -> messages.FrameTransforms:
        """Return the message of /tf, for the frame of this name."""
        return transform_message(stamp_ns, frame, self._poses[row])

    # The same messages of all vessels, encoded

    def state_payloads(self, stamp_ns: int) -> list[bytes]:
        """Encode `state` of each vessel."""
        count = self._actuators
        # Numbers of eight bytes are aligned
        head, length = stamp_head(stamp_ns), count.to_bytes(4, "little") + bytes(4 if count else 0)
        rows = zip(_rows(self._motion), _rows(self._state[-1]), strict=True)
        return [b"".join((head, motion, length, rotor)) for motion, rotor in rows]

    def odometry_payloads(self, stamp_ns: int, frames: Sequence[str]) -> list[bytes]:
        """Encode `odometry` of each vessel. frames: of the bodies."""
        head = stamp_head(stamp_ns)
        rows = zip(frames, _rows(self._pose), _rows(self._twist), strict=True)
        return [
            b"".join((head, _odometry_frames(frame), pose, _NO_COVARIANCE, twist, _NO_COVARIANCE))
            for frame, pose, twist in rows
        ]

    def pose_payloads(self, stamp_ns: int) -> list[bytes]:
        """Encode `pose` of each vessel."""
        head = _timestamp(stamp_ns) + _POSE_START
        return [
            # A zero is not sent, which changes the layout
            self.pose(stamp_ns, row).encode() if 0.0 in pose else head + _placed(_POSITION, _ORIENTATION, pose)
            for row, pose in enumerate(self._poses)
        ]

    def transform_payloads(self, stamp_ns: int, frames: Sequence[str]) -> list[bytes]:
        """Encode `transform` of each vessel, for the frames of these names."""
        payloads = []
        for row, (pose, frame) in enumerate(zip(self._poses, frames, strict=True)):
            if 0.0 in pose:
                payloads.append(self.transform(stamp_ns, row, frame).encode())
                continue
            start, names = _timestamp(stamp_ns), _transform_names(frame)
            length = _varint(len(start) + len(names) + _PLACE.size)
            payloads.append(b"".join((b"\x0a", length, start, names, _placed(_TRANSLATION, _ROTATION, pose))))
        return payloads


def _rows(values: Array) -> list[bytes]:
    """Return the bytes of each row of an array (N, K)."""
    data, size = values.tobytes(), values.itemsize * values.shape[1]
    return [data[start : start + size] for start in range(0, len(data), size)] if size else [b""] * len(values)


@cache
def _transform_names(frame: str) -> bytes:
    """Return the names of both frames as fields 2 and 3 of foxglove.FrameTransform."""
    return _field(0x12, MAP_FRAME.encode()) + _field(0x1A, frame.encode())


@cache
def _odometry_frames(frame: str) -> bytes:
    """Return the part of an odometry message between its stamp and its numbers, for the body's frame."""
    encode = TOPICS[ODOMETRY].message_type().encode
    payload = encode(0, MAP_FRAME, frame, (), (), _EXACT, (), _EXACT)
    return payload[len(stamp_head(0)) : -(_POSE_BYTES + _TWIST_BYTES + 2 * _COVARIANCE_BYTES)]


def timestamp(stamp_ns: int) -> messages.Timestamp:
    """Return the timestamp of a foxglove message."""
    return messages.Timestamp(*divmod(stamp_ns, 1_000_000_000))


def transform_message(stamp_ns: int, frame: str, pose: list[float]) -> messages.FrameTransforms:
    """Return the transform of `frame` into the map. pose: position (ENU), then attitude (FLU to ENU, x y z w)."""
    x, y, z, *attitude = pose
    transform = messages.FrameTransform(
        timestamp=timestamp(stamp_ns),
        parent_frame_id=MAP_FRAME,
        child_frame_id=frame,
        translation=messages.Vector3(x=x, y=y, z=z),
        rotation=_quaternion(*attitude),
    )
    return messages.FrameTransforms(transforms=[transform])


def _quaternion(x: float, y: float, z: float, w: float) -> messages.Quaternion:
    return messages.Quaternion(x=x, y=y, z=z, w=w)


def _placed(position: bytes, orientation: bytes, pose: list[float]) -> bytes:
    x, y, z, qx, qy, qz, qw = pose
    return _PLACE.pack(position, x, b"\x11", y, b"\x19", z, orientation, qx, b"\x11", qy, b"\x19", qz, b"\x21", qw)


@lru_cache(maxsize=1)
def _timestamp(stamp_ns: int) -> bytes:
    """Return the stamp as field 1 of a protobuf message. The vessels of a fleet share it."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    parts = [b"\x08" + _varint(seconds)] if seconds else []
    parts += [b"\x10" + _varint(nanoseconds)] if nanoseconds else []
    return _field(0x0A, b"".join(parts))


def _field(tag: int, content: bytes) -> bytes:
    return bytes((tag,)) + _varint(len(content)) + content


def _varint(number: int) -> bytes:
    """Return a number in protobuf's form: seven bits in a byte, the lowest first."""
    if number < 0x80:
        return bytes((number,))
    return bytes((number & 0x7F | 0x80,)) + _varint(number >> 7)


_POSE_START = _field(0x12, MAP_FRAME.encode()) + bytes((0x1A, _PLACE.size))  # the map, and the start of the pose
