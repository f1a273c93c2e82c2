"""Structures in the river: log boom, dam, buildings.

A log boom is a line of floating cylinders end to end, between piles that hold the line. In a uniform current, the line
has the plan of a catenary. A dam is a box, or a wall with intakes in front of it, each a niche with bars across its
mouth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy import float64
from numpy.typing import ArrayLike

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.world.geometry import (
    CONCRETE,
    PLASTIC,
    STEEL,
    UPRIGHT,
    WALL,
    Box,
    Cylinder,
    Material,
    box,
    cylinder,
    heading_matrix,
    moved,
)
from sim_core.world.plan import Capsules, Wall, Walls, box_walls, line_walls
from sim_core.world.rays import ScenePart
from sim_core.world.river import Bed, FlatBed
from sim_core.world.spec import BuildingSpec, DamSpec, LogBoomSpec

_FILLED = 0.95
"""Share of the line that is float; the rest is gaps."""
_AT_ONCE = 1_000_000
_BAR_M = 0.15
_FOUNDATION_M = 1.0
_PILE_SUNK_M = 1.0
NEAR_SURFACE_M = 0.5
"""Hulls pass over or under objects that are deeper or higher than this."""


@dataclass(frozen=True, slots=True)
class Pile:
    """An upright cylinder between two heights (down)."""

    place_ne_m: tuple[float, float]
    radius_m: float
    top_down_m: float
    bottom_down_m: float


@dataclass(frozen=True, slots=True, eq=False)
class LogBoom:
    """K floats of one radius, and the piles at the ends of the line and between."""

    centre_ned_m: Array
    """Middles of the floats, (K, 3)."""
    along_ne: Array
    """Directions of the floats along the line, of any length, (K, 2)."""
    length_m: Array
    """Lengths, (K,)."""
    radius_m: float
    piles: tuple[Pile, ...] = ()

    @classmethod
    def between_anchors(
        cls,
        anchors_ne_m: ArrayLike,
        sag_m: float,
        float_length_m: float,
        float_radius_m: float,
        down_m: float = 0.0,
        piles: Sequence[Pile] = (),
    ) -> LogBoom:
        """Return a catenary between each two of anchors_ne_m (A, 2). It sags by sag_m to the right of the direction
        along them.

        It has as many floats of about float_length_m as fit, with their axes at down_m.
        """
        anchors = np.asarray(anchors_ne_m, dtype=float64)
        return cls._through(np.column_stack([anchors, np.full(len(anchors), down_m)]), sag_m, float_length_m,
                            float_radius_m, tuple(piles))  # fmt: skip

    @classmethod
    def along_points(cls, points_ned_m: ArrayLike, float_length_m: float, float_radius_m: float) -> LogBoom:
        """Return straight lines between points_ned_m (A, 3), with the axes at the points' height."""
        return cls._through(np.asarray(points_ned_m, dtype=float64), 0.0, float_length_m, float_radius_m, ())

    @classmethod
    def _through(
        cls, anchors: Array, sag_m: float, float_length_m: float, radius_m: float, piles: tuple[Pile, ...]
    ) -> LogBoom:
        centres, along, lengths = [], [], []
        for start, end in pairwise(anchors):
            line_m = catenary_length_m(math.dist(start[:2], end[:2]), sag_m)
            count = max(round(line_m / float_length_m), 1)
            share = (np.arange(count) + 0.5) / count
            down = start[2] + share * (end[2] - start[2])
            if sag_m == 0.0:
                middle, way = start[:2] + share[:, None] * (end - start)[:2], np.tile((end - start)[:2], (count, 1))
            else:
                half = 0.5 * _FILLED / count
                bow = catenary_points_m(start[:2], end[:2], sag_m, share + half)
                stern = catenary_points_m(start[:2], end[:2], sag_m, share - half)
                middle, way = (bow + stern) / 2, bow - stern
            centres.append(np.column_stack([middle, down]))
            along.append(way)
            lengths.append(np.full(count, _FILLED * line_m / count))
        return cls(np.concatenate(centres), np.concatenate(along), np.concatenate(lengths), radius_m, piles)

    @classmethod
    def from_spec(cls, spec: LogBoomSpec, bed: Bed, water_down_m: float) -> LogBoom:
        """Return the boom of a specification. Anchors with a radius have piles."""
        if spec.anchors_ne_m is None:
            return cls.along_points(spec.points_ned_m or (), spec.float_length_m, spec.float_radius_m)
        piles = []
        for place in spec.anchors_ne_m if spec.pile_radius_m else ():
            bottom_m = float(bed.bed_down_m(np.array(place))) + _PILE_SUNK_M
            piles.append(Pile(place, spec.pile_radius_m, water_down_m - spec.pile_height_m, bottom_m))
        return cls.between_anchors(
            spec.anchors_ne_m, spec.sag_m, spec.float_length_m, spec.float_radius_m, water_down_m, piles
        )

    @property
    def axis_ne(self) -> Array:
        """Unit vectors along the floats, (K, 2)."""
        axis: Array = self.along_ne / np.linalg.norm(self.along_ne, axis=-1, keepdims=True)
        return axis

    @property
    def heading_rad(self) -> Array:
        """Headings of the floats, (K,), clockwise from north."""
        heading: Array = np.arctan2(self.along_ne[:, 1], self.along_ne[:, 0])
        return heading

    @property
    def ends_ned_m(self) -> Array:
        """Ends of the axis of each float, (K, 2, 3)."""
        half = np.zeros_like(self.centre_ned_m)
        half[:, :2] = self.axis_ne * self.length_m[:, None] / 2
        return np.stack([self.centre_ned_m - half, self.centre_ned_m + half], axis=1)

    def distance_m(self, points_ned_m: Array) -> Array:
        """Return the (n,) distances from points (n, 3) to the surface of the nearest float or pile, negative inside."""
        points, axis = np.asarray(points_ned_m, dtype=float64), self.axis_ne
        distance = np.empty(len(points))
        at_once = max(_AT_ONCE // (len(self.centre_ned_m) + 1), 1)
        for first in range(0, len(points), at_once):
            # Floats
            part = points[first : first + at_once]
            relative = part[:, None] - self.centre_ned_m[None]
            ahead = relative[..., 0] * axis[:, 0] + relative[..., 1] * axis[:, 1]
            aside = relative[..., 1] * axis[:, 0] - relative[..., 0] * axis[:, 1]
            beyond_side = np.hypot(aside, relative[..., 2]) - self.radius_m
            nearest = _capped(beyond_side, np.abs(ahead) - self.length_m / 2).min(axis=1)
            # Piles
            for pile in self.piles:
                middle, half = (pile.bottom_down_m + pile.top_down_m) / 2, (pile.bottom_down_m - pile.top_down_m) / 2
                beyond_side = np.hypot(part[:, 0] - pile.place_ne_m[0], part[:, 1] - pile.place_ne_m[1]) - pile.radius_m
                nearest = np.minimum(nearest, _capped(beyond_side, np.abs(part[:, 2] - middle) - half))
            distance[first : first + at_once] = nearest
        return distance

    def capsules(self, water_down_m: float) -> list[Capsules]:
        """Return the floats at the surface, and the piles."""
        ends = self.ends_ned_m
        afloat = np.abs(self.centre_ned_m[:, 2] - water_down_m) < self.radius_m + NEAR_SURFACE_M
        ends = ends[afloat]
        count = len(ends)
        floats = Capsules(ends[:, 0, :2], ends[:, 1, :2], np.full(count, self.radius_m), ("log boom",) * count)
        places = np.array([pile.place_ne_m for pile in self.piles]).reshape(-1, 2)
        radii = np.array([pile.radius_m for pile in self.piles])
        return [floats, Capsules(places, places, radii, ("boom pile",) * len(places))]

    def parts(self) -> list[ScenePart]:
        """Return each float and pile as a part of the scene."""
        parts = []
        shapes = {length: cylinder(self.radius_m, length, PLASTIC, sides=24) for length in set(self.length_m.tolist())}
        for centre, heading, length in zip(self.centre_ned_m, self.heading_rad, self.length_m.tolist(), strict=True):
            turn = heading_matrix(float(heading))
            solid = Cylinder(centre, turn[:, 0], self.radius_m, length, PLASTIC)
            parts.append(ScenePart("log boom", moved(shapes[length], centre, turn), (solid,)))
        for pile in self.piles:
            height = pile.bottom_down_m - pile.top_down_m
            centre = np.array([*pile.place_ne_m, (pile.bottom_down_m + pile.top_down_m) / 2])
            mesh = moved(cylinder(pile.radius_m, height, STEEL, sides=24), centre, UPRIGHT)
            solid = Cylinder(centre, UPRIGHT[:, 0], pile.radius_m, height, STEEL)
            parts.append(ScenePart("boom pile", mesh, (solid,)))
        return parts


def _capped(beyond_side: Array, beyond_end: Array) -> Array:
    """Return the distance to a cylinder with flat ends, from a point's distances beyond its side and its ends."""
    outside = np.hypot(np.maximum(beyond_side, 0.0), np.maximum(beyond_end, 0.0))
    distance: Array = outside + np.minimum(np.maximum(beyond_side, beyond_end), 0.0)
    return distance


def dam_box(spec: DamSpec) -> ScenePart:
    """Return the dam as one box, without its intakes."""
    return block("dam", spec.centre_ned_m, spec.size_m, math.radians(spec.heading_deg), CONCRETE)


def dam_parts(spec: DamSpec) -> list[ScenePart]:
    """Return a box, or with intakes a wall and niches half as deep, on the left, with bars across their mouths."""
    (length, width, height), intakes = spec.size_m, spec.intakes
    centre, heading_rad = np.array(spec.centre_ned_m), math.radians(spec.heading_deg)
    if intakes is None:
        return [dam_box(spec)]
    blocks = [((0.0, width / 4, 0.0), (length, width / 2, height))]
    top, bottom = -height / 2, height / 2
    middle_down = intakes.down_m - centre[2]
    low, high = middle_down + intakes.height_m / 2, middle_down - intakes.height_m / 2
    for above, below in ((top, high), (low, bottom)):
        if below > above:
            blocks.append(((0.0, -width / 4, (above + below) / 2), (length, width / 2, below - above)))
    pitch = length / intakes.count
    mouths = (np.arange(intakes.count) + 0.5) * pitch - length / 2
    edges = [
        -length / 2,
        *np.ravel([mouths - intakes.width_m / 2, mouths + intakes.width_m / 2], order="F"),
        length / 2,
    ]
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if last > first:
            blocks.append((((first + last) / 2, -width / 4, middle_down), (last - first, width / 2, intakes.height_m)))
    turn = heading_matrix(heading_rad)
    parts = [block("dam", centre + turn @ place, size, heading_rad, CONCRETE) for place, size in blocks]
    for mouth in mouths.tolist():
        for share in ((np.arange(intakes.bars) + 1) / (intakes.bars + 1)).tolist():
            place = np.array([mouth + (share - 0.5) * intakes.width_m, _BAR_M - width / 2, middle_down])
            size = (_BAR_M, _BAR_M, intakes.height_m)
            parts.append(block("bars", centre + turn @ place, size, heading_rad, STEEL))
    return parts


def block(
    name: str, centre_ned_m: ArrayLike, size_m: tuple[float, float, float], heading_rad: float, material: Material
) -> ScenePart:
    """Return a box of size_m with its length along the heading."""
    centre, turn = np.asarray(centre_ned_m, dtype=float64), heading_matrix(heading_rad)
    mesh = moved(box(size_m, material), centre, turn)
    return ScenePart(name, mesh, (Box(centre, np.array(size_m), turn, material),))


def building_part(bed: Bed, spec: BuildingSpec) -> ScenePart:
    """Return a block on the ground at its middle, with its height above it and its foundation a metre below."""
    length, width, height = spec.size_m
    ground = float(bed.bed_down_m(np.array(spec.centre_ne_m)))
    centre = np.array([*spec.centre_ne_m, ground + (_FOUNDATION_M - height) / 2])
    size = (length, width, height + _FOUNDATION_M)
    return block("building", centre, size, math.radians(spec.heading_deg), WALL)


def upright_walls(boom: LogBoomSpec | None, dam: DamSpec | None, surface_down_m: float = 0.0) -> Walls:
    """Return the walls of log boom and dam for range sensors. A boom between anchors floats at the surface."""
    walls: list[Wall] = []
    if boom is not None and boom.points_ned_m is not None:
        walls += line_walls(boom.points_ned_m, boom.float_radius_m)
    elif boom is not None:
        for (north0, east0, down0), (north1, east1, down1) in LogBoom.from_spec(
            boom, FlatBed(0.0), surface_down_m
        ).ends_ned_m.tolist():
            walls += line_walls([(north0, east0, down0), (north1, east1, down1)], boom.float_radius_m)
    if dam is not None:
        (north_m, east_m, down_m), (length_m, width_m, height_m) = dam.centre_ned_m, dam.size_m
        top_m, bottom_m = down_m - height_m / 2, down_m + height_m / 2
        walls += box_walls((north_m, east_m), length_m, width_m, math.radians(dam.heading_deg), top_m, bottom_m)
    return Walls.joined(walls)


def catenary_parameter_m(span_m: float, sag_m: float) -> float:
    """Return a of y = a cosh(x / a) with the given sag over the span, by bisection; sag > 0.

    sag = a (cosh(span / 2a) - 1).
    """
    # sag < span^2 / 8a (1 + (span / 2a)^2 / 6 ...): the parabola's a is the lower bound.
    low, high = 0.1 * min(sag_m, span_m), 10.0 * (span_m**2 / (8 * sag_m) + sag_m + span_m)
    for _ in range(200):
        middle = math.sqrt(low * high)
        turn = min(span_m / (2 * middle), 700.0)  # cosh overflows beyond 700.
        if 2 * middle * math.sinh(turn / 2) ** 2 > sag_m:
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)


def catenary_length_m(span_m: float, sag_m: float) -> float:
    """Return the length along the line: 2 a sinh(span / 2a)."""
    if sag_m == 0.0:
        return span_m
    a = catenary_parameter_m(span_m, sag_m)
    return 2 * a * math.sinh(span_m / (2 * a))


def catenary_points_m(from_ne_m: Array, to_ne_m: Array, sag_m: float, share: Array) -> Array:
    """Return (K, 2) places at shares (K,) of the length between two points (2,), with the sag to the right of that
    direction.
    """
    way = to_ne_m - from_ne_m
    if sag_m == 0.0:
        straight: Array = from_ne_m + share[:, None] * way
        return straight
    span_m = math.hypot(way[0], way[1])
    a = catenary_parameter_m(span_m, sag_m)
    # s = a sinh(x / a) from the middle.
    x = a * np.arcsinh((share - 0.5) * 2 * math.sinh(span_m / (2 * a)))
    depth = sag_m - 2 * a * np.sinh(x / (2 * a)) ** 2
    ahead = way / span_m
    right = np.array([-ahead[1], ahead[0]])
    hanging: Array = from_ne_m + (x[:, None] + span_m / 2) * ahead + depth[:, None] * right
    return hanging
