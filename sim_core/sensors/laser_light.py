"""Light of a laser at 905 nm through air, fog and the surface of water."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import float32
from numpy.random import Generator
from numpy.typing import NDArray

Array32 = NDArray[float32]

WAVELENGTH_NM = 905.0
WATER_INDEX = 1.328  # of refraction at 905 nm (Hale and Querry 1973)
FOG_LIDAR_RATIO_SR = 18.0  # extinction over backscatter of water droplets (O'Connor, Illingworth and Hogan 2004)
PULSE_M = 0.75  # what lies within one pulse of 5 ns returns together
_CLUMPS = 0.1  # of the optical depth: how often a clump of fog is dense enough to be taken for a target (chosen)


def extinction_per_m(visibility_m: float) -> float:
    """Of 905 nm where 550 nm is seen to visibility_m: Koschmieder's 3.912 / V, over wavelengths as Kim 2001 has it."""
    if math.isinf(visibility_m):
        return 0.0
    km = visibility_m * 1e-3
    exponents = ((50.0, 1.6), (6.0, 1.3), (1.0, 0.16 * km + 0.34), (0.5, km - 0.5), (0.0, 0.0))
    exponent = next(exponent for least_km, exponent in exponents if km > least_km)
    return 3.912 / visibility_m * math.pow(WAVELENGTH_NM / 550.0, -exponent)


def through_surface(cosine: Array32) -> Array32:
    """(n,) share of unpolarised light that passes from air into water (Fresnel), cosine of incidence given."""
    cosine = np.clip(cosine, float32(0.0), float32(1.0))
    refracted = np.sqrt(1.0 - (1.0 - cosine * cosine) * float32(WATER_INDEX**-2))
    index = float32(WATER_INDEX)
    across = (cosine - index * refracted) / (cosine + index * refracted)
    along = (index * cosine - refracted) / (index * cosine + refracted)
    passed: Array32 = 1.0 - 0.5 * (across * across + along * along)
    return passed


@dataclass(frozen=True, slots=True)
class Air:
    """Air of one visibility, inf for clear. It weakens what passes and, in clumps, returns light itself."""

    visibility_m: float = math.inf

    def __post_init__(self) -> None:
        if not self.visibility_m > 0.0:
            raise ValueError(
                f"environment.visibility_m = {self.visibility_m} must be above zero; leave it out for clear"
            )

    @property
    def extinction_per_m(self) -> float:
        """Of the laser's light, 1/m."""
        return extinction_per_m(self.visibility_m)

    @property
    def reflectivity(self) -> float:
        """Of a diffuse target that returns as much as the fog within one pulse: pi beta dR."""
        return math.pi * self.extinction_per_m / FOG_LIDAR_RATIO_SR * PULSE_M

    def both_ways(self, range_m: Array32) -> Array32 | float32:
        """(n,) share that is left after range_m and back (Beer-Lambert)."""
        extinction = self.extinction_per_m
        return np.exp(range_m * float32(-2.0 * extinction)) if extinction else float32(1.0)

    def clumps_m(self, count: int, rng: Generator) -> Array32 | None:
        """(count,) how far off the first clump is that can be taken for a target, None in clear air."""
        extinction = self.extinction_per_m
        if not extinction:
            return None
        return rng.standard_exponential(count, dtype=float32) * float32(1.0 / (_CLUMPS * extinction))
