"""Clouds of a bag: sensor_msgs/PointCloud2, rotated into the vessel's axes by tf_static."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from agent.companion.clouds import PointCloud
from agent.wire import dialect
from sim_core.frames import quat_to_matrix
from xitl_cli.errors import UserError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Table

CLOUD_COLUMNS = {"point_step", "width", "height", "data", "fields.length", "header.stamp", "header.frame_id"}
VESSEL = ("base_link", "base_footprint")
TIMES = ("time", "t", "time_offset", "offset_time")
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
_MOST_FIELDS = 32
_FRD = np.array([1.0, -1.0, -1.0], dtype=np.float32)
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
