"""The environment: water, current, waves and wind, and their state."""

from __future__ import annotations

from dataclasses import field

from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.environment.current import Current, StillWater, make_current
from sim_core.environment.spec import EnvironmentSpec, Water
from sim_core.environment.tide import NO_TIDE, Tide, make_tide
from sim_core.environment.waves import FlatWater, WaveField, realise_waves
from sim_core.environment.wind import Air, StillAir, WindState, make_wind
from sim_core.frames import Array


@dataclass(frozen=True, slots=True, eq=False)
class Environment:
    """Environment(water=Water(), current=StillWater(), waves=FlatWater(), wind=StillAir(), tide=NO_TIDE).

    The wave field is one sea that all vessels share; current and wind fluctuate independently for each vessel. The tide
    raises the whole surface, and its stream is the same for all vessels.
    """

    water: Water = field(default_factory=Water)
    current: Current = field(default_factory=StillWater)
    waves: WaveField | FlatWater = field(default_factory=FlatWater)
    wind: Air = field(default_factory=StillAir)
    tide: Tide = NO_TIDE

    @classmethod
    def from_spec(cls, spec: EnvironmentSpec, rng: Generator) -> Environment:
        """Return the environment of a specification. `rng` draws the phases of the waves."""
        waves = realise_waves(spec.waves, spec.water, rng, spec.current.mean_ne_mps)
        return cls(spec.water, make_current(spec.current), waves, make_wind(spec.wind), make_tide(spec))

    def level_m(self, time_s: float) -> float:
        """Return the height of the still water above the local origin."""
        return self.water.level_m + self.tide.height_m(time_s)

    def current_ned_mps(self, state: Array, time_s: float, pos_ned_m: Array) -> Array:
        """Return the (N, 3) velocity of the water at (N, 3) positions, without waves. state: of the current."""
        velocity = self.current.velocity_ned_mps(state, pos_ned_m)
        stream = self.tide.stream
        return velocity if stream is None else velocity + stream.velocity_ned_mps(time_s, pos_ned_m)

    def surface_ned_z_m(self, time_s: float, pos_ne_m: Array) -> Array:
        """Return the (...,) down coordinate of the surface at (..., 2) positions, for scenes and range sensors."""
        return -(self.level_m(time_s) + self.waves.elevation_m(time_s, pos_ne_m))


@dataclass(frozen=True, slots=True, eq=False)
class EnvironmentState:
    """State of the random fluctuations of N vessels."""

    current: Array
    """State of the current, (N, ...)."""
    wind: WindState
    """State of the wind, (N, ...)."""


def initial(environment: Environment, vessels: int, rng: Generator) -> EnvironmentState:
    """Draw the state from the stationary distributions."""
    return EnvironmentState(environment.current.initial(vessels, rng), environment.wind.initial(vessels, rng))


def step(environment: Environment, state: EnvironmentState, dt_s: float, rng: Generator) -> EnvironmentState:
    """Return the state one step later."""
    return EnvironmentState(
        environment.current.step(state.current, dt_s, rng), environment.wind.step(state.wind, dt_s, rng)
    )
