"""Rangefinder (echo sounder, sonar, laser or radar along one direction) and obstacle scanner (full circle in plan)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field

import numpy as np
from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.keys import check_values
from sim_core.kinematics import Kinematics
from sim_core.sensors.measurement import (
    Digitiser,
    digitiser,
)
from sim_core.sensors.spec import ObstacleScannerSpec, RangefinderSpec
from sim_core.world.plan import OPEN_WATER, Walls

_ASIDE = 0.2  # horizontal share of the beam direction above which hulls matter

HullsAround = Callable[[float], Walls]
"""Returns the sides of other vessels within a range."""
TideNow = Callable[[], float]
"""Returns the height of the still water above its mean level now, m."""


@dataclass(frozen=True, slots=True)
class RangefinderSample:
    """Sample of N units. Limits of the unit are not applied."""

    range_m: Array
    """Measured range with noise, (N,); inf for no echo."""


@dataclass(frozen=True, slots=True)
class Rangefinder:
    """Range to the nearest object along the beam, with noise, see RangefinderSpec.

    In `water`, the beam reaches the level bed and walls. In `air`, it reaches the still surface and walls. On a level
    plane, the point of the beam nearest to the vertical gives the range. On walls, the middle of the beam gives it.
    Limits of the unit are not applied.
    """

    spec: RangefinderSpec
    bed_down_m: float
    """Down coordinate of the bed."""
    surface_down_m: float = 0.0
    """Down coordinate of the mean level of the surface."""
    walls: Walls = OPEN_WATER
    hulls: HullsAround | None = None
    """Hulls of other vessels now, within a range of the vessel; None for no others."""
    tide_m: TideNow | None = None
    """None without a tide."""
    _position: Array = field(init=False, repr=False, compare=False)
    _direction: Array = field(init=False, repr=False, compare=False)
    _half_beam: float = field(init=False, repr=False, compare=False)
    _output: Digitiser = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_values(self)
        length = math.hypot(*self.spec.direction_frd)
        put = object.__setattr__
        put(self, "_position", np.array(self.spec.position_frd_m))
        put(self, "_direction", np.array(self.spec.direction_frd) / length)
        put(self, "_half_beam", math.radians(self.spec.beam_deg) / 2)
        put(self, "_output", digitiser(self.spec.resolution_m))
        if math.hypot(*self.spec.direction_frd[:2]) < _ASIDE * length:  # no vessel is above or below another
            put(self, "hulls", None)

    def initial(self, vessels: int, rng: Generator) -> None:
        """The rangefinder has no state."""

    def measure(self, state: None, truth: Kinematics, rng: Generator) -> tuple[None, RangefinderSample]:
        """Measure one range from the unit's position in `truth`."""
        origin = truth.pos_ned_m + truth.rot_ned_frd @ self._position
        ray = truth.rot_ned_frd @ self._direction
        # Range to the level plane, along the part of the beam nearest to the vertical; 0 for a unit beyond the plane
        plane_down_m = self.bed_down_m
        if self.spec.through == "air":
            plane_down_m = self.surface_down_m - (0.0 if self.tide_m is None else self.tide_m())
        height_m = np.maximum(plane_down_m - origin[:, 2], 0.0)
        tilt_rad = np.arccos(np.clip(ray[:, 2], -1.0, 1.0))
        cosine = np.cos(np.maximum(tilt_rad - self._half_beam, 0.0))
        descends = cosine > 1e-6
        distance = np.where(descends, height_m / np.where(descends, cosine, 1.0), np.inf)
        # Range to walls and hulls, along the middle of the beam
        distance = np.minimum(distance, self.walls.range_m(origin, ray[:, None])[:, 0])
        if self.hulls is not None:
            around = self.hulls(self.spec.max_range_m)
            if around is not OPEN_WATER:
                distance = np.minimum(distance, around.range_m(origin, ray[:, None])[:, 0])
        # Noise and resolution
        noise = rng.standard_normal((2, len(distance)))
        nothing = np.isinf(distance)
        finite = np.where(nothing, 0.0, distance)
        measured = finite * (1.0 + self.spec.noise_share * noise[1]) + self.spec.noise_m * noise[0]
        read = self._output.read(np.maximum(measured, 0.0))
        return None, RangefinderSample(np.where(nothing, np.inf, read))


SECTORS = 72
_RAYS = 5  # a degree apart


@dataclass(frozen=True, slots=True)
class ScanSample:
    """Sample of N scanners."""

    range_m: Array
    """Range to the nearest object in each sector, (N, 72), clockwise from the bow sector; inf for nothing there."""


@dataclass(frozen=True, slots=True)
class ObstacleScanner:
    """The nearest of five rays in each sector of five degrees, with noise. It ignores heights, roll and pitch."""

    spec: ObstacleScannerSpec
    walls: Walls
    hulls: HullsAround | None = None
    """Hulls of other vessels now, within a range of the vessel; None for no others."""
    _position: Array = field(init=False, repr=False, compare=False)
    _rays: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        degrees = np.arange(SECTORS * _RAYS) * (360.0 / (SECTORS * _RAYS)) - _RAYS // 2
        object.__setattr__(self, "_position", np.array(self.spec.position_frd_m))
        object.__setattr__(self, "_rays", np.radians(degrees))

    def initial(self, vessels: int, rng: Generator) -> None:
        """The scanner has no state."""

    def measure(self, state: None, truth: Kinematics, rng: Generator) -> tuple[None, ScanSample]:
        """Take one scan, all at the instant of `truth`."""
        origin = truth.pos_ned_m + truth.rot_ned_frd @ self._position
        heading = np.arctan2(truth.rot_ned_frd[:, 1, 0], truth.rot_ned_frd[:, 0, 0])
        angle = heading[:, None] + self._rays
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=2)
        ranges = self.walls.range_in_plan_m(origin[:, :2], direction)
        if self.hulls is not None:
            around = self.hulls(self.spec.max_range_m)
            if around is not OPEN_WATER:
                ranges = np.minimum(ranges, around.range_in_plan_m(origin[:, :2], direction))
        ranges = ranges.reshape(-1, SECTORS, _RAYS).min(axis=2)
        noise = self.spec.noise_m * rng.standard_normal(ranges.shape)
        return None, ScanSample(np.maximum(ranges + noise, 0.0))
