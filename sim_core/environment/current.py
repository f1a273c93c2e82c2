"""Water currents: StillWater, UniformCurrent, ChannelCurrent.

    current = make_current(spec)

The state of a current is the (N,) deviation of its speed from the mean.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import Protocol

import numpy as np
from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.environment.spec import CurrentSpec
from sim_core.frames import Array
from sim_core.noise import GaussMarkov


class Current(Protocol):
    """A current: evolution of its state and its velocity at the vessels' positions."""

    def initial(self, vessels: int, rng: Generator) -> Array:
        """Return the (N,) initial state."""
        ...

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        """Return the (N,) state one step later."""
        ...

    def velocity_ned_mps(self, state: Array, pos_ned_m: Array) -> Array:
        """Return the (N, 3) velocity of the water at (N, 3) positions."""
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
    """The same current everywhere. Its speed is a first-order Gauss-Markov process (Fossen 2021, eq 10.117)."""

    spec: CurrentSpec
    direction_ned: Array = field(init=False, repr=False, compare=False)  # (3,) unit vector of the flow
    _variation: GaussMarkov = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        course = math.radians(self.spec.direction_deg)
        object.__setattr__(self, "direction_ned", np.array([math.cos(course), math.sin(course), 0.0]))
        object.__setattr__(self, "_variation", GaussMarkov(self.spec.deviation_mps, self.spec.correlation_s))

    def initial(self, vessels: int, rng: Generator) -> Array:
        return self._variation.initial(vessels, rng)

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        return self._variation.step(state, dt_s, rng)

    def velocity_ned_mps(self, state: Array, pos_ned_m: Array) -> Array:
        velocity: Array = (self.spec.speed_mps + state)[:, None] * self.direction_ned
        return velocity


@dataclass(frozen=True, slots=True)
class ChannelCurrent:
    """A uniform current that slackens toward two straight banks, see CurrentSpec. The channel has a finite width."""

    uniform: UniformCurrent

    def initial(self, vessels: int, rng: Generator) -> Array:
        return self.uniform.initial(vessels, rng)

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        return self.uniform.step(state, dt_s, rng)

    def velocity_ned_mps(self, state: Array, pos_ned_m: Array) -> Array:
        share = bank_share(self.uniform.spec, pos_ned_m)
        velocity: Array = share[:, None] * self.uniform.velocity_ned_mps(state, pos_ned_m)
        return velocity


def bank_share(spec: CurrentSpec, pos_ned_m: Array) -> Array:
    """Return the (N,) share of the speed in the middle of the channel that flows at (N, 3) positions."""
    assert spec.channel_width_m is not None
    centre_north_m, centre_east_m = spec.channel_centre_ned_m
    course = math.radians(spec.direction_deg)
    north, east = math.cos(course), math.sin(course)
    across_m = north * (pos_ned_m[:, 1] - centre_east_m) - east * (pos_ned_m[:, 0] - centre_north_m)
    shear = np.minimum(np.abs(across_m) * (2.0 / spec.channel_width_m), 1.0) ** spec.channel_bank_exponent
    share: Array = 1.0 - (1.0 - spec.channel_bank_ratio) * shear
    return share


def make_current(spec: CurrentSpec) -> Current:
    """Return the kind of current that the specification defines."""
    if not spec.speed_mps and not spec.deviation_mps:
        return StillWater()
    uniform = UniformCurrent(spec)
    return uniform if spec.channel_width_m is None else ChannelCurrent(uniform)
