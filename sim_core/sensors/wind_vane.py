"""Wind vane with anemometer: the apparent wind at the mast."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator

from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.sensors.measurement import (
    Digitiser,
    cross_matrix,
    digitiser,
)
from sim_core.sensors.spec import WindVaneSpec


@dataclass(frozen=True, slots=True)
class WindSample:
    """speed_mps (N,) of the air past the mast, direction_rad (N,) it comes from: clockwise from the bow, (-pi, pi]."""

    speed_mps: Array
    direction_rad: Array


@dataclass(frozen=True, slots=True)
class WindVaneState:
    """felt_frd_mps (N, 2): the air past the mast as the unit follows it; None before the first sample."""

    felt_frd_mps: Array | None = None


@dataclass(frozen=True, slots=True)
class WindVane:
    """What of the wind lies in the deck's plane, behind the lag of vane and cups: see WindVaneSpec.

    share_at: speed of the wind at (N,) heights above the still water over that of the air it is given; level_m: of
    that water.
    """

    spec: WindVaneSpec
    share_at: Callable[[Array], Array] = np.ones_like
    level_m: float = 0.0
    _cross: Array = field(init=False, repr=False, compare=False)
    _gain: float = field(init=False, repr=False, compare=False)
    _speed: Digitiser = field(init=False, repr=False, compare=False)
    _direction: Digitiser = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "_cross", cross_matrix(self.spec.position_frd_m))
        gain = -math.expm1(-1.0 / (self.spec.rate_hz * self.spec.response_s)) if self.spec.response_s else 1.0
        put(self, "_gain", gain)
        put(self, "_speed", digitiser(self.spec.speed_resolution_mps))
        put(self, "_direction", digitiser(math.radians(self.spec.direction_resolution_deg)))

    def initial(self, vessels: int, rng: Generator) -> WindVaneState:
        """The vane stands in the wind already at the first sample."""
        return WindVaneState()

    def measure(
        self, state: WindVaneState, truth: Kinematics, air_ned_mps: Array, rng: Generator
    ) -> tuple[WindVaneState, WindSample]:
        """One sample in air that moves with air_ned_mps (N, 3)."""
        height_m = -self.level_m - truth.pos_ned_m[:, 2] - truth.rot_ned_frd[:, 2] @ self.spec.position_frd_m
        relative_ned = air_ned_mps * self.share_at(height_m)[:, None] - truth.vel_ned_mps
        past_frd = (relative_ned[:, None] @ truth.rot_ned_frd)[:, 0] - truth.gyro_frd_radps @ self._cross
        felt = past_frd[:, :2]
        if state.felt_frd_mps is not None:
            felt = state.felt_frd_mps + self._gain * (felt - state.felt_frd_mps)
        noise = rng.standard_normal((2, len(felt)))
        speed = np.sqrt(np.vecdot(felt, felt)) + self.spec.speed_noise_mps * noise[0]
        direction = np.arctan2(-felt[:, 1], -felt[:, 0]) + math.radians(self.spec.direction_noise_deg) * noise[1]
        direction = self._direction.read(direction)
        sample = WindSample(
            speed_mps=np.clip(self._speed.read(speed), 0.0, self.spec.max_speed_mps),
            direction_rad=np.pi - np.mod(np.pi - direction, 2.0 * np.pi),
        )
        return WindVaneState(felt), sample
