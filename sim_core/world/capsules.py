"""Capsules in plan: all points within a radius of a straight axis. What they are of stands upright through the surface.

Two capsules touch where an end of one axis is nearer to the other axis than the radii reach; axes that lie along each
other touch at two ends, so that neither turns on one point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import intp
from numpy.typing import NDArray

from sim_core.frames import Array

Numbers = NDArray[intp]


@dataclass(frozen=True, slots=True, eq=False)
class Capsules:
    """S capsules: axes from from_ne_m to to_ne_m (S, 2) north, east; radius_m (S,). names: what each belongs to."""

    from_ne_m: Array
    to_ne_m: Array
    radius_m: Array
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def of(cls, parts: Sequence[Capsules]) -> Capsules:
        """All of these, one after the other."""
        return cls(
            np.concatenate([np.empty((0, 2)), *(part.from_ne_m for part in parts)]),
            np.concatenate([np.empty((0, 2)), *(part.to_ne_m for part in parts)]),
            np.concatenate([np.empty(0), *(part.radius_m for part in parts)]),
            tuple(name for part in parts for name in part.names),
        )

    def distance_m(self, points_ne_m: Array) -> Array:
        """(P, S) of (P, 2) points from the capsules' edges, negative inside."""
        nearest, _ = nearest_on_axis(points_ne_m[:, None], self.from_ne_m[None], self.to_ne_m[None])
        between = points_ne_m[:, None] - nearest
        distance: Array = np.sqrt(np.vecdot(between, between)) - self.radius_m
        return distance


def box(name: str, centre_ne_m: tuple[float, float], size_m: tuple[float, float], heading_rad: float) -> Capsules:
    """The four sides of a box of length and width; its corners are rounded by a quarter of its width, 0.5 m at most."""
    length, width = size_m
    radius = min(0.25 * min(length, width), 0.5)
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    half = np.array([0.5 * length - radius, 0.5 * width - radius])
    signs = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
    corners = np.array(centre_ne_m) + (signs * half) @ np.array([ahead, [-ahead[1], ahead[0]]])
    return Capsules(corners, np.roll(corners, -1, axis=0), np.full(4, radius), (name,) * 4)


@dataclass(frozen=True, slots=True, eq=False)
class Touches:
    """K places where a capsule presses on another: which of the first ones and of the second ones (K,).

    normal_ne (K, 2): unit, pushes the first; place_ne_m (K, 2): middle of the overlap; depth_m (K,): of it.
    """

    first: Numbers
    second: Numbers
    normal_ne: Array
    place_ne_m: Array
    depth_m: Array


def touches(a: Capsules, b: Capsules, first: Numbers, second: Numbers) -> Touches:
    """Where capsules a[first] touch b[second], pair by pair."""
    a0, a1, b0, b1 = a.from_ne_m[first], a.to_ne_m[first], b.from_ne_m[second], b.to_ne_m[second]
    reach = a.radius_m[first] + b.radius_m[second]
    found = []
    for end in (a0, a1):
        nearest, _ = nearest_on_axis(end, b0, b1)
        found.append((end - nearest, nearest, reach > 0.0))
    for end in (b0, b1):
        nearest, share = nearest_on_axis(end, a0, a1)
        found.append((nearest - end, end, (share > 0.0) & (share < 1.0)))  # else an end of a found it already
    between = np.concatenate([row[0] for row in found])
    on_b = np.concatenate([row[1] for row in found])
    counts = np.concatenate([row[2] for row in found])
    distance = np.sqrt(np.vecdot(between, between))
    reach, first, second = np.tile(reach, 4), np.tile(first, 4), np.tile(second, 4)
    met = np.flatnonzero(counts & (distance < reach))
    apart = distance[met]
    normal = between[met] / np.maximum(apart, 1e-9)[:, None]
    depth = reach[met] - apart
    outward = b.radius_m[second[met]] - 0.5 * depth
    return Touches(first[met], second[met], normal, on_b[met] + outward[:, None] * normal, depth)


def nearest_on_axis(points: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Nearest place (..., 2) on the straight from start to end, and its share (...,) of the way, 0 to 1."""
    along = end - start
    square = np.vecdot(along, along)
    share = np.vecdot(points - start, along) / np.where(square > 0.0, square, 1.0)
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    return start + share[..., None] * along, share
