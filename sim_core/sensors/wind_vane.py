"""Wind vane with anemometer: the apparent wind at the mast."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field

import numpy as np
from numpy.random import Generator

from sim_core.dataclass import dataclass
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
    """Sample of N units."""

    speed_mps: Array
    """Speed of the air past the mast, (N,)."""
    direction_rad: Array
    """Direction that the wind comes from, (N,): clockwise from the bow, (-pi, pi]."""


@dataclass(frozen=True, slots=True)
class WindVaneState:
    """State of N units."""

    felt_frd_mps: Array | None = None
    """Lagged air velocity past the mast, (N, 2) forward and right; None before the first sample."""


@dataclass(frozen=True, slots=True)
class WindVane:
    """Component of the apparent wind in the deck plane, with the lag of vane and cups, see WindVaneSpec."""

    spec: WindVaneSpec
    share_at: Callable[[Array], Array] = np.ones_like
    """Returns the wind speed at (N,) heights above the still water, relative to the air velocity given to `measure`."""
    level_m: float = 0.0
    """Mean level of the still water."""
    tide_m: Callable[[], float] | None = None
    """Returns the height of the still water above its mean level now; None without a tide."""
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
        """Return the state before the first sample, which has no lag."""
        return WindVaneState()

    def measure(
        self, state: WindVaneState, truth: Kinematics, air_ned_mps: Array, rng: Generator
    ) -> tuple[WindVaneState, WindSample]:
        """Take one sample in air that moves with air_ned_mps (N, 3)."""
        level_m = self.level_m if self.tide_m is None else self.level_m + self.tide_m()
        height_m = -level_m - truth.pos_ned_m[:, 2] - truth.rot_ned_frd[:, 2] @ self.spec.position_frd_m
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
