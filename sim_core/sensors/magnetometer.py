"""Magnetometer, and the Earth's field where it is used."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator

from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.noise import SampledGaussMarkov, bias_deviation, sampled_gauss_markov, white_deviation
from sim_core.sensors.measurement import (
    Digitiser,
    digitiser,
    require_finite,
    require_non_negative,
    require_positive,
    require_vector,
)

_GAUSS_PER_NANOTESLA = 1e-5


@dataclass(frozen=True, slots=True)
class LocalField:
    """The Earth's field at one place: ned_gauss, declination east of true north, inclination below the horizon."""

    ned_gauss: tuple[float, float, float]
    declination_deg: float
    inclination_deg: float


def local_field_ned_gauss(
    latitude_deg: float, longitude_deg: float, altitude_m: float, decimal_year: float
) -> LocalField:
    """The field of the World Magnetic Model of that year's epoch (NOAA and BGS; 2010.0 up to 2030.0).

    altitude_m is above the WGS84 ellipsoid. Raises ValueError for a place or a year outside the model.
    """
    from pygeomag import GeoMag  # type: ignore[import-untyped]  # here: needed once, when a model is built

    require_finite("local_field", longitude_deg=longitude_deg)
    for name, value, low, high in (
        ("latitude_deg", latitude_deg, -90.0, 90.0),
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


@dataclass(frozen=True, slots=True)
class MagnetometerSample:
    """field_frd_gauss (N, 3)."""

    field_frd_gauss: Array


@dataclass(frozen=True, slots=True)
class MagnetometerState:
    """drifting_bias_frd_gauss (N, 3): the Gauss-Markov bias."""

    drifting_bias_frd_gauss: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Magnetometer:
    """Three axes with white noise, drifting bias, hard iron and quantisation in a uniform field.

    field_ned_gauss: the field where the vessel is, see `local_field_ned_gauss`. noise_density_gaussprthz: the Allan
    deviation at 1 s; bias_instability_gauss: maximum of the Allan deviation of the drifting bias.
    hard_iron_frd_gauss: the vessel's own constant field, body axes. resolution_gauss: step of the output, 0 for none.
    Raises ValueError naming the field that cannot be.
    """

    field_ned_gauss: tuple[float, float, float]
    rate_hz: float = 50.0
    latency_s: float = 0.0
    noise_density_gaussprthz: float = 0.0
    bias_instability_gauss: float = 0.0
    bias_correlation_s: float = 600.0
    hard_iron_frd_gauss: tuple[float, float, float] = (0.0, 0.0, 0.0)
    resolution_gauss: float = 0.0
    _scale: Array = field(init=False, repr=False, compare=False)
    _output: Digitiser = field(init=False, repr=False, compare=False)
    _drift: SampledGaussMarkov = field(init=False, repr=False, compare=False)
    _field_ned_gauss: Array = field(init=False, repr=False, compare=False)
    _hard_iron_frd_gauss: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_positive("magnetometer", rate_hz=self.rate_hz, bias_correlation_s=self.bias_correlation_s)
        require_non_negative(
            "magnetometer",
            latency_s=self.latency_s,
            noise_density_gaussprthz=self.noise_density_gaussprthz,
            bias_instability_gauss=self.bias_instability_gauss,
            resolution_gauss=self.resolution_gauss,
        )
        require_vector(
            "magnetometer", field_ned_gauss=self.field_ned_gauss, hard_iron_frd_gauss=self.hard_iron_frd_gauss
        )
        deviation = np.full(3, bias_deviation(self.bias_instability_gauss))
        drift = sampled_gauss_markov(deviation, self.bias_correlation_s, self.rate_hz)
        white = np.full((1, 3), white_deviation(self.noise_density_gaussprthz, self.rate_hz))
        put = object.__setattr__
        put(self, "_drift", drift)
        put(self, "_scale", np.hstack([white, drift.drive]))
        put(self, "_output", digitiser(self.resolution_gauss))
        put(self, "_field_ned_gauss", np.array(self.field_ned_gauss, dtype=np.float64))
        put(self, "_hard_iron_frd_gauss", np.array([self.hard_iron_frd_gauss], dtype=np.float64))

    def initial(self, vessels: int, rng: Generator) -> MagnetometerState:
        """`vessels` magnetometers whose bias is already at its stationary deviation."""
        return MagnetometerState(self._drift.initial(rng.standard_normal((vessels, 3))))

    def measure(
        self, state: MagnetometerState, truth: Kinematics, rng: Generator
    ) -> tuple[MagnetometerState, MagnetometerSample]:
        """One sample at the attitude of `truth`; the returned state is that of the next sample."""
        noise = self._scale * rng.standard_normal((len(truth.rot_ned_frd), 6))
        error = state.drifting_bias_frd_gauss + noise[:, :3]
        measured = self._field_ned_gauss @ truth.rot_ned_frd + self._hard_iron_frd_gauss + error
        drifting_bias = self._drift.decay * state.drifting_bias_frd_gauss + noise[:, 3:]
        return MagnetometerState(drifting_bias), MagnetometerSample(self._output.read(measured))
