"""Force of the wind, from the velocity of the vessel relative to the air, both in the body frame.

Fossen 2021, eq 10.16-10.18: with relative velocity (u, v) and speed V,

    X = -1/2 rho c_x A_front u V,   Y = -1/2 rho c_y A_lateral v V,   N = -rho c_n A_lateral L u v

that is C_X = -c_x cos(gamma), C_Y = c_y sin(gamma), C_N = c_n sin(2 gamma) without an angle being computed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.vessel.model import VesselModel

Array = NDArray[float64]

AIR_DENSITY_KGPM3 = 1.2  # 20 degC at sea level


@dataclass(frozen=True, slots=True, eq=False)
class WindDrag:
    """Constants of one vessel."""

    wrench: Array  # (3, 6)

    @classmethod
    def of(cls, model: VesselModel) -> WindDrag:
        """Constants from the vessel's windage."""
        wind = model.wind
        wrench = np.zeros((3, 6))
        wrench[0, 0] = -0.5 * AIR_DENSITY_KGPM3 * wind.surge_coefficient * wind.frontal_area_m2
        wrench[1, 1] = -0.5 * AIR_DENSITY_KGPM3 * wind.sway_coefficient * wind.lateral_area_m2
        wrench[2, 5] = -AIR_DENSITY_KGPM3 * wind.yaw_coefficient * wind.lateral_area_m2 * wind.length_m
        return cls(wrench)

    def terms(self, relative_frd_mps: Array) -> tuple[Array, Array]:
        """(N, 2), (N, 1): u V and v V, and u v, for (N, 3) velocities of the vessel relative to the air."""
        along = relative_frd_mps[:, :2]
        speed = np.sqrt(np.vecdot(along, along))
        return along * speed[:, None], along[:, :1] * along[:, 1:]
