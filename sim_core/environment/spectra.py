"""Wave spectra and the dispersion relation.

Spectra are one-sided densities S(omega) in m^2 s/rad of the angular frequency in rad/s; the integral over omega is
Hs^2 / 16.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.environment.water import GRAVITY_MPS2

Array = NDArray[float64]


def pierson_moskowitz(omega_radps: Array, significant_height_m: float, peak_period_s: float) -> Array:
    """Pierson-Moskowitz by significant height and peak: 5/16 Hs^2 wp^4 w^-5 exp(-1.25 (wp/w)^4)."""
    peak_radps = 2.0 * np.pi / peak_period_s
    density: Array = (
        (5.0 / 16.0)
        * significant_height_m**2
        * peak_radps**4
        / omega_radps**5
        * np.exp(-1.25 * (peak_radps / omega_radps) ** 4)
    )
    return density


def jonswap(omega_radps: Array, significant_height_m: float, peak_period_s: float, gamma: float = 3.3) -> Array:
    """JONSWAP, normalised to Hs numerically; DNV-RP-C205 3.5.5 has the same shape with an approximate factor."""

    def shape(omega: Array) -> Array:
        peak_radps = 2.0 * np.pi / peak_period_s
        width = np.where(omega <= peak_radps, 0.07, 0.09)
        peak = gamma ** np.exp(-0.5 * ((omega - peak_radps) / (width * peak_radps)) ** 2)
        peaked: Array = pierson_moskowitz(omega, significant_height_m, peak_period_s) * peak
        return peaked

    grid = (2.0 * np.pi / peak_period_s) * np.geomspace(0.2, 50.0, 8001)
    density: Array = shape(omega_radps) * (significant_height_m**2 / 16.0 / np.trapezoid(shape(grid), grid))
    return density


def wave_density(
    name: str, significant_height_m: float, peak_period_s: float, gamma: float
) -> Callable[[Array], Array]:
    """The density function S(omega) of a spectrum by its name."""
    if name == "pierson-moskowitz":
        return lambda omega: pierson_moskowitz(omega, significant_height_m, peak_period_s)
    if name == "jonswap":
        return lambda omega: jonswap(omega, significant_height_m, peak_period_s, gamma)
    raise ValueError(f"waves.spectrum = {name!r} is not known; use one of pierson-moskowitz, jonswap")


def wave_number(omega_radps: Array, depth_m: float) -> Array:
    """Root k of omega^2 = g k tanh(k d), in rad/m, by Newton's method from Eckart's (1952) approximation."""
    alpha = omega_radps**2 * depth_m / GRAVITY_MPS2
    kd = alpha / np.sqrt(np.tanh(alpha))
    for _ in range(8):  # quadratic convergence from a start within 5 %: 4 steps reach rounding, the rest is margin
        tanh = np.tanh(kd)
        kd = kd - (kd * tanh - alpha) / (tanh + kd * (1.0 - tanh * tanh))
    k: Array = kd / depth_m
    return k


def spreading_quantiles(spreading: float, count: int) -> Array:
    """`count` angles in rad, symmetric about 0, that divide cos^2s(angle / 2) on (-pi, pi) into equal parts."""
    angle = np.linspace(-np.pi, np.pi, 20001)
    density = np.cos(0.5 * angle) ** (2.0 * spreading)
    cumulative = np.concatenate(([0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))))
    return np.interp((np.arange(count) + 0.5) / count, cumulative / cumulative[-1], angle)
