"""The water body: density, level and depth."""

from __future__ import annotations

import math
from dataclasses import dataclass

GRAVITY_MPS2 = 9.80665  # standard gravity; weight and buoyancy use the same, so floatation does not depend on it


@dataclass(frozen=True, slots=True)
class Water:
    """Still water. `level_m` is the height (up positive) of its surface above the origin of the local NED frame."""

    density_kgpm3: float = 997.8
    level_m: float = 0.0
    depth_m: float = 20.0

    def __post_init__(self) -> None:
        for name, value in (("density_kgpm3", self.density_kgpm3), ("depth_m", self.depth_m)):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"water.{name} = {value} must be a positive number")
        if not math.isfinite(self.level_m):
            raise ValueError(f"water.level_m = {self.level_m} must be a number")
