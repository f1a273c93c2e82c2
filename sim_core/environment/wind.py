"""Wind and gusts.

    air = make_wind(spec)

The wind speed grows with height by a power law (1/7, as measured over flat country and water; Hsu, Meindl and Gilhousen
1994 found 0.11 over the open sea) or by the logarithmic law of a neutral boundary layer (DNV-RP-C205, 2.3.2).

A gust is a deviation of the speed from its mean. Gust spectra are one-sided densities S(f) in (m/s)^2/Hz of the
frequency f in Hz. Their U is the mean at 10 m, for gusts at any height.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field
from typing import Protocol

import numpy as np
from numpy import float32
from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.environment.spec import DiscreteGust, WindSpec
from sim_core.frames import Array
from sim_core.noise import GaussMarkov

LOWEST_HZ = 1.0 / 1200.0  # slower variations than 20 minutes are weather, not gusts
HIGHEST_HZ = 2.0  # a vessel's windage averages out faster variations
_HARMONICS = 48
SPECTRA_MEAN_M = 10.0
"""Height of the mean wind speed in gust spectra."""
LOWEST_M = 0.05  # lowest height of the profile; the wind below it equals the wind at it


class Gust(Protocol):
    """A random gust: evolution of its state and the speed that it adds to the mean."""

    def initial(self, vessels: int, rng: Generator) -> Array:
        """Return the (N, ...) initial state."""
        ...

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        """Return the (N, ...) state one step later."""
        ...

    def speed_mps(self, state: Array, time_s: float) -> Array:
        """Return the (N,) deviation from the mean wind speed."""
        ...


@dataclass(frozen=True, slots=True)
class NoGust:
    """A steady wind."""

    def initial(self, vessels: int, rng: Generator) -> Array:
        return np.zeros(vessels)

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        return state

    def speed_mps(self, state: Array, time_s: float) -> Array:
        return state


@dataclass(frozen=True, slots=True)
class OrnsteinUhlenbeckGust:
    """First-order gust; the state (N,) is the deviation itself."""

    process: GaussMarkov

    def initial(self, vessels: int, rng: Generator) -> Array:
        return self.process.initial(vessels, rng)

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        return self.process.step(state, dt_s, rng)

    def speed_mps(self, state: Array, time_s: float) -> Array:
        return state


@dataclass(frozen=True, slots=True, eq=False)
class SpectralGust:
    """A sum of W harmonics that realises a spectrum. The state (N, W) holds each vessel's random phases, in rad."""

    frequency_hz: Array
    amplitude_mps: Array

    @classmethod
    def from_spectrum(
        cls, name: str, mean_mps: float, height_m: float, deviation_mps: float | None = None
    ) -> SpectralGust:
        """Return harmonics on logarithmic bands, each with the energy of its band, scaled to `deviation_mps` if given.

        mean_mps: mean wind speed at 10 m. height_m: height of the gusts.
        """
        density = gust_density(name)
        if not (mean_mps > 0.0 and height_m > 0.0):
            raise ValueError(
                f"wind.gust.spectrum = {name!r} needs a positive mean_mps and height; got {mean_mps}, {height_m}"
            )
        edges_hz = np.geomspace(LOWEST_HZ, HIGHEST_HZ, _HARMONICS + 1)
        fine_hz = np.geomspace(edges_hz[:-1], edges_hz[1:], 17, axis=1)
        variance = np.trapezoid(density(fine_hz, mean_mps, height_m), fine_hz, axis=1)
        if deviation_mps is not None:
            variance = variance * (deviation_mps**2 / variance.sum())
        # Off-centre by the golden ratio: the harmonics have no common period, so the gusts never repeat.
        position = (np.arange(_HARMONICS) * 0.6180339887498949) % 1.0
        return cls(edges_hz[:-1] * (edges_hz[1:] / edges_hz[:-1]) ** position, np.sqrt(2.0 * variance))

    def initial(self, vessels: int, rng: Generator) -> Array:
        return rng.uniform(0.0, 2.0 * math.pi, (vessels, len(self.frequency_hz)))

    def step(self, state: Array, dt_s: float, rng: Generator) -> Array:
        return state

    def speed_mps(self, state: Array, time_s: float) -> Array:
        turns = self.frequency_hz * time_s
        phase_rad = state + (2.0 * math.pi) * (turns - np.floor(turns))
        speed: Array = np.cos(phase_rad.astype(float32)) @ self.amplitude_mps
        return speed


def discrete_gusts_mps(gusts: tuple[DiscreteGust, ...], time_s: Array) -> Array:
    """Return the (N,) speed that all single gusts add at (N,) instants."""
    speed_mps = np.zeros(len(time_s))
    for gust in gusts:
        risen = np.clip((time_s - gust.start_s) / gust.rise_s, 0.0, 1.0)
        fallen = np.clip((time_s - gust.start_s - gust.rise_s - gust.hold_s) / gust.fall_s, 0.0, 1.0)
        speed_mps += 0.5 * gust.speed_mps * (np.cos(math.pi * fallen) - np.cos(math.pi * risen))
    return speed_mps


def discrete_gust_mps(gust: DiscreteGust, time_s: float) -> float:
    """Return the speed that a single gust adds at an instant."""
    risen = min(max((time_s - gust.start_s) / gust.rise_s, 0.0), 1.0)
    fallen = min(max((time_s - gust.start_s - gust.rise_s - gust.hold_s) / gust.fall_s, 0.0), 1.0)
    return 0.5 * gust.speed_mps * (math.cos(math.pi * fallen) - math.cos(math.pi * risen))


def npd_density(frequency_hz: Array, mean_mps: float, height_m: float) -> Array:
    """Norwegian Petroleum Directorate density (NORSOK N-003, ISO 19901-1) for the 1 h mean, at a height."""
    n = 0.468
    x = 172.0 * frequency_hz * (height_m / 10.0) ** (2.0 / 3.0) * (mean_mps / 10.0) ** -0.75
    density: Array = 320.0 * (mean_mps / 10.0) ** 2 * (height_m / 10.0) ** 0.45 / (1.0 + x**n) ** (5.0 / (3.0 * n))
    return density


def harris_density(frequency_hz: Array, mean_mps: float, height_m: float, drag: float = 0.003) -> Array:
    """Harris density (1971) with L = 1800 m: 4 k L U / (2 + x^2)^(5/6), x = L f / U; `drag` is the surface drag k."""
    x = 1800.0 * frequency_hz / mean_mps
    density: Array = 4.0 * drag * 1800.0 * mean_mps / (2.0 + x * x) ** (5.0 / 6.0)
    return density


def davenport_density(frequency_hz: Array, mean_mps: float, height_m: float, drag: float = 0.003) -> Array:
    """Davenport density (1961) with L = 1200 m: 4 k U^2 x^2 / (f (1 + x^2)^(4/3)), x = L f / U."""
    x = 1200.0 * frequency_hz / mean_mps
    density: Array = 4.0 * drag * mean_mps**2 * x * x / (frequency_hz * (1.0 + x * x) ** (4.0 / 3.0))
    return density


GUST_DENSITIES: dict[str, Callable[[Array, float, float], Array]] = {
    "npd": npd_density,
    "harris": harris_density,
    "davenport": davenport_density,
}


def gust_density(name: str) -> Callable[[Array, float, float], Array]:
    """Return the density function of a named spectrum."""
    if name not in GUST_DENSITIES:
        raise ValueError(f"wind.gust.spectrum = {name!r} is not known; use one of {', '.join(GUST_DENSITIES)}")
    return GUST_DENSITIES[name]


@dataclass(frozen=True, slots=True, eq=False)
class WindState:
    """State of the wind for N vessels."""

    gust: Array
    """State of the gust, (N, ...)."""
    veer_rad: Array
    """Deviation of the direction from its mean, (N,)."""
    began_s: Array | None = field(default=None, kw_only=True)
    """Instants from which the discrete gusts count, (N,). None for time 0."""


class Air(Protocol):
    """The air above the water: evolution of its state and its velocity."""

    def initial(self, vessels: int, rng: Generator) -> WindState:
        """Return the initial state for N vessels."""
        ...

    def step(self, state: WindState, dt_s: float, rng: Generator) -> WindState:
        """Return the state one step later."""
        ...

    def velocity_ned_mps(self, state: WindState, time_s: float, height_m: float | None = None) -> Array:
        """Return the (N, 3) velocity of the air at a height above the water, None for the reference height."""
        ...

    def share(self, height_m: Array | float) -> Array:
        """Return the speed at heights above the water, relative to the speed at the reference height."""
        ...


@dataclass(frozen=True, slots=True)
class StillAir:
    """No wind."""

    def initial(self, vessels: int, rng: Generator) -> WindState:
        return WindState(np.zeros(vessels), np.zeros(vessels))

    def step(self, state: WindState, dt_s: float, rng: Generator) -> WindState:
        return state

    def velocity_ned_mps(self, state: WindState, time_s: float, height_m: float | None = None) -> Array:
        return np.zeros((len(state.veer_rad), 3))

    def share(self, height_m: Array | float) -> Array:
        return np.ones_like(height_m, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Wind:
    """A mean wind that veers slowly, with random and discrete gusts along it. A gust never reverses the wind."""

    spec: WindSpec
    _gust: Gust = field(init=False, repr=False, compare=False)
    _veer: GaussMarkov = field(init=False, repr=False, compare=False)
    _course_rad: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        spec = self.spec
        veer = GaussMarkov(math.radians(spec.direction_deviation_deg), spec.direction_correlation_s)
        object.__setattr__(self, "_gust", make_gust(spec))
        object.__setattr__(self, "_veer", veer)
        object.__setattr__(self, "_course_rad", math.radians(spec.direction_deg) + math.pi)

    def initial(self, vessels: int, rng: Generator) -> WindState:
        return WindState(self._gust.initial(vessels, rng), self._veer.initial(vessels, rng))

    def step(self, state: WindState, dt_s: float, rng: Generator) -> WindState:
        gust, veer_rad = self._gust.step(state.gust, dt_s, rng), self._veer.step(state.veer_rad, dt_s, rng)
        return WindState(gust, veer_rad, began_s=state.began_s)

    def share(self, height_m: Array | float) -> Array:
        return speed_share(self.spec, height_m)

    def velocity_ned_mps(self, state: WindState, time_s: float, height_m: float | None = None) -> Array:
        gusts = self.spec.discrete_gusts
        added_mps: Array | float = 0.0
        if state.began_s is None:
            added_mps = sum(discrete_gust_mps(gust, time_s) for gust in gusts)
        elif gusts:
            added_mps = discrete_gusts_mps(gusts, time_s - state.began_s)
        steady_mps = self.spec.mean_mps + added_mps
        speed_mps = np.maximum(steady_mps + self._gust.speed_mps(state.gust, time_s), 0.0)
        course_rad = self._course_rad + state.veer_rad
        velocity_mps = np.zeros((len(speed_mps), 3))
        np.multiply(speed_mps, np.cos(course_rad), out=velocity_mps[:, 0])
        np.multiply(speed_mps, np.sin(course_rad), out=velocity_mps[:, 1])
        return velocity_mps if height_m is None else velocity_mps * self.share(height_m)


def speed_share(spec: WindSpec, height_m: Array | float) -> Array:
    """Return the speed at heights above the water, relative to the speed at the reference height."""
    height, reference = np.maximum(height_m, LOWEST_M), max(spec.reference_height_m, LOWEST_M)
    if spec.profile == "uniform":
        return np.ones_like(height)
    if spec.profile == "power":
        return np.asarray((height / reference) ** spec.exponent)
    return np.asarray(np.log(height / spec.roughness_m) / math.log(reference / spec.roughness_m))


def make_gust(spec: WindSpec) -> Gust:
    """Return the random gusts that the specification defines."""
    gust = spec.gust
    if gust.spectrum == "none":
        return NoGust()
    if gust.spectrum == "ornstein-uhlenbeck":
        return OrnsteinUhlenbeckGust(GaussMarkov(gust.deviation_mps, gust.correlation_s))
    mean_mps = spec.mean_mps * float(speed_share(spec, SPECTRA_MEAN_M))
    return SpectralGust.from_spectrum(gust.spectrum, mean_mps, spec.reference_height_m, gust.deviation_mps or None)


def make_wind(spec: WindSpec) -> Air:
    """Return the wind of the specification, or StillAir for no wind."""
    if not spec.mean_mps and spec.gust.spectrum == "none" and not spec.discrete_gusts:
        return StillAir()
    return Wind(spec)
