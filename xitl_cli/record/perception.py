"""What a companion computer is given and what it makes of it, turned into topics. docs/recording.md is the table.

Clouds are drawn in the axes that tools expect, x forward, y left, z up (REP 103): of the body in `base_link`, and in
`odom`, which is the body's place when the odometry began. What comes in here is forward, right, down, as everywhere.
A topic is in the file once it was written to, and not before: a recording without perception is the same as ever.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from foxglove import messages
from numpy.typing import NDArray

from sim_core import frames
from xitl_cli.record import perception_schemas as schemas
from xitl_cli.record.cdr import Layout
from xitl_cli.record.mcap_file import Log, McapFile
from xitl_cli.record.schemas import ODOMETRY

VESSEL_FRAME = "base_link"
ODOM_FRAME = "odom"

Array = NDArray[np.float64]
Points = NDArray[np.float32]
Intensity = NDArray[np.uint8]
Source = Literal["lidar", "sonar"]
SOURCES: tuple[Source, ...] = ("lidar", "sonar")
"""By number, as the field `source` of a map has them."""

_ZEROS = (0.0,) * 36
_FLU = np.array([1.0, -1.0, -1.0], dtype=np.float32)
_FRD_FLU = np.diag([1.0, -1.0, -1.0, 1.0])

_PLACE = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
LIDAR_POINT = np.dtype([*_PLACE, ("t", "<f4"), ("intensity", "u1")])
"""t: seconds after the cloud's stamp."""
SONAR_POINT = np.dtype([*_PLACE, ("intensity", "u1")])
MAP_POINT = np.dtype([*_PLACE, ("intensity", "u1"), ("source", "u1")])

Transform = Callable[[int, str, messages.Vector3, messages.Quaternion], None]
"""Instant, child of the map's frame, its place and attitude."""


class Ping(Protocol):
    """One ping of a scanning sonar. angle_grad: of the beam, clockwise from the bow, 400 to the turn."""

    @property
    def number(self) -> int: ...
    @property
    def angle_grad(self) -> int: ...
    @property
    def position_frd_m(self) -> Sequence[float]: ...
    @property
    def sample_period_s(self) -> float: ...
    @property
    def sound_speed_mps(self) -> float: ...
    @property
    def intensity(self) -> Intensity: ...


class PerceptionRecorder:
    """Records into `file`; made by the recorder when it is first asked for."""

    def __init__(self, file: McapFile, transform: Transform) -> None:
        self._file = file
        self._transform = transform
        self._ping_head = Layout("u32", "u32", ("f64", 3), "f64", "f64", "u32")
        self._pose = Layout(("string", ODOM_FRAME), ("string", VESSEL_FRAME), *(("f64", n) for n in (7, 36, 6, 36)))
        self._obstacle = Layout("u32", "u32", "u32", "i64", ("f64", 12))
        self._status = Layout(("i64", len(schemas.COMPANION_COUNTS)), "f64", "u8")
        self._bodies: dict[str, Layout] = {}
        self._whats: dict[str, Layout] = {}

    @cached_property
    def _lidar(self) -> Callable[[Any, int], None]:
        return self._file.foxglove_channel("/lidar/points", messages.PointCloud)

    @cached_property
    def _sonar(self) -> Callable[[Any, int], None]:
        return self._file.foxglove_channel("/sonar/points", messages.PointCloud)

    @cached_property
    def _map(self) -> Callable[[Any, int], None]:
        return self._file.foxglove_channel("/companion/map", messages.PointCloud)

    @cached_property
    def _pings(self) -> Log:
        return self._file.ros_channel("/sonar/ping", "xitl_msgs/msg/Ping", schemas.PING)

    @cached_property
    def _odometry(self) -> Log:
        return self._file.ros_channel("/companion/odometry", "nav_msgs/msg/Odometry", ODOMETRY)

    @cached_property
    def _obstacles(self) -> Log:
        return self._file.ros_channel("/companion/obstacles", "xitl_msgs/msg/Obstacle", schemas.OBSTACLE)

    @cached_property
    def _companion(self) -> Log:
        return self._file.ros_channel("/companion/status", "xitl_msgs/msg/Companion", schemas.COMPANION)

    @cached_property
    def _body(self) -> Log:
        return self._file.ros_channel("/truth/bodies", "xitl_msgs/msg/Body", schemas.BODY)

    @cached_property
    def _contacts(self) -> Log:
        return self._file.ros_channel("/contacts", "xitl_msgs/msg/Contact", schemas.CONTACT)

    def cloud(self, stamp_ns: int, points_frd_m: Points, offset_s: Points, intensity: Intensity) -> None:
        """One frame of the lidar that began at `stamp_ns`: (n, 3) in body FRD, each at its own instant."""
        packed = _packed(LIDAR_POINT, points_frd_m, intensity)
        packed["t"] = offset_s
        self._lidar(_cloud(stamp_ns, VESSEL_FRAME, packed), stamp_ns)

    def ping(self, stamp_ns: int, ping: Ping) -> None:
        """One ping of the sonar that went out at `stamp_ns`."""
        intensity = np.asarray(ping.intensity, dtype=np.uint8).tobytes()
        position = [float(value) for value in ping.position_frd_m]
        numbers = (ping.sample_period_s, ping.sound_speed_mps, len(intensity))
        head = self._ping_head.pack(stamp_ns, ping.number, ping.angle_grad, *position, *numbers)
        self._pings(head + intensity, stamp_ns)

    def sonar_points(self, stamp_ns: int, points_frd_m: Points, intensity: Intensity) -> None:
        """What stands out of the pings: (n, 3) in body FRD."""
        self._sonar(_cloud(stamp_ns, VESSEL_FRAME, _packed(SONAR_POINT, points_frd_m, intensity)), stamp_ns)

    def odom_frame(self, stamp_ns: int, pos_ned_m: Array, quat_ned_frd: Array) -> None:
        """Where the body truly was when the odometry began: (3,), (4,). So that tools draw its map in its place."""
        x, y, z = frames.ned_to_enu(np.asarray(pos_ned_m, dtype=np.float64)).tolist()
        qw, qx, qy, qz = frames.quat_ned_frd_to_enu_flu(np.asarray(quat_ned_frd, dtype=np.float64)).tolist()
        place, attitude = messages.Vector3(x=x, y=y, z=z), messages.Quaternion(x=qx, y=qy, z=qz, w=qw)
        self._transform(stamp_ns, ODOM_FRAME, place, attitude)

    def odometry(self, stamp_ns: int, pose_odom: Array, vel_frd_mps: Array) -> None:
        """A pose (4, 4) of the odometry, body FRD to FRD where it began, and the velocity (3,) in the body."""
        pose = _FRD_FLU @ np.asarray(pose_odom, dtype=np.float64) @ _FRD_FLU
        w, x, y, z = frames.matrix_to_quat(pose[:3, :3]).tolist()
        linear = frames.frd_to_flu(np.asarray(vel_frd_mps, dtype=np.float64)).tolist()
        place = pose[:3, 3].tolist()
        payload = self._pose.pack(stamp_ns, *place, x, y, z, w, *_ZEROS, *linear, 0.0, 0.0, 0.0, *_ZEROS)
        self._odometry(payload, stamp_ns)

    def map_points(self, stamp_ns: int, points_odom_m: Points, intensity: Intensity, source: Source) -> None:
        """Points (n, 3) new in the companion's map, in its odometry's frame (FRD where it began)."""
        packed = _packed(MAP_POINT, points_odom_m, intensity)
        packed["source"] = SOURCES.index(source)
        self._map(_cloud(stamp_ns, ODOM_FRAME, packed), stamp_ns)

    def obstacle(self, stamp_ns: int, message: Any) -> None:
        """XITL_OBSTACLE as it came."""
        self._obstacles(
            self._obstacle.pack(
                stamp_ns,
                message.id,
                message.points,
                message.hits,
                message.time_usec * 1000,
                *message.pos_ned,
                *message.vel_ned,
                *message.size,
                message.heading,
                message.range,
                message.closing_speed,
            ),
            stamp_ns,
        )

    def bodies(
        self,
        stamp_ns: int,
        kinds: Sequence[str],
        lengths_m: Array,
        pos_ned_m: Array,
        quat_ned_frd: Array,
        vel_ned_mps: Array,
    ) -> None:
        """The bodies adrift: (B,), (B,), (B, 3), (B, 4), (B, 3). Their number is their place in these.

        Each has a frame of its own, `body_frame`, in which it is drawn.
        """
        numbers = (np.asarray(each).tolist() for each in (lengths_m, pos_ned_m, quat_ned_frd, vel_ned_mps))
        rows = zip(kinds, *numbers, strict=True)
        for number, (kind, length_m, place, quat, velocity) in enumerate(rows):
            layout = self._bodies.get(kind)
            if layout is None:
                layout = self._bodies[kind] = Layout(("string", kind), "u32", ("f64", 11))
            self._body(layout.pack(stamp_ns, number, length_m, *place, *quat, *velocity), stamp_ns)
            x, y, z = frames.ned_to_enu(np.array(place)).tolist()
            qw, qx, qy, qz = frames.quat_ned_frd_to_enu_flu(np.array(quat)).tolist()
            middle, attitude = messages.Vector3(x=x, y=y, z=z), messages.Quaternion(x=qx, y=qy, z=qz, w=qw)
            self._transform(stamp_ns, body_frame(number), middle, attitude)

    def contact(
        self, stamp_ns: int, what: str, pos_ned_m: Array, force_n: float, speed_mps: float, began: bool
    ) -> None:
        """The hull touches `what` at a place (3,); `began`: it did not before."""
        layout = self._whats.get(what)
        if layout is None:
            layout = self._whats[what] = Layout(("string", what), ("f64", 5), "u8")
        place = np.asarray(pos_ned_m, dtype=np.float64).tolist()
        self._contacts(layout.pack(stamp_ns, *place, float(force_n), float(speed_mps), bool(began)), stamp_ns)

    def companion(self, stamp_ns: int, message: Any) -> None:
        """XITL_COMPANION_STATUS as it came."""
        counts = [getattr(message, name) for name in schemas.COMPANION_COUNTS]
        self._companion(self._status.pack(stamp_ns, *counts, message.latency, message.manoeuvre), stamp_ns)


def body_frame(number: int) -> str:
    """The frame of a body adrift, about its middle."""
    return f"body_{number}"


def _packed(kind: np.dtype[Any], points_m: Points, intensity: Intensity) -> NDArray[Any]:
    """(n,) of a point's dtype, in axes forward, left, up."""
    packed = np.zeros(len(points_m), dtype=kind)
    points_flu_m = np.asarray(points_m, dtype=np.float32).reshape(-1, 3) * _FLU
    for axis, name in enumerate("xyz"):
        packed[name] = points_flu_m[:, axis]
    packed["intensity"] = intensity
    return packed


_Number = messages.PackedElementFieldNumericType
_NUMBERS = {np.dtype("<f4"): _Number.Float32, np.dtype("u1"): _Number.Uint8}


def _cloud(stamp_ns: int, frame: str, packed: NDArray[Any]) -> messages.PointCloud:
    kinds = packed.dtype.fields
    assert kinds is not None
    return messages.PointCloud(
        timestamp=messages.Timestamp(*divmod(stamp_ns, 1_000_000_000)),
        frame_id=frame,
        pose=messages.Pose(
            position=messages.Vector3(x=0.0, y=0.0, z=0.0), orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        ),
        point_stride=packed.dtype.itemsize,
        fields=[
            messages.PackedElementField(name=name, offset=kind[1], type=_NUMBERS[kind[0]])
            for name, kind in kinds.items()
        ],
        data=packed.tobytes(),
    )
