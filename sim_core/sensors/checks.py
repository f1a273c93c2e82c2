"""What a sensor's configuration may hold; each check raises a ValueError that names the field and the fix."""

from __future__ import annotations

import math


def require_positive(sensor: str, **fields: float) -> None:
    """Every field is finite and above zero (rates, correlation times, ranges)."""
    for name, value in fields.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{sensor}.{name} = {value} must be a finite number above zero; give a positive value")


def require_non_negative(sensor: str, **fields: float) -> None:
    """Every field is finite and not below zero (densities, deviations, resolutions, delays)."""
    for name, value in fields.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(
                f"{sensor}.{name} = {value} must be a finite number, zero or above; give 0 to switch it off"
            )


def require_vector(sensor: str, **fields: tuple[float, float, float]) -> None:
    """Every field is three finite numbers."""
    for name, value in fields.items():
        if len(value) != 3 or not all(math.isfinite(component) for component in value):
            raise ValueError(f"{sensor}.{name} = {value} must be three finite numbers; give [x, y, z]")


def require_finite(sensor: str, **fields: float) -> None:
    """Every field is a finite number."""
    for name, value in fields.items():
        if not math.isfinite(value):
            raise ValueError(f"{sensor}.{name} = {value} must be a finite number; give a plain decimal value")
