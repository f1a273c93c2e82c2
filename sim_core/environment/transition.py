"""Transition between two environments: wind, current and waves of both, with weights that add up to one.

    transition = Transition(before, after, start_s)
    fluctuation = transition.begun(fluctuation, vessels, rng)
    environment = transition.environment(time_s)  # for that fluctuation, until transition.is_over(time_s)
    fluctuation = transition.ended(fluctuation)

The weight of the new environment is p^2 (3 - 2 p), with p the elapsed part of the transition time. Its rate is zero at
both ends.
Velocities of air and water are weighted means of both environments. The wave amplitudes are weighted too, and each sea
keeps its components. No intermediate value exceeds both environments. Parts that are equal in both stay unchanged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.environment.current import Current
from sim_core.environment.environment import Environment, EnvironmentState
from sim_core.environment.waves import FlatWater, WaveField
from sim_core.environment.wind import Air, WindState
from sim_core.frames import Array

LENGTH_S = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class MixedCurrent:
    """Weighted mean of two currents. The state is (N, 2), with one column for each current."""

    before: Current
    after: Current
    share: float  # weight of `after`

    def initial(self, vessels: int, rng: Generator) -> Array:
        return np.stack([self.before.initial(vessels, rng), self.after.initial(vessels, rng)], axis=1)

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        return np.stack([self.before.step(state[:, 0], dt_s, rng), self.after.step(state[:, 1], dt_s, rng)], axis=1)

    def velocity_ned_mps(self, state: Array, pos_ned_m: Array) -> Array:
        before = self.before.velocity_ned_mps(state[:, 0], pos_ned_m)
        after = self.after.velocity_ned_mps(state[:, 1], pos_ned_m)
        return (1.0 - self.share) * before + self.share * after


@dataclass(frozen=True, slots=True, eq=False)
class MixedWindState(WindState):
    """States of two winds."""

    before: WindState
    after: WindState


@dataclass(frozen=True, slots=True, eq=False)
class MixedAir:
    """Weighted mean of two winds. The states are MixedWindState."""

    before: Air
    after: Air
    part: float  # weight of `after`

    def initial(self, vessels: int, rng: Generator) -> WindState:
        return _of_both(self.before.initial(vessels, rng), self.after.initial(vessels, rng))

    def step(self, state: WindState, dt_s: float, rng: Generator) -> WindState:
        assert isinstance(state, MixedWindState)
        return _of_both(self.before.step(state.before, dt_s, rng), self.after.step(state.after, dt_s, rng))

    def velocity_ned_mps(self, state: WindState, time_s: float, height_m: float | None = None) -> Array:
        assert isinstance(state, MixedWindState)
        before = self.before.velocity_ned_mps(state.before, time_s, height_m)
        return (1.0 - self.part) * before + self.part * self.after.velocity_ned_mps(state.after, time_s, height_m)

    def share(self, height_m: Array | float) -> Array:
        return (1.0 - self.part) * self.before.share(height_m) + self.part * self.after.share(height_m)


def _of_both(before: WindState, after: WindState) -> MixedWindState:
    return MixedWindState(after.gust, after.veer_rad, before, after)


def mixed_waves(before: WaveField | FlatWater, after: WaveField | FlatWater, share: float) -> WaveField | FlatWater:
    """Return the components of both seas. `share`: weight of `after`. Each sea keeps its current."""
    parts = [
        replace(sea, amplitude_m=part * sea.amplitude_m)
        for sea, part in ((before, 1.0 - share), (after, share))
        if isinstance(sea, WaveField) and part > 0.0
    ]
    if len(parts) < 2:
        return parts[0] if parts else FlatWater()
    currents = [np.broadcast_to(sea.current_ne_mps, sea.wave_vector_radpm.shape) for sea in parts]
    return WaveField(
        amplitude_m=np.concatenate([sea.amplitude_m for sea in parts]),
        omega_radps=np.concatenate([sea.omega_radps for sea in parts]),
        wave_vector_radpm=np.concatenate([sea.wave_vector_radpm for sea in parts]),
        phase_rad=np.concatenate([sea.phase_rad for sea in parts]),
        current_ne_mps=np.concatenate(currents),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Transition:
    """Transition to another environment of the same water and tide."""

    before: Environment
    after: Environment
    start_s: float
    """Simulation time of its start."""
    length_s: float = LENGTH_S

    def share(self, time_s: float) -> float:
        """Return the weight of `after`, from 0 to 1."""
        passed = min(max((time_s - self.start_s) / self.length_s, 0.0), 1.0)
        return passed * passed * (3.0 - 2.0 * passed)

    def is_over(self, time_s: float) -> bool:
        """Return True when only `after` remains."""
        return self.share(time_s) >= 1.0

    def environment(self, time_s: float) -> Environment:
        """Return the environment at an instant. Its fluctuation comes from `begun`."""
        before, after, share = self.before, self.after, self.share(time_s)
        return Environment(
            before.water,
            before.current if self._keeps_current else MixedCurrent(before.current, after.current, share),
            before.waves if before.waves is after.waves else mixed_waves(before.waves, after.waves, share),
            before.wind if self._keeps_wind else MixedAir(before.wind, after.wind, share),
            before.tide,
        )

    def begun(self, state: EnvironmentState, vessels: int, rng: Generator) -> EnvironmentState:
        """Add to the fluctuation of `before` a fluctuation of `after`, drawn from its stationary distribution."""
        current, wind = state.current, state.wind
        if not self._keeps_current:
            current = np.stack([current, self.after.current.initial(vessels, rng)], axis=1)
        if not self._keeps_wind:
            wind = _of_both(wind, self.after.wind.initial(vessels, rng))
        return EnvironmentState(current, wind)

    def ended(self, state: EnvironmentState) -> EnvironmentState:
        """Return the fluctuation of `after` alone."""
        current, wind = state.current, state.wind
        if not self._keeps_current:
            current = current[:, 1]
        if not self._keeps_wind:
            assert isinstance(wind, MixedWindState)
            wind = wind.after
        return EnvironmentState(current, wind)

    @property
    def _keeps_current(self) -> bool:
        return self.before.current is self.after.current

    @property
    def _keeps_wind(self) -> bool:
        return self.before.wind is self.after.wind
