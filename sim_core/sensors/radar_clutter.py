"""Echoes of sea and rain at X band: reflectivity, its statistics, and the attenuation of rain.

    sea     Gregers-Hansen and Mital 2012 (NRL/MR/5310--12-9346, eq. 7 and table 1), a fit to Nathanson's tables
    wind    Horst, Dyer and Tuley 1978 (the GIT model): factor of the angle between beam and wind
    spikes  K-distribution: the mean of each resolution cell is a gamma variable (Ward, Tough and Watts 2013, ch. 2)
    rain    Marshall and Palmer 1948, Rayleigh scattering (Skolnik 2001, 7.6); attenuation by ITU-R P.838-3

Angles from the wind are 0 for a beam that points to where the wind comes from.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from sim_core.environment.spec import WaveSpec
from sim_core.frames import Array

Polarisation = Literal["horizontal", "vertical"]
_NRL = {
    "horizontal": (-73.00, 20.78, 7.351, 25.65, 0.00540),
    "vertical": (-50.79, 25.93, 0.7093, 21.58, 0.00211),
}
_GRAZING_DEG = (0.05, 60.0)  # the fit has data from 0.1 to 60 degrees
_SHAPES = (0.05, 100.0)  # below, a cell is empty most of the time; above, the sea is Gaussian
_K_POLARISATION = {"horizontal": 1.7, "vertical": 1.0}
DIELECTRIC = 0.93  # |K|^2 of water
RAIN_FACTOR, RAIN_EXPONENT = 200.0, 1.6


def sea_reflectivity_db(
    grazing_deg: Array, frequency_ghz: float, sea_state: float, polarisation: Polarisation
) -> Array:
    """Return the mean reflectivity sigma0 (...,), dB of m²/m², at grazing angles (...,): NRL, eq. 7.

    Angles beyond 0.05 to 60 degrees are limited to this interval.
    """
    c1, c2, c3, c4, c5 = _NRL[polarisation]
    angle = np.clip(grazing_deg, *_GRAZING_DEG)
    level: Array = (
        c1
        + c2 * np.log10(np.sin(np.radians(angle)))
        + (27.5 + c3 * angle) * math.log10(frequency_ghz) / (1.0 + 0.95 * angle)
        + c4 * (1.0 + sea_state) ** (1.0 / (2.0 + 0.085 * angle + 0.033 * sea_state))
        + c5 * angle**2
    )
    return level


def wind_factor_db(from_wind_rad: Array, grazing_deg: Array, wavelength_m: float) -> Array:
    """Return the change of sigma0, dB, by the angle from the wind: GIT. It is 0 across the wind and has the mean 0."""
    decay = np.maximum(1.0 - 2.8 * np.radians(grazing_deg), 0.0)
    factor: Array = 0.2 * np.cos(from_wind_rad) * decay / (wavelength_m + 0.015) ** 0.4
    return 10.0 / math.log(10.0) * factor


def spike_shape(grazing_deg: Array, cell_m2: Array, from_waves_rad: Array, polarisation: Polarisation) -> Array:
    """Return the shape of the gamma variable of a resolution cell (...,) of an area: Ward, Tough and Watts, ch. 2.

    A small shape makes spikes. from_waves_rad: between the beam and the direction of the waves.
    """
    angle = np.clip(grazing_deg, *_GRAZING_DEG)
    exponent = 2.0 / 3.0 * np.log10(angle) + 0.625 * np.log10(cell_m2) - _K_POLARISATION[polarisation]
    shape: Array = np.clip(10.0 ** (exponent - np.cos(2.0 * from_waves_rad) / 3.0), *_SHAPES)
    return shape


def sea_state(waves: WaveSpec, wind_mps: float) -> float | None:
    """Return the sea state of Nathanson's tables for waves and wind at 10 m, the larger of the two; None for a mirror.

    Waves: h1/3 = 0.04 + 0.1 S^2.1 (NRL, fig. 1). Wind: v = 3.16 S^0.8 (Horst, Dyer and Tuley 1978). The fit ends at 6.
    """
    height_m = 0.0 if waves.spectrum == "none" else waves.significant_height_m
    if not height_m and not wind_mps:
        return None
    by_waves = math.pow(max(height_m - 0.04, 0.0) / 0.1, 1.0 / 2.1)
    return min(max(by_waves, math.pow(wind_mps / 3.16, 1.25)), 6.0)


def rain_reflectivity_per_m(rain_mmph: float, wavelength_m: float) -> float:
    """Return the cross section of rain per volume, m²/m³: pi^5 |K|^2 Z / lambda^4 with Z = 200 r^1.6 mm^6/m³."""
    z_m3 = RAIN_FACTOR * math.pow(rain_mmph, RAIN_EXPONENT) * 1e-18
    return math.pi**5 * DIELECTRIC * z_m3 / wavelength_m**4


_LOG_K = ((-5.33980, -0.10008, 1.13098), (-0.35351, 1.26970, 0.45400), (-0.23789, 0.86036, 0.15354),
          (-0.94158, 0.64552, 0.16817))  # fmt: skip
_ALPHA = ((-0.14318, 1.82442, -0.55187), (0.29591, 0.77564, 0.19822), (0.32177, 0.63773, 0.13164),
          (-5.37610, -0.96230, 1.47828), (16.1721, -3.29980, 3.43990))  # fmt: skip


def rain_attenuation_dbpkm(rain_mmph: float, frequency_ghz: float) -> float:
    """Return the one-way attenuation k r^alpha of rain for horizontal polarisation: ITU-R P.838-3, tables 1 and 3.

    Vertical polarisation has 10 % less at X band.
    """
    if not rain_mmph:
        return 0.0
    decades = math.log10(frequency_ghz)
    log_k, alpha = (sum(a * math.exp(-(((decades - b) / c) ** 2)) for a, b, c in table) for table in (_LOG_K, _ALPHA))
    log_k += -0.18961 * decades + 0.71147
    alpha += 0.67849 * decades - 1.95537
    return float(10.0**log_k * rain_mmph**alpha)
