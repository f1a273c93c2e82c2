"""Magnetometer, and the Earth's field at a place."""

from __future__ import annotations

import math
from dataclasses import field
from functools import cache

import numpy as np
from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.keys import check_values
from sim_core.kinematics import Kinematics
from sim_core.noise import SampledGaussMarkov, bias_deviation, sampled_gauss_markov, white_deviation
from sim_core.sensors.measurement import Digitiser, digitiser
from sim_core.sensors.spec import MagnetometerSpec
from sim_core.state_class import state_class

_GAUSS_PER_NANOTESLA = 1e-5


@dataclass(frozen=True, slots=True)
class LocalField:
    """The Earth's field at one place."""

    ned_gauss: tuple[float, float, float]
    declination_deg: float
    """East of true north."""
    inclination_deg: float
    """Below the horizon."""


@cache  # the vessels of a fleet ask for the same place
def local_field_ned_gauss(
    latitude_deg: float, longitude_deg: float, altitude_m: float, decimal_year: float
) -> LocalField:
    """Return the field of the World Magnetic Model for the epoch of a year (NOAA and BGS; 2010.0 up to 2030.0).

    altitude_m is above the WGS84 ellipsoid. Raises ValueError for a place or a year outside the model.
    """
    from pygeomag import GeoMag  # type: ignore[import-untyped]  # here: needed once, when a model is built

    for name, value, low, high in (
        ("latitude_deg", latitude_deg, -90.0, 90.0),
        ("longitude_deg", longitude_deg, -360.0, 360.0),
        ("altitude_m", altitude_m, -1e3, 850e3),
        ("decimal_year", decimal_year, 2010.0, math.nextafter(2030.0, 0.0)),
    ):
        if not low <= value <= high:
            raise ValueError(
                f"local_field.{name} = {value} is outside the World Magnetic Model; give {low:g} to {high:g}"
            )
    field_nt = GeoMag(base_year=int(decimal_year)).calculate(
        glat=latitude_deg, glon=longitude_deg, alt=altitude_m * 1e-3, time=decimal_year
    )
    north, east, down = (float(component) * _GAUSS_PER_NANOTESLA for component in (field_nt.x, field_nt.y, field_nt.z))
    return LocalField((north, east, down), declination_deg=float(field_nt.d), inclination_deg=float(field_nt.i))


@state_class
class MagnetometerSample:
    """Sample of N magnetometers."""

    field_frd_gauss: Array
    """Magnetic field, (N, 3), body axes."""


@state_class
class MagnetometerState:
    """State of N magnetometers."""

    drifting_bias_frd_gauss: Array
    """Gauss-Markov bias, (N, 3)."""


@dataclass(frozen=True, slots=True)
class Magnetometer:
    """White noise, drifting bias, hard iron and quantisation in a uniform field, see MagnetometerSpec."""

    spec: MagnetometerSpec
    field_ned_gauss: tuple[float, float, float]
    """Field at the vessel, see `local_field_ned_gauss`."""
    _scale: Array = field(init=False, repr=False, compare=False)
    _output: Digitiser = field(init=False, repr=False, compare=False)
    _drift: SampledGaussMarkov = field(init=False, repr=False, compare=False)
    _field_ned_gauss: Array = field(init=False, repr=False, compare=False)
    _hard_iron_frd_gauss: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_values(self)
        deviation = np.full(3, bias_deviation(self.spec.bias_instability_gauss))
        drift = sampled_gauss_markov(deviation, self.spec.bias_correlation_s, self.spec.rate_hz)
        white = np.full((1, 3), white_deviation(self.spec.noise_density_gaussprthz, self.spec.rate_hz))
        put = object.__setattr__
        put(self, "_drift", drift)
        put(self, "_scale", np.hstack([white, drift.drive]))
        put(self, "_output", digitiser(self.spec.resolution_gauss))
        put(self, "_field_ned_gauss", np.array(self.field_ned_gauss, dtype=np.float64))
        put(self, "_hard_iron_frd_gauss", np.array([self.spec.hard_iron_frd_gauss], dtype=np.float64))

    def initial(self, vessels: int, rng: Generator) -> MagnetometerState:
        """Return the state of `vessels` magnetometers. The bias has its stationary deviation from the start."""
        return MagnetometerState(self._drift.initial(rng.standard_normal((vessels, 3))))

    def measure(
        self, state: MagnetometerState, truth: Kinematics, rng: Generator
    ) -> tuple[MagnetometerState, MagnetometerSample]:
        """Take one sample at the attitude of `truth`. The returned state is the state of the next sample."""
        noise = self._scale * rng.standard_normal((len(truth.rot_ned_frd), 6))
        error = state.drifting_bias_frd_gauss + noise[:, :3]
        measured = self._field_ned_gauss @ truth.rot_ned_frd + self._hard_iron_frd_gauss + error
        drifting_bias = self._drift.decay * state.drifting_bias_frd_gauss + noise[:, 3:]
        return MagnetometerState(drifting_bias), MagnetometerSample(self._output.read(measured))
