"""Barometer in the International Standard Atmosphere.

ISO 2533:1975 below 11 km, with a linear decrease of temperature. Its altitude is geopotential. The difference from
geometric altitude (16 cm at 1 km) is neglected.
"""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

import numpy as np
from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.keys import Bounds, Positive, check_values
from sim_core.kinematics import Kinematics
from sim_core.noise import SampledGaussMarkov, sampled_gauss_markov
from sim_core.sensors.measurement import Digitiser, digitiser
from sim_core.sensors.spec import BarometerSpec
from sim_core.state_class import state_class

SEA_LEVEL_PRESSURE_PA = 101325.0
SEA_LEVEL_TEMPERATURE_K = 288.15
LAPSE_RATE_KPM = 0.0065
PRESSURE_EXPONENT = 9.80665 / (287.05287 * LAPSE_RATE_KPM)

_ZERO_CELSIUS_K = 273.15


def pressure_pa(altitude_m: Array, sea_level_pressure_pa: float = SEA_LEVEL_PRESSURE_PA) -> Array:
    """Return the pressure at an altitude above mean sea level, same shape."""
    ratio: Array = (1.0 - (LAPSE_RATE_KPM / SEA_LEVEL_TEMPERATURE_K) * altitude_m) ** PRESSURE_EXPONENT
    return ratio * sea_level_pressure_pa


@state_class
class BarometerSample:
    """Sample of N barometers."""

    pressure_pa: Array
    """Pressure, (N,)."""
    temperature_degc: Array
    """Temperature of the air, (N,)."""


@state_class
class BarometerState:
    """State of N barometers."""

    drift_pa: Array
    """Slowly varying pressure error, (N, 1)."""


@dataclass(frozen=True, slots=True)
class Barometer:
    """White noise, drift and quantisation of the static pressure, see BarometerSpec."""

    spec: BarometerSpec
    origin_altitude_m: Annotated[float, Bounds(at_most=11_000)] = 0.0
    """Altitude of the NED origin above mean sea level, within the troposphere."""
    sea_level_pressure_pa: Positive = SEA_LEVEL_PRESSURE_PA
    _drift: SampledGaussMarkov = field(init=False, repr=False, compare=False)
    _scale: Array = field(init=False, repr=False, compare=False)
    _output: Digitiser = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_values(self)
        drift = sampled_gauss_markov([self.spec.drift_pa], self.spec.drift_correlation_s, self.spec.rate_hz)
        put = object.__setattr__
        put(self, "_drift", drift)
        put(self, "_scale", np.hstack([[[self.spec.noise_pa]], drift.drive]))
        put(self, "_output", digitiser(self.spec.resolution_pa))

    def initial(self, vessels: int, rng: Generator) -> BarometerState:
        """Return the state of `vessels` barometers. The drift has its stationary deviation from the start."""
        return BarometerState(self._drift.initial(rng.standard_normal((vessels, 1))))

    def measure(
        self, state: BarometerState, truth: Kinematics, rng: Generator
    ) -> tuple[BarometerState, BarometerSample]:
        """Take one sample at the height of `truth`. The returned state is the state of the next sample."""
        noise = self._scale * rng.standard_normal((len(truth.pos_ned_m), 2))
        altitude = self.origin_altitude_m - truth.pos_ned_m[:, 2]
        error = state.drift_pa[:, 0] + noise[:, 0]
        measured = pressure_pa(altitude, self.sea_level_pressure_pa) + error
        sample = BarometerSample(
            pressure_pa=self._output.read(measured),
            temperature_degc=(SEA_LEVEL_TEMPERATURE_K - _ZERO_CELSIUS_K) - LAPSE_RATE_KPM * altitude,
        )
        return BarometerState(self._drift.decay * state.drift_pa + noise[:, 1:]), sample
