"""Fixed structures in plan: capsules for contact with hulls and bodies, and upright walls for range sensors.

A capsule is all points within a radius of a straight axis; the object it represents is upright and reaches through the
surface. Two capsules touch if an end of one axis is nearer to the other axis than the sum of the radii. Parallel axes
touch at two ends, so that neither pivots on one point.

A wall is a segment from a to b. The ray from o along d intersects it at o + s d = a + t (b - a). With the
two-dimensional cross product x: s = (a - o) x (b - a) / d x (b - a) and t = (a - o) x d / d x (b - a), 0 <= t <= 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy import intp
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array

Numbers = NDArray[intp]
Point = tuple[float, float]
_PARALLEL = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Capsules:
    """S capsules."""

    from_ne_m: Array
    """First ends of the axes, (S, 2) north, east."""
    to_ne_m: Array
    """Second ends of the axes, (S, 2) north, east."""
    radius_m: Array
    """Radii, (S,)."""
    names: tuple[str, ...]
    """Name of each capsule's object."""

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def joined(cls, parts: Sequence[Capsules]) -> Capsules:
        """Join several parts in order."""
        return cls(
            np.concatenate([np.empty((0, 2)), *(part.from_ne_m for part in parts)]),
            np.concatenate([np.empty((0, 2)), *(part.to_ne_m for part in parts)]),
            np.concatenate([np.empty(0), *(part.radius_m for part in parts)]),
            tuple(name for part in parts for name in part.names),
        )

    def distance_m(self, points_ne_m: Array) -> Array:
        """Return the (P, S) distances of (P, 2) points from the capsules' edges, negative inside."""
        nearest, _ = nearest_on_axis(points_ne_m[:, None], self.from_ne_m[None], self.to_ne_m[None])
        between = points_ne_m[:, None] - nearest
        distance: Array = np.sqrt(np.vecdot(between, between)) - self.radius_m
        return distance


def box_capsules(
    name: str, centre_ne_m: tuple[float, float], size_m: tuple[float, float], heading_rad: float
) -> Capsules:
    """Return the four sides of a box. Its corners are rounded by a quarter of its width, 0.5 m at most."""
    length, width = size_m
    radius = min(0.25 * min(length, width), 0.5)
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    half = np.array([0.5 * length - radius, 0.5 * width - radius])
    signs = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
    corners = np.array(centre_ne_m) + (signs * half) @ np.array([ahead, [-ahead[1], ahead[0]]])
    return Capsules(corners, np.roll(corners, -1, axis=0), np.full(4, radius), (name,) * 4)


@dataclass(frozen=True, slots=True, eq=False)
class Touches:
    """K places at which a capsule presses on another."""

    first: Numbers
    """Indices into the first set, (K,)."""
    second: Numbers
    """Indices into the second set, (K,)."""
    normal_ne: Array
    """Unit vectors that push the first capsule, (K, 2)."""
    place_ne_m: Array
    """Middle of the overlap, (K, 2)."""
    depth_m: Array
    """Depth of the overlap, (K,)."""


def touches(a: Capsules, b: Capsules, first: Numbers, second: Numbers) -> Touches:
    """Return the touches of capsules a[first] and b[second], pair by pair."""
    a0, a1, b0, b1 = a.from_ne_m[first], a.to_ne_m[first], b.from_ne_m[second], b.to_ne_m[second]
    reach = a.radius_m[first] + b.radius_m[second]
    candidates = []  # vector from b to a, place on b, and whether it counts
    for end in (a0, a1):
        nearest, _ = nearest_on_axis(end, b0, b1)
        candidates.append((end - nearest, nearest, reach > 0.0))
    for end in (b0, b1):
        nearest, share = nearest_on_axis(end, a0, a1)
        candidates.append((nearest - end, end, (share > 0.0) & (share < 1.0)))  # otherwise an end of a gave this touch
    between, on_b, counts = (np.concatenate(column) for column in zip(*candidates, strict=True))
    distance = np.sqrt(np.vecdot(between, between))
    reach, first, second = np.tile(reach, 4), np.tile(first, 4), np.tile(second, 4)
    met = np.flatnonzero(counts & (distance < reach))
    apart = distance[met]
    normal = between[met] / np.maximum(apart, 1e-9)[:, None]
    depth = reach[met] - apart
    outward = b.radius_m[second[met]] - 0.5 * depth
    return Touches(first[met], second[met], normal, on_b[met] + outward[:, None] * normal, depth)


def nearest_on_axis(points: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Return the nearest place (..., 2) on the segment from start to end, and its share (...,) of the way, 0 to 1."""
    along = end - start
    square = np.vecdot(along, along)
    share = np.vecdot(points - start, along) / np.where(square > 0.0, square, 1.0)
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    return start + share[..., None] * along, share


def inset(corners_m: Array, by_m: float) -> Array:
    """Return the (P, 2) corners, in order, of a convex polygon with all sides moved inward."""
    along = np.roll(corners_m, -1, axis=0) - corners_m
    along = along / np.sqrt(np.vecdot(along, along))[:, None]
    inward = np.column_stack([-along[:, 1], along[:, 0]])
    inward *= np.sign(np.vecdot(inward, corners_m.mean(axis=0) - corners_m))[:, None]
    # Intersection of two sides' lines: n . x = n . p + by, of the previous side and of this one.
    normals = np.stack([np.roll(inward, 1, axis=0), inward], axis=1)
    offsets = np.vecdot(normals, corners_m[:, None]) + by_m
    met: Array = np.linalg.solve(normals, offsets[..., None])[..., 0]
    return met


def convex_hull(points_m: Array) -> Array:
    """Return the (P, 2) corners, in order, of the convex hull of points (K, 2): Andrew's (1979) monotone chain."""
    ordered = np.unique(points_m, axis=0).tolist()

    def chain(points: list[list[float]]) -> list[list[float]]:
        corners: list[list[float]] = []
        for x, y in points:
            while len(corners) > 1:
                (x0, y0), (x1, y1) = corners[-2:]
                if (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) > 0.0:
                    break
                corners.pop()
            corners.append([x, y])
        return corners[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))


@dataclass(frozen=True, slots=True)
class Wall:
    """An upright rectangle above the segment between two points (north, east), between two heights (down)."""

    from_ne_m: Point
    to_ne_m: Point
    top_down_m: float
    bottom_down_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """K walls."""

    from_ne_m: Array
    """First ends, (K, 2)."""
    span_ne_m: Array
    """Vectors to the second ends, (K, 2)."""
    top_down_m: Array
    """Down coordinate of the top, (K,)."""
    bottom_down_m: Array
    """Down coordinate of the bottom, (K,)."""

    @classmethod
    def joined(cls, walls: Sequence[Wall]) -> Walls:
        """Join walls; no walls at all is open water."""
        start = np.array([wall.from_ne_m for wall in walls], dtype=np.float64).reshape(-1, 2)
        end = np.array([wall.to_ne_m for wall in walls], dtype=np.float64).reshape(-1, 2)
        top = np.array([wall.top_down_m for wall in walls], dtype=np.float64)
        return cls(start, end - start, top, np.array([wall.bottom_down_m for wall in walls], dtype=np.float64))

    @classmethod
    def of_parts(cls, parts: Sequence[Walls]) -> Walls:
        """Join several sets of walls; `OPEN_WATER` for none."""
        if not parts:
            return OPEN_WATER
        return cls(
            np.concatenate([part.from_ne_m for part in parts]),
            np.concatenate([part.span_ne_m for part in parts]),
            np.concatenate([part.top_down_m for part in parts]),
            np.concatenate([part.bottom_down_m for part in parts]),
        )

    def range_in_plan_m(self, origin_ne_m: Array, direction_ne: Array) -> Array:
        """Return the (N, M) range to the nearest wall in plan at any height, inf for none.

        origin_ne_m: (N, 2); direction_ne: (N, M, 2) unit vectors.
        """
        distance = self._crossings(origin_ne_m, direction_ne)
        nearest: Array = np.min(distance, axis=2, initial=np.inf)
        return nearest

    def range_m(self, origin_ned_m: Array, direction_ned: Array) -> Array:
        """Return the (N, M) range to the nearest wall along (N, M, 3) unit vectors from (N, 3), inf for none."""
        distance = self._crossings(origin_ned_m[:, :2], direction_ned[:, :, :2])
        finite = np.where(np.isfinite(distance), distance, 0.0)
        down_m = origin_ned_m[:, None, None, 2] + finite * direction_ned[:, :, None, 2]
        met = (down_m >= self.top_down_m) & (down_m <= self.bottom_down_m)
        nearest: Array = np.min(np.where(met, distance, np.inf), axis=2, initial=np.inf)
        return nearest

    def _crossings(self, origin: Array, direction: Array) -> Array:
        """Return the (N, M, K) distance along each ray to each wall, inf for no intersection."""
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


OPEN_WATER = Walls.joined(())


def box_walls(
    centre_ne_m: Point, length_m: float, width_m: float, heading_rad: float, top_down_m: float, bottom_down_m: float
) -> list[Wall]:
    """Return the four sides of a box with its length along the heading."""
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


def line_walls(points_ned_m: Sequence[tuple[float, float, float]], radius_m: float) -> list[Wall]:
    """Return walls for a line of cylinders. Each wall has the width and height of the cylinders, about the points'
    height.
    """
    walls: list[Wall] = []
    for (north0, east0, down0), (north1, east1, down1) in pairwise(points_ned_m):
        centre, axis_m = ((north0 + north1) / 2, (east0 + east1) / 2), (down0 + down1) / 2
        length_m, heading = math.hypot(north1 - north0, east1 - east0), math.atan2(east1 - east0, north1 - north0)
        walls += box_walls(centre, length_m, 2 * radius_m, heading, axis_m - radius_m, axis_m + radius_m)
    return walls
