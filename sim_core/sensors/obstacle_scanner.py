"""Obstacle scanner: ranges all round in plan, as a turning lidar or radar gives them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator

from sim_core.environment.obstacles import Walls
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.sensors.checks import require_non_negative, require_positive, require_vector

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
