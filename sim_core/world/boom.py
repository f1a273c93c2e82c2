"""A log boom: floating cylinders end to end, between piles that hold the line.

boom = LogBoom.of(anchors_ne_m, sag_m=2.0, float_length_m=6.0, float_radius_m=0.5)
boom.distance_m(points_ned_m)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy import float64
from numpy.typing import ArrayLike, NDArray

from sim_core.world import catenary
from sim_core.world.materials import PLASTIC, STEEL
from sim_core.world.scene import Part
from sim_core.world.shapes import UPRIGHT, cylinder, heading_matrix, moved
from sim_core.world.solids import Cylinder

Array = NDArray[float64]
_FILLED = 0.95
"""Of the line is float, the rest is the gap."""
_AT_ONCE = 1_000_000


@dataclass(frozen=True, slots=True)
class Pile:
    """An upright cylinder between two heights (down)."""

    place_ne_m: tuple[float, float]
    radius_m: float
    top_down_m: float
    bottom_down_m: float


@dataclass(frozen=True, slots=True, eq=False)
class LogBoom:
    """K floats of one radius, and the piles at the ends of the line and between.

    centre_ned_m (K, 3): their middles; along_ne (K, 2): their way along the line, of any length; length_m (K,).
    """

    centre_ned_m: Array
    along_ne: Array
    length_m: Array
    radius_m: float
    piles: tuple[Pile, ...] = ()

    @classmethod
    def of(
        cls,
        anchors_ne_m: ArrayLike,
        sag_m: float,
        float_length_m: float,
        float_radius_m: float,
        down_m: float = 0.0,
        piles: Sequence[Pile] = (),
    ) -> LogBoom:
        """Between each two of anchors_ne_m (A, 2) a catenary that sags by sag_m to the right of the way along them.

        As many floats of about float_length_m as fit, their axes at down_m.
        """
        anchors = np.asarray(anchors_ne_m, dtype=float64)
        return cls._through(np.column_stack([anchors, np.full(len(anchors), down_m)]), sag_m, float_length_m,
                            float_radius_m, tuple(piles))  # fmt: skip

    @classmethod
    def along(cls, points_ned_m: ArrayLike, float_length_m: float, float_radius_m: float) -> LogBoom:
        """Straight between points_ned_m (A, 3), the axes at the points' height."""
        return cls._through(np.asarray(points_ned_m, dtype=float64), 0.0, float_length_m, float_radius_m, ())

    @classmethod
    def _through(
        cls, anchors: Array, sag_m: float, float_length_m: float, radius_m: float, piles: tuple[Pile, ...]
    ) -> LogBoom:
        centres, along, lengths = [], [], []
        for start, end in pairwise(anchors):
            line_m = catenary.length_m(math.dist(start[:2], end[:2]), sag_m)
            count = max(round(line_m / float_length_m), 1)
            share = (np.arange(count) + 0.5) / count
            down = start[2] + share * (end[2] - start[2])
            if sag_m == 0.0:
                middle, way = start[:2] + share[:, None] * (end - start)[:2], np.tile((end - start)[:2], (count, 1))
            else:
                half = 0.5 * _FILLED / count
                bow = catenary.points_m(start[:2], end[:2], sag_m, share + half)
                stern = catenary.points_m(start[:2], end[:2], sag_m, share - half)
                middle, way = (bow + stern) / 2, bow - stern
            centres.append(np.column_stack([middle, down]))
            along.append(way)
            lengths.append(np.full(count, _FILLED * line_m / count))
        return cls(np.concatenate(centres), np.concatenate(along), np.concatenate(lengths), radius_m, piles)

    @property
    def axis_ne(self) -> Array:
        """(K, 2) unit vectors along the floats."""
        axis: Array = self.along_ne / np.linalg.norm(self.along_ne, axis=-1, keepdims=True)
        return axis

    @property
    def heading_rad(self) -> Array:
        """(K,) of the floats, clockwise from north."""
        heading: Array = np.arctan2(self.along_ne[:, 1], self.along_ne[:, 0])
        return heading

    @property
    def ends_ned_m(self) -> Array:
        """(K, 2, 3) where the axis of each float begins and ends."""
        half = np.zeros_like(self.centre_ned_m)
        half[:, :2] = self.axis_ne * self.length_m[:, None] / 2
        return np.stack([self.centre_ned_m - half, self.centre_ned_m + half], axis=1)

    def distance_m(self, points_ned_m: Array) -> Array:
        """(n,) from points (n, 3) to the surface of the nearest float or pile, negative inside."""
        points = np.asarray(points_ned_m, dtype=float64)
        distance = np.empty(len(points))
        at_once = max(_AT_ONCE // (len(self.centre_ned_m) + 1), 1)
        for first in range(0, len(points), at_once):
            part = points[first : first + at_once]
            nearest = self._float_distance(part).min(axis=1)
            for pile in self.piles:
                nearest = np.minimum(nearest, _pile_distance(pile, part))
            distance[first : first + at_once] = nearest
        return distance

    def _float_distance(self, points: Array) -> Array:
        """(n, K) to the surface of each float."""
        axis = self.axis_ne
        relative = points[:, None] - self.centre_ned_m[None]
        ahead = relative[..., 0] * axis[:, 0] + relative[..., 1] * axis[:, 1]
        aside = relative[..., 1] * axis[:, 0] - relative[..., 0] * axis[:, 1]
        return _capped(np.hypot(aside, relative[..., 2]) - self.radius_m, np.abs(ahead) - self.length_m / 2)

    def parts(self) -> list[Part]:
        """Each float and pile as a part of the scene."""
        parts = []
        shapes = {length: cylinder(self.radius_m, length, PLASTIC, sides=24) for length in set(self.length_m.tolist())}
        for centre, heading, length in zip(self.centre_ned_m, self.heading_rad, self.length_m.tolist(), strict=True):
            turn = heading_matrix(float(heading))
            solid = Cylinder(centre, turn[:, 0], self.radius_m, length, PLASTIC)
            parts.append(Part("log boom", moved(shapes[length], centre, turn), (solid,)))
        for pile in self.piles:
            height = pile.bottom_down_m - pile.top_down_m
            centre = np.array([*pile.place_ne_m, (pile.bottom_down_m + pile.top_down_m) / 2])
            mesh = moved(cylinder(pile.radius_m, height, STEEL, sides=24), centre, UPRIGHT)
            solid = Cylinder(centre, UPRIGHT[:, 0], pile.radius_m, height, STEEL)
            parts.append(Part("boom pile", mesh, (solid,)))
        return parts


def _pile_distance(pile: Pile, points: Array) -> Array:
    middle, half = (pile.bottom_down_m + pile.top_down_m) / 2, (pile.bottom_down_m - pile.top_down_m) / 2
    round_m = np.hypot(points[:, 0] - pile.place_ne_m[0], points[:, 1] - pile.place_ne_m[1]) - pile.radius_m
    return _capped(round_m, np.abs(points[:, 2] - middle) - half)


def _capped(beyond_side: Array, beyond_end: Array) -> Array:
    """The distance to a cylinder with flat ends, from how far outside its side and its ends a point is."""
    outside = np.hypot(np.maximum(beyond_side, 0.0), np.maximum(beyond_end, 0.0))
    distance: Array = outside + np.minimum(np.maximum(beyond_side, beyond_end), 0.0)
    return distance
