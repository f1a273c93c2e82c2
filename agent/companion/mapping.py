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


MOST_CELLS = 1 << 20
"""Cells of the map that are kept, 8 MB. The point of a forgotten cell is returned again at its next hit."""
MOST_ONCE = 1 << 17
"""Cells with one hit that are kept, 3 MB. Drops of water add them for as long as a run lasts."""
_WAYS = 8
_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)  # 2**64 / golden ratio: Knuth, The Art of Computer Programming 3, 6.4
_NO_CELL = -1


class CellTable:
    """A set of cells in constant memory: a set-associative cache with `_WAYS` ways.

    Each cell can be at `_WAYS` places. A new cell without a free place replaces one of the cells there, by turns.

    most: number of places; a power of two, at least 16.
    """

    def __init__(self, most: int) -> None:
        sets = most // _WAYS
        self._shift = np.uint64(65 - sets.bit_length())
        self._keys = np.full((sets, _WAYS), _NO_CELL, dtype=np.int64)
        self._replaced = np.zeros(sets, dtype=np.int8)
        self._kept = 0

    def __len__(self) -> int:
        return self._kept

    def find(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the place (n,) of each cell, a number below `most`; -1 if the cell is not in the table."""
        sets = self._sets(keys)
        same = self._keys[sets] == keys[:, None]
        places: NDArray[np.int64] = np.where(same.any(axis=1), sets * _WAYS + same.argmax(axis=1), -1)
        return places

    def add(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """Add cells (n,) that are not in the table. Return their places (n,).

        Of two cells with the same place, the second one has replaced the first one.
        """
        sets = self._sets(keys)
        places = np.empty(len(keys), dtype=np.int64)
        rows = np.arange(len(keys))
        while len(rows):
            # Add one cell to each set
            at, first = np.unique(sets[rows], return_index=True)
            free = self._keys[at] == _NO_CELL
            full = ~free.any(axis=1)
            way = np.where(full, self._replaced[at], free.argmax(axis=1))
            self._replaced[at[full]] = (way[full] + 1) % _WAYS
            self._keys[at, way] = keys[rows[first]]
            self._kept += int(np.count_nonzero(~full))
            places[rows[first]] = at * _WAYS + way
            rows = np.delete(rows, first)
        return places

    def remove(self, places: NDArray[np.int64]) -> None:
        """Remove the cells at different places (n,)."""
        self._keys.reshape(-1)[places] = _NO_CELL
        self._kept -= len(places)

    def _sets(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        return (keys.astype(np.uint64) * _MULTIPLIER >> self._shift).astype(np.int64)


class CloudMap:
    """Cells of size cell_m, with one point per cell and source. The caller keeps the points.

    Points farther than far_m from the body are dropped, because one degree is one metre at 60 m. The map covers 2**19
    cells around its origin. Points outside are refused. Its memory is constant.
    """

    def __init__(self, cell_m: float = 0.1, far_m: float = 60.0) -> None:
        self._cell_m = cell_m
        self._far_m = far_m
        self._cells, self._once = CellTable(MOST_CELLS), CellTable(MOST_ONCE)
        self._once_points = np.zeros((MOST_ONCE, 3), dtype=np.float32)
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
        # Of each cell that is not in the map, take the first point.
        keys, rows = np.unique(keys, return_index=True)
        new = self._cells.find(keys) < 0
        keys, rows = keys[new], rows[new]
        if HITS_NEEDED[source] > 1:
            # The cell counts from its second cloud on, with the mean of both points.
            place = self._once.find(keys)
            again = place >= 0
            keys_once, rows_once = keys[~again], rows[~again]
            keys, rows = keys[again], rows[again]
            points[rows] = 0.5 * (points[rows].astype(np.float64) + self._once_points[place[again]])
            self._once.remove(place[again])
            self._once_points[self._once.add(keys_once)] = points[rows_once]
        self._cells.add(keys)
        return MapPoints(points[rows], intensity[rows])
