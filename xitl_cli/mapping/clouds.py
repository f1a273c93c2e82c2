"""Clouds, pings and poses of a recording, converted back to body FRD and NED."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.companion.clouds import PointCloud
from agent.companion.sonar import SonarPing
from agent.wire import dialect
from agent.wire.codec import Message, decode
from agent.wire.framing import CHECKSUM_BYTES, HEADER_BYTES, MAGIC
from sim_core import frames
from xitl_cli.errors import UserError
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Table
from xitl_cli.mapping.foreign_clouds import cloud_topic, foreign_clouds
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
