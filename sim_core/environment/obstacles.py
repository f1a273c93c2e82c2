"""What stands in the water, as upright walls, and how far a ray goes before it meets one.

    Walls.of([*box(...), *boom(...)])

In plan a wall is a segment from a to b. The ray from o along d meets it where o + s d = a + t (b - a), that is with the
two-dimensional cross product x: s = (a - o) x (b - a) / d x (b - a) and t = (a - o) x d / d x (b - a), 0 <= t <= 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim_core.frames import Array

Point = tuple[float, float]
_PARALLEL = 1e-12


@dataclass(frozen=True, slots=True)
class Wall:
    """An upright rectangle over the segment between two points (north, east), between two heights (down)."""

    from_ne_m: Point
    to_ne_m: Point
    top_down_m: float
    bottom_down_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """K walls: from_ne_m, span_ne_m (K, 2), top_down_m, bottom_down_m (K,)."""

    from_ne_m: Array
    span_ne_m: Array
    top_down_m: Array
    bottom_down_m: Array

    @classmethod
    def of(cls, walls: Sequence[Wall]) -> Walls:
        """All of these; none at all is open water."""
        start = np.array([wall.from_ne_m for wall in walls], dtype=np.float64).reshape(-1, 2)
        end = np.array([wall.to_ne_m for wall in walls], dtype=np.float64).reshape(-1, 2)
        top = np.array([wall.top_down_m for wall in walls], dtype=np.float64)
        return cls(start, end - start, top, np.array([wall.bottom_down_m for wall in walls], dtype=np.float64))

    def range_in_plan_m(self, origin_ne_m: Array, direction_ne: Array) -> Array:
        """(N, M) range to the nearest wall in plan, whatever its height, inf where there is none.

        origin_ne_m: (N, 2); direction_ne: (N, M, 2) unit vectors.
        """
        distance = self._crossings(origin_ne_m, direction_ne)
        nearest: Array = np.min(distance, axis=2, initial=np.inf)
        return nearest

    def range_m(self, origin_ned_m: Array, direction_ned: Array) -> Array:
        """(N, M) range to the nearest wall along (N, M, 3) unit vectors from (N, 3), inf where there is none."""
        distance = self._crossings(origin_ned_m[:, :2], direction_ned[:, :, :2])
        finite = np.where(np.isfinite(distance), distance, 0.0)
        down_m = origin_ned_m[:, None, None, 2] + finite * direction_ned[:, :, None, 2]
        met = (down_m >= self.top_down_m) & (down_m <= self.bottom_down_m)
        nearest: Array = np.min(np.where(met, distance, np.inf), axis=2, initial=np.inf)
        return nearest

    def _crossings(self, origin: Array, direction: Array) -> Array:
        """(N, M, K) how far along each ray each wall is, inf where it is not."""
        to_wall = self.from_ne_m[None, None] - origin[:, None, None]
        ray, span = direction[:, :, None], self.span_ne_m[None, None]
        turn = ray[..., 0] * span[..., 1] - ray[..., 1] * span[..., 0]
        slanted = np.abs(turn) > _PARALLEL
        per_turn = 1.0 / np.where(slanted, turn, 1.0)
        along = (to_wall[..., 0] * span[..., 1] - to_wall[..., 1] * span[..., 0]) * per_turn
        share = (to_wall[..., 0] * ray[..., 1] - to_wall[..., 1] * ray[..., 0]) * per_turn
        hit = slanted & (along >= 0.0) & (share >= 0.0) & (share <= 1.0)
        distance: Array = np.where(hit, along, np.inf)
        return distance


def box(
    centre_ne_m: Point, length_m: float, width_m: float, heading_rad: float, top_down_m: float, bottom_down_m: float
) -> list[Wall]:
    """The four sides of a box; its length lies along the heading."""
    cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
    corners = [
        (
            centre_ne_m[0] + cosine * ahead * length_m / 2 - sine * right * width_m / 2,
            centre_ne_m[1] + sine * ahead * length_m / 2 + cosine * right * width_m / 2,
        )
        for ahead, right in ((1, 1), (1, -1), (-1, -1), (-1, 1))
    ]
    return [
        Wall(corner, following, top_down_m, bottom_down_m)
        for corner, following in zip(corners, corners[1:] + corners[:1], strict=True)
    ]


def boom(points_ned_m: Sequence[tuple[float, float, float]], radius_m: float) -> list[Wall]:
    """A line of floats: a box as wide and as high as they are along each piece, its axis at the points' height."""
    walls: list[Wall] = []
    for (north0, east0, down0), (north1, east1, down1) in pairwise(points_ned_m):
        centre, axis_m = ((north0 + north1) / 2, (east0 + east1) / 2), (down0 + down1) / 2
        length_m, heading = math.hypot(north1 - north0, east1 - east0), math.atan2(east1 - east0, north1 - north0)
        walls += box(centre, length_m, 2 * radius_m, heading, axis_m - radius_m, axis_m + radius_m)
    return walls
