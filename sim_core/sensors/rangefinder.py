"""Rangefinder: an echo sounder, a sonar, a laser or a radar that looks along one direction of the body."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.random import Generator

from sim_core.environment.obstacles import Walls
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.sensors.checks import require_finite, require_non_negative, require_positive, require_vector
from sim_core.sensors.digitiser import Digitiser, digitiser

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
