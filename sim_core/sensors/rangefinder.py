"""Rangefinder (echo sounder, sonar, laser or radar along one direction) and obstacle scanner (all round in plan).

Obstacles are upright walls: in plan a segment from a to b. The ray from o along d meets it where
o + s d = a + t (b - a), that is with the two-dimensional cross product x: s = (a - o) x (b - a) / d x (b - a) and
t = (a - o) x d / d x (b - a), 0 <= t <= 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.random import Generator

from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.sensors.measurement import (
    Digitiser,
    digitiser,
    require_finite,
    require_non_negative,
    require_positive,
    require_vector,
)

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


OPEN_WATER = Walls.of(())


@dataclass(frozen=True, slots=True)
class RangefinderSample:
    """range_m (N,): what is measured, with noise; inf where nothing echoes. Limits of the unit are not applied."""

    range_m: Array


@dataclass(frozen=True, slots=True)
class RangefinderState:
    """Nothing is remembered."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rangefinder:
    """Range to what is nearest along the beam, with noise of its own and in proportion to the range.

    direction_frd: where it looks, of any length; position_frd_m: from the body origin. Through `water` it meets the
    level bed at bed_down_m (down coordinate) and walls, through `air` the still surface at surface_down_m and walls.
    On a level plane a beam of beam_deg in all answers from its point nearest to the vertical, so that it reads the
    depth while the vessel leans by less than half of it; walls are met by the middle of the beam. noise_share: of the
    range. Raises ValueError naming the field that cannot be.
    """

    bed_down_m: float
    surface_down_m: float = 0.0
    walls: Walls = OPEN_WATER
    rate_hz: float = 10.0
    latency_s: float = 0.0
    through: Literal["water", "air"] = "water"
    position_frd_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction_frd: tuple[float, float, float] = (0.0, 0.0, 1.0)
    beam_deg: float = 0.0
    noise_m: float = 0.0
    noise_share: float = 0.0
    resolution_m: float = 0.0
    _position: Array = field(init=False, repr=False, compare=False)
    _direction: Array = field(init=False, repr=False, compare=False)
    _half_beam: float = field(init=False, repr=False, compare=False)
    _output: Digitiser = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_positive("rangefinder", rate_hz=self.rate_hz)
        require_finite("rangefinder", bed_down_m=self.bed_down_m, surface_down_m=self.surface_down_m)
        require_non_negative(
            "rangefinder",
            latency_s=self.latency_s,
            beam_deg=self.beam_deg,
            noise_m=self.noise_m,
            noise_share=self.noise_share,
            resolution_m=self.resolution_m,
        )
        require_vector("rangefinder", position_frd_m=self.position_frd_m, direction_frd=self.direction_frd)
        length = math.hypot(*self.direction_frd)
        if length < 1e-6:
            raise ValueError(f"rangefinder.direction_frd = {self.direction_frd} is nowhere; give [0, 0, 1] for down")
        put = object.__setattr__
        put(self, "_position", np.array(self.position_frd_m))
        put(self, "_direction", np.array(self.direction_frd) / length)
        put(self, "_half_beam", math.radians(self.beam_deg) / 2)
        put(self, "_output", digitiser(self.resolution_m))

    def initial(self, vessels: int, rng: Generator) -> RangefinderState:
        """Nothing."""
        return RangefinderState()

    def measure(
        self, state: RangefinderState, truth: Kinematics, rng: Generator
    ) -> tuple[RangefinderState, RangefinderSample]:
        """One range from where `truth` has the unit."""
        origin = truth.pos_ned_m + truth.rot_ned_frd @ self._position
        ray = truth.rot_ned_frd @ self._direction
        distance = np.minimum(self._to_plane_m(origin, ray), self.walls.range_m(origin, ray[:, None])[:, 0])
        noise = rng.standard_normal((2, len(distance)))
        nothing = np.isinf(distance)
        finite = np.where(nothing, 0.0, distance)
        measured = finite * (1.0 + self.noise_share * noise[1]) + self.noise_m * noise[0]
        read = self._output.read(np.maximum(measured, 0.0))
        return state, RangefinderSample(np.where(nothing, np.inf, read))

    def _to_plane_m(self, origin_ned_m: Array, ray_ned: Array) -> Array:
        """(N,) along the part of the beam nearest to the vertical; 0 for a unit that is itself beyond the plane."""
        plane_down_m = self.bed_down_m if self.through == "water" else self.surface_down_m
        height_m = np.maximum(plane_down_m - origin_ned_m[:, 2], 0.0)
        tilt_rad = np.arccos(np.clip(ray_ned[:, 2], -1.0, 1.0))
        cosine = np.cos(np.maximum(tilt_rad - self._half_beam, 0.0))
        meets = cosine > 1e-6
        distance: Array = np.where(meets, height_m / np.where(meets, cosine, 1.0), np.inf)
        return distance


SECTORS = 72
_RAYS = 5  # a degree apart


@dataclass(frozen=True, slots=True)
class ScanSample:
    """range_m (N, 72) to what is nearest in each sector, clockwise, the first about the bow; inf for nothing there."""

    range_m: Array


@dataclass(frozen=True, slots=True)
class ScanState:
    """Nothing is remembered."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleScanner:
    """The nearest of five rays in each sector of five degrees, with noise; heights, roll and pitch are left out.

    position_frd_m: from the body origin. Raises ValueError naming the field that cannot be.
    """

    walls: Walls
    rate_hz: float = 10.0
    latency_s: float = 0.0
    position_frd_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise_m: float = 0.0
    _position: Array = field(init=False, repr=False, compare=False)
    _rays: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_positive("obstacle_distance", rate_hz=self.rate_hz)
        require_non_negative("obstacle_distance", latency_s=self.latency_s, noise_m=self.noise_m)
        require_vector("obstacle_distance", position_frd_m=self.position_frd_m)
        degrees = np.arange(SECTORS * _RAYS) * (360.0 / (SECTORS * _RAYS)) - _RAYS // 2
        object.__setattr__(self, "_position", np.array(self.position_frd_m))
        object.__setattr__(self, "_rays", np.radians(degrees))

    def initial(self, vessels: int, rng: Generator) -> ScanState:
        """Nothing."""
        return ScanState()

    def measure(self, state: ScanState, truth: Kinematics, rng: Generator) -> tuple[ScanState, ScanSample]:
        """One turn, all at the instant of `truth`."""
        origin = truth.pos_ned_m + truth.rot_ned_frd @ self._position
        heading = np.arctan2(truth.rot_ned_frd[:, 1, 0], truth.rot_ned_frd[:, 0, 0])
        angle = heading[:, None] + self._rays
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=2)
        ranges = self.walls.range_in_plan_m(origin[:, :2], direction).reshape(-1, SECTORS, _RAYS).min(axis=2)
        noise = self.noise_m * rng.standard_normal(ranges.shape)
        return state, ScanSample(np.maximum(ranges + noise, 0.0))
