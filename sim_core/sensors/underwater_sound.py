"""Sound in fresh water: how fast it is, and what the water takes of it."""

from __future__ import annotations

import numpy as np


def absorption_dbpm(frequency_khz: float, temperature_c: float) -> float:
    """Absorption one way, dB/m, near the surface of fresh water.

    Francois and Garrison 1982, part II: of the three terms of their equation the viscosity of the water alone,
    as there is neither boric acid nor magnesium sulphate.
    """
    coefficients = (
        (4.937e-4, -2.59e-5, 9.11e-7, -1.50e-8) if temperature_c <= 20.0 else (3.964e-4, -1.146e-5, 1.45e-7, -6.5e-10)
    )
    per_km = np.polynomial.polynomial.polyval(temperature_c, coefficients) * frequency_khz**2
    return float(per_km) * 1e-3


def sound_speed_mps(temperature_c: float) -> float:
    """Speed of sound in pure water at atmospheric pressure, 0 to 95 degrees: Marczak 1997."""
    coefficients = (1402.385, 5.038813, -5.799136e-2, 3.287156e-4, -1.398845e-6, 2.787860e-9)
    return float(np.polynomial.polynomial.polyval(temperature_c, coefficients))
