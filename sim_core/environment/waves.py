"""The sea surface: FlatWater, WaveField and the sea states that realise one.

    FlatWater()
    RegularWave(height_m, period_s, direction_deg).realise(water, rng) -> WaveField
    IrregularWaves(spectrum, significant_height_m, peak_period_s, direction_deg, gamma=3.3, spreading=None,
                   components=32).realise(water, rng) -> WaveField

`direction_deg` is where the waves go, clockwise from north. Linear (Airy) theory at the surface, for component i
theta_i = k_i . x - omega_i t + phase_i: elevation `a cos theta`, up positive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import float64
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.environment.hull_waves import HullWaves, StillHull
from sim_core.environment.spectra import spreading_quantiles, wave_density, wave_number
from sim_core.environment.water import GRAVITY_MPS2, Water

Array = NDArray[float64]

LOWEST_OF_PEAK = 0.5  # band of the realised field in units of the peak frequency; the energy outside goes inside
HIGHEST_OF_PEAK = 3.0


@dataclass(frozen=True, slots=True)
class FlatWater:
    """No waves."""

    def elevation_m(self, time_s: float, pos_ne_m: Array) -> Array:
        """(...,) zero at (..., 2) positions."""
        return np.zeros(np.shape(pos_ne_m)[:-1])

    def at_hull(self, points_frd_m: Array) -> StillHull:
        """Sampler for a hull of (S, 3) points."""
        return StillHull(len(points_frd_m))


@dataclass(frozen=True, slots=True, eq=False)
class WaveField:
    """A realised sea of W components, the same for every vessel; each array (W,), wave vectors (W, 2) north, east."""

    amplitude_m: Array
    omega_radps: Array
    wave_vector_radpm: Array
    phase_rad: Array

    def phase_at(self, time_s: float, pos_ne_m: Array) -> Array:
        """(..., W) theta in rad at (..., 2) positions."""
        phase: Array = pos_ne_m @ self.wave_vector_radpm.T - self.omega_radps * time_s + self.phase_rad
        return phase

    def elevation_m(self, time_s: float, pos_ne_m: Array) -> Array:
        """(...,) height of the surface over the still level, up positive, at (..., 2) positions."""
        elevation: Array = np.cos(self.phase_at(time_s, pos_ne_m)) @ self.amplitude_m
        return elevation

    def slope(self, time_s: float, pos_ne_m: Array) -> Array:
        """(..., 2) derivative of the elevation to north and east."""
        slope: Array = np.sin(self.phase_at(time_s, pos_ne_m)) @ (-self.amplitude_m[:, None] * self.wave_vector_radpm)
        return slope

    def orbital_velocity_ned_mps(self, time_s: float, pos_ne_m: Array) -> Array:
        """(..., 3) velocity of the water at the surface: a omega coth(k d) along the wave, and its rise."""
        phase = self.phase_at(time_s, pos_ne_m)
        horizontal = np.cos(phase) @ self.drift_mps
        rise = np.sin(phase) @ (self.amplitude_m * self.omega_radps)
        return np.concatenate([horizontal, -rise[..., None]], axis=-1)

    @property
    def drift_mps(self) -> Array:
        """(W, 2) amplitude of the horizontal orbital velocity: a g k / omega = a omega coth(k d)."""
        drift: Array = (GRAVITY_MPS2 * self.amplitude_m / self.omega_radps)[:, None] * self.wave_vector_radpm
        return drift

    def at_hull(self, points_frd_m: Array) -> HullWaves:
        """Sampler for a hull of (S, 3) points."""
        return HullWaves.bind(
            self.amplitude_m, self.omega_radps, self.wave_vector_radpm, self.phase_rad, self.drift_mps, points_frd_m
        )


@dataclass(frozen=True, slots=True)
class RegularWave:
    """One harmonic wave, `height_m` from trough to crest."""

    height_m: float
    period_s: float
    direction_deg: float

    def __post_init__(self) -> None:
        _require_sea(self.height_m, self.period_s, self.direction_deg)

    def realise(self, water: Water, rng: Generator) -> WaveField:
        """The field, with a random phase."""
        omega = np.array([2.0 * np.pi / self.period_s])
        course = np.array([math.radians(self.direction_deg)])
        return _field(np.array([0.5 * self.height_m]), omega, course, water, rng)


@dataclass(frozen=True, slots=True)
class IrregularWaves:
    """A sea state; `spreading` is the s of cos^2s(angle / 2), None for long-crested waves."""

    spectrum: str
    significant_height_m: float
    peak_period_s: float
    direction_deg: float
    gamma: float = 3.3
    spreading: float | None = None
    components: int = 32

    def __post_init__(self) -> None:
        _require_sea(self.significant_height_m, self.peak_period_s, self.direction_deg)
        wave_density(self.spectrum, self.significant_height_m, self.peak_period_s, self.gamma)
        if self.components < 8:
            raise ValueError(f"waves.components = {self.components} is too few for an irregular sea; use 8 or more")
        if not self.gamma >= 1.0:
            raise ValueError(f"waves.gamma = {self.gamma} must be 1 or more")
        if self.spreading is not None and not self.spreading > 0.0:
            raise ValueError(f"waves.spreading = {self.spreading} must be positive, or null for long-crested waves")

    def realise(self, water: Water, rng: Generator) -> WaveField:
        """A field with random phases: one component per band, at a random frequency in it, with the band's energy.

        Bands of equal ratio and frequencies off their centres leave no common period; the amplitudes sum to Hs exactly.
        """
        density = wave_density(self.spectrum, self.significant_height_m, self.peak_period_s, self.gamma)
        peak_radps = 2.0 * np.pi / self.peak_period_s
        edges = peak_radps * np.geomspace(LOWEST_OF_PEAK, HIGHEST_OF_PEAK, self.components + 1)
        fine = np.geomspace(edges[:-1], edges[1:], 33, axis=1)
        variance = np.trapezoid(density(fine), fine, axis=1)
        variance = variance * (self.significant_height_m**2 / 16.0 / variance.sum())
        omega = rng.uniform(edges[:-1], edges[1:])
        course = np.full(self.components, math.radians(self.direction_deg))
        if self.spreading is not None:
            course = course + rng.permutation(spreading_quantiles(self.spreading, self.components))
        return _field(np.sqrt(2.0 * variance), omega, course, water, rng)


def _require_sea(height_m: float, period_s: float, direction_deg: float) -> None:
    for name, value in (("height", height_m), ("period", period_s)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"waves: {name} = {value} must be a positive number; for no waves use spectrum: none")
    if not math.isfinite(direction_deg):
        raise ValueError(f"waves.direction_deg = {direction_deg} must be a number of degrees")


def _field(amplitude_m: Array, omega_radps: Array, course_rad: Array, water: Water, rng: Generator) -> WaveField:
    heading = np.stack([np.cos(course_rad), np.sin(course_rad)], axis=1)
    wave_vector = wave_number(omega_radps, water.depth_m)[:, None] * heading
    return WaveField(amplitude_m, omega_radps, wave_vector, rng.uniform(0.0, 2.0 * np.pi, len(omega_radps)))
