"""Wind: StillAir, Wind.

    Wind(mean_mps, direction_deg, direction_deviation_deg=0.0, direction_correlation_s=300.0, gust=NoGust(),
         discrete_gusts=())

`direction_deg` is where the wind comes from, clockwise from north; the mean speed is the one at the vessels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy import float64
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.environment.gauss_markov import GaussMarkov
from sim_core.environment.gusts import DiscreteGust, Gust, NoGust

Array = NDArray[float64]


@dataclass(frozen=True, slots=True, eq=False)
class WindState:
    """gust: (N, ...) state of the gust; veer_rad: (N,) deviation of the direction from its mean."""

    gust: Array
    veer_rad: Array


class Air(Protocol):
    """The air over the water: how its state evolves and how it moves."""

    def initial(self, vessels: int, rng: Generator) -> WindState:
        """Initial state for N vessels."""
        ...

    def step(self, state: WindState, dt_s: float, rng: Generator) -> WindState:
        """State one step later."""
        ...

    def velocity_ned_mps(self, state: WindState, time_s: float) -> Array:
        """(N, 3) velocity of the air."""
        ...


@dataclass(frozen=True, slots=True)
class StillAir:
    """No wind."""

    def initial(self, vessels: int, rng: Generator) -> WindState:
        return WindState(np.zeros(vessels), np.zeros(vessels))

    def step(self, state: WindState, dt_s: float, rng: Generator) -> WindState:
        return state

    def velocity_ned_mps(self, state: WindState, time_s: float) -> Array:
        return np.zeros((len(state.veer_rad), 3))


@dataclass(frozen=True, slots=True)
class Wind:
    """A mean wind that veers slowly, with random and discrete gusts along it; a gust never turns the wind round."""

    mean_mps: float
    direction_deg: float
    direction_deviation_deg: float = 0.0
    direction_correlation_s: float = 300.0
    gust: Gust = field(default_factory=NoGust)
    discrete_gusts: tuple[DiscreteGust, ...] = ()
    _veer: GaussMarkov = field(init=False, repr=False, compare=False)
    _course_rad: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mean_mps) and self.mean_mps >= 0.0):
            raise ValueError(f"wind.mean_mps = {self.mean_mps} must be zero or a positive number")
        if not math.isfinite(self.direction_deg):
            raise ValueError(f"wind.direction_deg = {self.direction_deg} must be a number of degrees")
        veer = GaussMarkov(math.radians(self.direction_deviation_deg), self.direction_correlation_s)
        object.__setattr__(self, "_veer", veer)
        object.__setattr__(self, "_course_rad", math.radians(self.direction_deg) + math.pi)

    def initial(self, vessels: int, rng: Generator) -> WindState:
        return WindState(self.gust.initial(vessels, rng), self._veer.initial(vessels, rng))

    def step(self, state: WindState, dt_s: float, rng: Generator) -> WindState:
        return WindState(self.gust.step(state.gust, dt_s, rng), self._veer.step(state.veer_rad, dt_s, rng))

    def velocity_ned_mps(self, state: WindState, time_s: float) -> Array:
        steady_mps = self.mean_mps + sum(gust.at(time_s) for gust in self.discrete_gusts)
        speed_mps = np.maximum(steady_mps + self.gust.speed_mps(state.gust, time_s), 0.0)
        course_rad = self._course_rad + state.veer_rad
        velocity_mps = np.zeros((len(speed_mps), 3))
        np.multiply(speed_mps, np.cos(course_rad), out=velocity_mps[:, 0])
        np.multiply(speed_mps, np.sin(course_rad), out=velocity_mps[:, 1])
        return velocity_mps
