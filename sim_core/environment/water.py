"""The water body and its currents: StillWater, UniformCurrent, ChannelCurrent.

A current's `direction_deg` is where the water goes, clockwise from north. Its state is (N,): the speed's deviation from
its mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.random import Generator

from sim_core.frames import Array
from sim_core.noise import GaussMarkov

GRAVITY_MPS2 = 9.80665  # standard gravity; weight and buoyancy use the same, so floatation does not depend on it


@dataclass(frozen=True, slots=True)
class Water:
    """Still water. `level_m` is the height (up positive) of its surface above the origin of the local NED frame."""

    density_kgpm3: float = 997.8
    level_m: float = 0.0
    depth_m: float = 20.0

    def __post_init__(self) -> None:
        for name, value in (("density_kgpm3", self.density_kgpm3), ("depth_m", self.depth_m)):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"water.{name} = {value} must be a positive number")
        if not math.isfinite(self.level_m):
            raise ValueError(f"water.level_m = {self.level_m} must be a number")


class Current(Protocol):
    """A current: how its state evolves and what velocity it has where the vessels are."""

    def initial(self, vessels: int, rng: Generator) -> Array:
        """(N,) initial state."""
        ...

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        """(N,) state one step later."""
        ...

    def velocity_ned_mps(self, state: Array, pos_ned_m: Array) -> Array:
        """(N, 3) velocity of the water at (N, 3) positions."""
        ...


@dataclass(frozen=True, slots=True)
class StillWater:
    """No current."""

    def initial(self, vessels: int, rng: Generator) -> Array:
        return np.zeros(vessels)

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        return state

    def velocity_ned_mps(self, state: Array, pos_ned_m: Array) -> Array:
        return np.zeros(pos_ned_m.shape)


@dataclass(frozen=True, slots=True)
class UniformCurrent:
    """The same current everywhere; its speed a first-order Gauss-Markov process (Fossen 2021, eq 10.117)."""

    speed_mps: float
    direction_deg: float
    deviation_mps: float = 0.0
    correlation_s: float = 60.0
    direction_ned: Array = field(init=False, repr=False, compare=False)  # (3,) unit vector of the flow
    _variation: GaussMarkov = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.speed_mps) and self.speed_mps >= 0.0):
            raise ValueError(f"current.speed_mps = {self.speed_mps} must be zero or a positive number")
        if not math.isfinite(self.direction_deg):
            raise ValueError(f"current.direction_deg = {self.direction_deg} must be a number of degrees")
        course = math.radians(self.direction_deg)
        object.__setattr__(self, "direction_ned", np.array([math.cos(course), math.sin(course), 0.0]))
        object.__setattr__(self, "_variation", GaussMarkov(self.deviation_mps, self.correlation_s))

    def initial(self, vessels: int, rng: Generator) -> Array:
        return self._variation.initial(vessels, rng)

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        return self._variation.step(state, dt_s, rng)

    def velocity_ned_mps(self, state: Array, pos_ned_m: Array) -> Array:
        velocity: Array = (self.speed_mps + state)[:, None] * self.direction_ned
        return velocity


@dataclass(frozen=True, slots=True)
class ChannelCurrent:
    """A current that slackens toward two straight banks, which run along its direction.

    With c the distance from the channel's middle line, the speed is the uniform one times
    `bank_ratio + (1 - bank_ratio) (1 - |2 c / width|^bank_exponent)`, and `bank_ratio` beyond the banks.
    """

    uniform: UniformCurrent
    width_m: float
    centre_ned_m: tuple[float, float] = (0.0, 0.0)
    bank_ratio: float = 0.3
    bank_exponent: float = 4.0

    def __post_init__(self) -> None:
        for name, value in (("width_m", self.width_m), ("bank_exponent", self.bank_exponent)):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"current.channel.{name} = {value} must be a positive number")
        if not 0.0 <= self.bank_ratio <= 1.0:
            raise ValueError(f"current.channel.bank_ratio = {self.bank_ratio} must lie between 0 and 1")

    def initial(self, vessels: int, rng: Generator) -> Array:
        return self.uniform.initial(vessels, rng)

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        return self.uniform.step(state, dt_s, rng)

    def velocity_ned_mps(self, state: Array, pos_ned_m: Array) -> Array:
        north, east = self.uniform.direction_ned[:2]
        across_m = north * (pos_ned_m[:, 1] - self.centre_ned_m[1]) - east * (pos_ned_m[:, 0] - self.centre_ned_m[0])
        shear = np.minimum(np.abs(across_m) * (2.0 / self.width_m), 1.0) ** self.bank_exponent
        velocity: Array = (1.0 - (1.0 - self.bank_ratio) * shear)[:, None] * self.uniform.velocity_ned_mps(
            state, pos_ned_m
        )
        return velocity
