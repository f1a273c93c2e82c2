"""Map of lidar and sonar points, one per cell, in the frame of the odometry.

A single lidar hit may be a drop of water or have a wrong pose. So a cell counts when two clouds have hit it, and its
point is the mean of the two. A sonar beam seldom passes twice, so one echo is enough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.companion.rigid_motion import transform_points

Array = NDArray[np.float64]
Points = NDArray[np.float32]
Intensity = NDArray[np.uint8]

LIDAR, SONAR = 0, 1
"""Sources: XITL_CLOUD_KIND minus one."""

_BITS = 20
_HALF = 1 << (_BITS - 1)


class MapPoints(NamedTuple):
    """Points of the map."""

    points_odom_m: Points
    """(k, 3)."""
    intensity: Intensity
    """(k,)."""


NO_POINTS = MapPoints(np.empty((0, 3), dtype=np.float32), np.empty(0, dtype=np.uint8))
HITS_NEEDED = {LIDAR: 2, SONAR: 1}
"""Number of clouds or pings that must hit a cell before it counts."""


MOST_ONCE = 1 << 17
"""Cells with one hit that are kept, some 35 MB. Drops of water add them for as long as a run lasts."""


class CloudMap:
    """Cells of size cell_m, with one point per cell and source. The caller keeps the points.

    Points farther than far_m from the body are dropped, because one degree is one metre at 60 m. The map covers 2**19
    cells around its origin. Points outside are refused.
    """

    def __init__(self, cell_m: float = 0.1, far_m: float = 60.0) -> None:
        self._cell_m = cell_m
        self._far_m = far_m
        self._cells: set[int] = set()
        self._once: dict[int, tuple[float, float, float]] = {}
        self.refused = 0

    def __len__(self) -> int:
        return len(self._cells)

    def add(self, pose_odom: Array, points_frd_m: Points, intensity: Intensity, source: int = LIDAR) -> MapPoints:
        """Add points (n, 3) in body axes at a pose (4, 4). Return the new points of the map."""
        with np.errstate(invalid="ignore", over="ignore"):
            near = np.einsum("ij,ij->i", points_frd_m, points_frd_m) <= self._far_m**2
        # Find the cell of each point.
        points, intensity = transform_points(pose_odom, points_frd_m[near]), intensity[near]
        cell = np.floor(points / np.float32(self._cell_m))
        inside = (np.abs(cell) < _HALF).all(axis=1)
        self.refused += len(points_frd_m) - int(np.count_nonzero(np.isfinite(points_frd_m).all(axis=1)))
        self.refused += len(inside) - int(np.count_nonzero(inside))
        points, intensity, whole = points[inside], intensity[inside], cell[inside].astype(np.int64) + _HALF
        keys = ((source << _BITS | whole[:, 0]) << _BITS | whole[:, 1]) << _BITS | whole[:, 2]
        # Of each cell, take the first point. The cell counts from its first or second cloud on.
        unique, first = np.unique(keys, return_index=True)
        rows, places = [], []
        for key, row, place in zip(unique.tolist(), first.tolist(), points[first].tolist()):
            if key in self._cells:
                continue
            if HITS_NEEDED[source] > 1:
                before = self._once.pop(key, None)
                if before is None:
                    self._once[key] = tuple(place)
                    if len(self._once) > MOST_ONCE:
                        del self._once[next(iter(self._once))]
                    continue
                place = [0.5 * (here + there) for here, there in zip(place, before)]
            self._cells.add(key)
            rows.append(row)
            places.append(place)
        return MapPoints(np.array(places, dtype=np.float32).reshape(-1, 3), intensity[rows])
