"""Clouds, pings and poses of a recording, converted back to body FRD and NED."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.companion.clouds import PointCloud
from agent.companion.sonar import SonarPing
from agent.wire import dialect
from agent.wire.codec import Message, decode
from agent.wire.framing import CHECKSUM_BYTES, HEADER_BYTES, MAGIC
from sim_core import frames
from sim_core.dataclass import dataclass
from sim_core.frames import quat_to_matrix
from xitl_cli.errors import UserError
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Table
from xitl_cli.record.topics import LIDAR_POINT, MAP_POINT, MAP_SOURCES, MapSource

LIDAR, PING, MAP = "/lidar/points", "/sonar/ping", "/companion/map"
AUTOPILOT = "/link/companion/tx"
ODOMETRY, TRUTH = "/companion/odometry", "/truth/state"

_AT_ONCE = 512
_FRD = np.array([1.0, -1.0, -1.0], dtype=np.float32)
# Body and frame axes both change: half a turn about x on both sides.
_QUAT_FRD = np.array([1.0, 1.0, -1.0, -1.0])

Points = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class SeenPoints:
    """Points of a map in the odometry's frame."""

    points_odom_m: NDArray[np.float32]
    """(n, 3)."""
    seen_ns: NDArray[np.int64]
    """Approximate time at which each was seen, (n,)."""


def clouds(log: Log) -> Iterator[PointCloud]:
    """Yield frames of the lidar in the order of the file; for a bag its PointCloud2.

    Raises UserError when there are none, or with another layout.
    """
    if LIDAR not in log.tables:
        if (table := cloud_topic(log)) is not None:
            yield from foreign_clouds(log, table)
            return
        raise UserError(f"{log.path} has no {LIDAR} and no PointCloud2; record a run with sensors.lidar in its profile")
    for number, (stamp_ns, packed) in enumerate(_packed(log, LIDAR, LIDAR_POINT)):
        yield PointCloud(
            dialect.XITL_CLOUD_KIND_LIDAR,
            number & 0xFFFF,
            stamp_ns,
            _frd(packed),
            packed["t"].astype(np.float32),
            packed["intensity"].copy(),
        )


def pings(log: Log) -> list[SonarPing]:
    """Return echoes of the sonar; empty when none were recorded."""
    table = log.tables.get(PING)
    if table is None:
        return []
    names = ("number", "angle_grad", "position_frd_m", "sample_period_s", "sound_speed_mps", "intensity")
    stamps = table.stamp_ns.tolist()
    rows = zip(stamps, *(table.values(name, raw=True) for name in names), strict=True)
    return [
        SonarPing(
            int(number), stamp_ns, int(angle), tuple(np.asarray(place, dtype=float).tolist()), float(period_s),
            float(speed), _bytes(echo),
        )
        for stamp_ns, number, angle, place, period_s, speed, echo in rows
    ]  # fmt: skip


def read_autopilot_messages(log: Log) -> Iterator[tuple[int, Message]]:
    """Yield the autopilot's messages to the companion with their times of sending, in the order of the file."""
    table = log.tables.get(AUTOPILOT)
    for first in range(0, 0 if table is None else len(table), _AT_ONCE):
        assert table is not None
        rows = slice(first, first + _AT_ONCE)
        for stamp_ns, frame in zip(table.stamp_ns[rows].tolist(), table.values("frame", rows), strict=True):
            data = bytes(frame)
            if len(data) < HEADER_BYTES + CHECKSUM_BYTES or data[0] != MAGIC:
                continue  # no MAVLink 2
            with suppress(KeyError):  # of an unknown message
                yield stamp_ns, decode(data)


def map_points(log: Log) -> dict[MapSource, SeenPoints]:
    """Return the companion's map points of the run, FRD of its odometry's frame, by source."""
    parts: dict[MapSource, list[Points]] = {source: [] for source in MAP_SOURCES}
    stamps: dict[MapSource, list[NDArray[np.int64]]] = {source: [] for source in MAP_SOURCES}
    if MAP in log.tables:
        for stamp_ns, packed in _packed(log, MAP, MAP_POINT):
            for number, source in enumerate(MAP_SOURCES):
                parts[source].append(_frd(packed[packed["source"] == number]))
                stamps[source].append(np.full(len(parts[source][-1]), stamp_ns))
    return {
        source: SeenPoints(
            np.concatenate([np.empty((0, 3), np.float32), *parts[source]]),
            np.concatenate([np.empty(0, np.int64), *stamps[source]]),
        )
        for source in MAP_SOURCES
    }


def online(log: Log) -> Trajectory | None:
    """Return the odometry's poses during the run, body FRD to FRD at its start; None without any."""
    table = log.tables.get(ODOMETRY)
    if table is None:
        return None
    position = np.column_stack([table.values(f"pose.pose.position.{axis}") for axis in "xyz"])
    quat = np.column_stack([table.values(f"pose.pose.orientation.{axis}") for axis in "wxyz"])
    return _increasing(table, position * _FRD.astype(float), quat * _QUAT_FRD)


def truth(log: Log) -> Trajectory | None:
    """Return true poses, body FRD to NED; None without any."""
    table = log.tables.get(TRUTH)
    if table is None:
        return None
    return _increasing(table, table.values("position_ned_m"), table.values("quaternion_ned_frd"))


def at(trajectory: Trajectory, stamp_ns: NDArray[np.int64]) -> Trajectory:
    """Interpolate poses at instants within the trajectory; other instants are left out.

    Positions and quaternions are interpolated linearly. Neighbours are 20 ms apart, so the error is a share of 1e-5 of
    the turn.
    """
    inside = (stamp_ns >= trajectory.stamp_ns[0]) & (stamp_ns <= trajectory.stamp_ns[-1])
    wanted = stamp_ns[inside]
    after = np.clip(np.searchsorted(trajectory.stamp_ns, wanted), 1, len(trajectory.stamp_ns) - 1)
    start, end = trajectory.stamp_ns[after - 1], trajectory.stamp_ns[after]
    share = ((wanted - start) / (end - start))[:, None]
    position = (1.0 - share) * trajectory.pos_m[after - 1] + share * trajectory.pos_m[after]
    before_quat, after_quat = trajectory.quat_wxyz[after - 1], trajectory.quat_wxyz[after]
    near = np.where(np.sum(before_quat * after_quat, axis=1, keepdims=True) < 0.0, -after_quat, after_quat)
    return Trajectory(wanted, position, frames.quat_normalize((1.0 - share) * before_quat + share * near))


def _increasing(table: Table, pos_m: NDArray[np.float64], quat_wxyz: NDArray[np.float64]) -> Trajectory | None:
    stamp_ns = table.stamp_ns
    sound = np.isfinite(pos_m).all(axis=1) & (np.linalg.norm(quat_wxyz, axis=1) > 0.5)
    order = np.flatnonzero(sound)
    newest = np.maximum.accumulate(stamp_ns[order]) if len(order) else stamp_ns[order]
    order = order[np.diff(newest, prepend=-1) > 0] if len(order) else order
    if len(order) < 2:
        return None
    return Trajectory(stamp_ns[order], pos_m[order], frames.quat_normalize(quat_wxyz[order]))


def _packed(log: Log, topic: str, kind: np.dtype[Any]) -> Iterator[tuple[int, NDArray[Any]]]:
    table = log.tables[topic]
    for first in range(0, len(table), _AT_ONCE):
        rows = slice(first, first + _AT_ONCE)
        strides = table.values("point_stride", rows)
        for stamp_ns, stride, data in zip(
            table.stamp_ns[rows].tolist(), strides, table.values("data", rows), strict=True
        ):
            if int(stride) != kind.itemsize or len(data) % kind.itemsize:
                raise UserError(f"{log.path}: {topic} has not the format of xitl; use a recording of xitl sim")
            yield stamp_ns, np.frombuffer(data, dtype=kind)


def _frd(packed: NDArray[Any]) -> Points:
    flu = np.column_stack([packed["x"], packed["y"], packed["z"]]).astype(np.float32)
    frd: Points = flu * _FRD
    return frd


def _bytes(echo: Any) -> NDArray[np.uint8]:
    """Return the bytes of a sequence as the reader gives it: bytes, or numbers padded with NaN."""
    if isinstance(echo, bytes):
        return np.frombuffer(echo, dtype=np.uint8)
    numbers = np.asarray(echo, dtype=np.float64)
    return numbers[np.isfinite(numbers)].astype(np.uint8)


CLOUD_COLUMNS = {"point_step", "width", "height", "data", "fields.length", "header.stamp", "header.frame_id"}
VESSEL = ("base_link", "base_footprint")
TIMES = ("time", "t", "time_offset", "offset_time")
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
_MOST_FIELDS = 32
_MOST_LINKS = 10

Turn = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Rotation (3, 3) and translation (3,) into the parent frame."""


def cloud_topic(log: Log) -> Table | None:
    """Return the topic of the lidar: the PointCloud2 topic with the most points. None without any."""
    tables = [table for table in log.tables.values() if set(table.columns) >= CLOUD_COLUMNS and len(table)]
    sizes = [float(np.median(table.values("width").astype(float) * table.values("height"))) for table in tables]
    return tables[int(np.argmax(sizes))] if tables else None


def foreign_clouds(log: Log, table: Table) -> Iterator[PointCloud]:
    """Yield clouds in the order of the file, forward, right, down of the vessel.

    Raises UserError for points without x, y, z.
    """
    kind = _point_type(log, table)
    intensity = next((name for name in ("intensity", "reflectivity") if name in (kind.names or ())), None)
    time = next((name for name in TIMES if name in (kind.names or ())), None)
    turn, shift_m = mounting(log, str(table.values("header.frame_id", slice(1))[0]))
    stamps = table.values("header.stamp").tolist()
    for number, stamp_ns in enumerate(stamps):
        row = slice(number, number + 1)
        data = bytes(table.values("data", row)[0])
        packed = np.frombuffer(data[: len(data) - len(data) % kind.itemsize], dtype=kind)
        points = np.column_stack([packed["x"], packed["y"], packed["z"]]).astype(np.float64)
        finite = np.isfinite(points).all(axis=1)
        packed, points = packed[finite], points[finite]
        if not len(points):
            continue
        offset = np.zeros(len(packed), np.float32) if time is None else packed[time].astype(np.float64)
        if time is not None and kind[time].kind in "iu":  # Ouster and Livox use nanoseconds
            offset = offset * 1e-9
        strength = np.zeros(len(packed)) if intensity is None else packed[intensity].astype(np.float64)
        yield PointCloud(
            dialect.XITL_CLOUD_KIND_LIDAR,
            number & 0xFFFF,
            stamp_ns,
            ((points @ turn.T + shift_m).astype(np.float32)) * _FRD,
            offset.astype(np.float32),
            np.clip(np.nan_to_num(strength), 0.0, 255.0).astype(np.uint8),
        )


def mounting(log: Log, frame: str) -> Turn:
    """Return the pose of a frame on the vessel by static transforms.

    It is the vessel's origin if they do not lead to it.
    """
    parent_of: dict[str, tuple[str, Turn]] = {}  # the parent of each frame, and the transform to it
    for name, table in log.tables.items():
        if not name.endswith("/tf_static"):
            continue
        count = sum(f"transforms[{number}].child_frame_id" in table.columns for number in range(_MOST_FIELDS))
        for number in range(count):
            transform = f"transforms[{number}]"
            children = table.values(f"{transform}.child_frame_id")
            parents = table.values(f"{transform}.header.frame_id")
            shifts = np.column_stack([table.values(f"{transform}.transform.translation.{axis}") for axis in "xyz"])
            quats = np.column_stack([table.values(f"{transform}.transform.rotation.{axis}") for axis in "wxyz"])
            for child, parent, moved_m, step in zip(children, parents, shifts, quat_to_matrix(quats), strict=True):
                parent_of[str(child)] = str(parent), (step, moved_m)
    turn, shift_m = np.eye(3), np.zeros(3)
    for _ in range(_MOST_LINKS):
        if frame.rpartition("/")[2] in VESSEL or frame not in parent_of:
            break
        frame, (step, moved_m) = parent_of[frame]
        turn, shift_m = step @ turn, step @ shift_m + moved_m
    return (turn, shift_m) if frame.rpartition("/")[2] in VESSEL else (np.eye(3), np.zeros(3))


def _point_type(log: Log, table: Table) -> np.dtype[np.void]:
    """Return the dtype of one point, from the first cloud."""
    first = slice(1)
    order = ">" if "is_bigendian" in table.columns and table.values("is_bigendian", first)[0] else "<"
    names, formats, offsets = list[str](), list[str](), list[int]()
    for number in range(_MOST_FIELDS):
        if f"fields[{number}].name" not in table.columns:
            break
        datatype = int(table.values(f"fields[{number}].datatype", first)[0])
        if datatype in _TYPES:
            names.append(str(table.values(f"fields[{number}].name", first)[0]))
            formats.append(order + _TYPES[datatype])
            offsets.append(int(table.values(f"fields[{number}].offset", first)[0]))
    if not {"x", "y", "z"} <= set(names):
        raise UserError(f"{log.path}: points of {table.name} have no x, y and z; give a bag with clouds of a lidar")
    size = int(table.values("point_step", first)[0])
    try:
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
    except ValueError as error:
        raise UserError(f"{log.path}: the description of points in {table.name} is invalid ({error})") from error
