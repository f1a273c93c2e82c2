"""Files of a map and of a trajectory.

PLY: Turk, The PLY Polygon File Format, 1994. PCD: "The PCD (Point Cloud Data) file format", Point Cloud Library,
version 0.7. TUM: the trajectory format of the RGB-D benchmark of TU Munich, as evo reads it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.compare.trajectories import Trajectory, tum_text
from xitl_cli.logs.export.files import part_of

MapFormat = Literal["ply", "pcd"]

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1"), ("source", "u1")])
"""source: 0 lidar, 1 sonar."""

_FLU = np.array([1.0, -1.0, -1.0], dtype=np.float32)
_PLY_TYPES = {"f": "float", "u": "uchar"}


def points_of(
    points_frd_m: NDArray[np.float32], intensity: NDArray[np.uint8], source: NDArray[np.uint8]
) -> NDArray[Any]:
    """Return (n,) POINT in axes forward, left, up, from points (n, 3) forward, right, down."""
    packed = np.zeros(len(points_frd_m), dtype=POINT)
    for axis, name in enumerate("xyz"):
        packed[name] = points_frd_m[:, axis] * _FLU[axis]
    packed["intensity"], packed["source"] = intensity, source
    return packed


def map_bytes(packed: NDArray[Any], kind: MapFormat) -> bytes:
    """Return the whole binary file."""
    fields = packed.dtype.fields
    assert fields is not None
    kinds = [(name, field[0]) for name, field in fields.items()]
    if kind == "ply":
        properties = "".join(f"property {_PLY_TYPES[dtype.kind]} {name}\n" for name, dtype in kinds)
        header = (
            "ply\nformat binary_little_endian 1.0\ncomment metres; x forward, y left, z up where the odometry began\n"
            f"element vertex {len(packed)}\n{properties}end_header\n"
        )
    else:
        rows = {
            "VERSION": "0.7",
            "FIELDS": " ".join(name for name, _ in kinds),
            "SIZE": " ".join(str(dtype.itemsize) for _, dtype in kinds),
            "TYPE": " ".join(dtype.kind.upper() for _, dtype in kinds),
            "COUNT": " ".join("1" for _ in kinds),
            "WIDTH": str(len(packed)),
            "HEIGHT": "1",
            "VIEWPOINT": "0 0 0 1 0 0 0",
            "POINTS": str(len(packed)),
            "DATA": "binary",
        }
        header = "".join(f"{name} {value}\n" for name, value in rows.items())
    return header.encode("ascii") + packed.tobytes()


def write_map(path: Path, packed: NDArray[Any], kind: MapFormat) -> None:
    """Write the map and replace an earlier one. Raises UserError when the file cannot be written."""
    _write(path, map_bytes(packed, kind))


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write the trajectory and replace an earlier one. Raises UserError when the file cannot be written."""
    _write(path, tum_text(trajectory).encode("ascii"))


def write_text(path: Path, text: str) -> None:
    """Write the text and replace an earlier one. Raises UserError when the file cannot be written."""
    _write(path, text.encode())


def _write(path: Path, data: bytes) -> None:
    with part_of(path, overwrite=True) as part:
        part.write_bytes(data)
