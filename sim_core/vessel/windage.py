"""Force of the wind (Fossen 2021, eq 10.16-10.18), with the velocity (u, v) of the vessel relative to the air, speed V:

    X = -1/2 rho c_x A_front u V,   Y = -1/2 rho c_y A_lateral v V,   N = -rho c_n A_lateral L u v

This is C_X = -c_x cos(gamma), C_Y = c_y sin(gamma), C_N = c_n sin(2 gamma), without computing an angle. The force acts
at the height of the areas' centre and causes heel and trim moments: K = -z Y, M = z X.
"""

from __future__ import annotations

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.vessel.spec import VesselSpec

AIR_DENSITY_KGPM3 = 1.2  # 20 degC at sea level


@dataclass(frozen=True, slots=True, eq=False)
class WindDrag:
    """Constants of one vessel."""

    wrench: Array  # (3, 6)

    @classmethod
    def from_spec(cls, model: VesselSpec, waterline_down_m: float) -> WindDrag:
        """Compute the constants from the vessel's windage. waterline_down_m: water level below the body's origin."""
        wind = model.wind
        down_m = waterline_down_m - wind.centre_height_m
        drag = 0.5 * AIR_DENSITY_KGPM3 * wind.surge_coefficient * wind.frontal_area_m2
        side = 0.5 * AIR_DENSITY_KGPM3 * wind.sway_coefficient * wind.lateral_area_m2
        wrench = np.zeros((3, 6))
        wrench[0, (0, 4)] = -drag, -drag * down_m
        wrench[1, (1, 3)] = -side, side * down_m
        wrench[2, 5] = -AIR_DENSITY_KGPM3 * wind.yaw_coefficient * wind.lateral_area_m2 * wind.length_m
        return cls(wrench)

    def terms(self, relative_frd_mps: Array) -> tuple[Array, Array]:
        """Return (N, 2), (N, 1): u V and v V, and u v, for (N, 3) velocities of the vessel relative to the air."""
        along = relative_frd_mps[:, :2]
        speed = np.sqrt(np.vecdot(along, along))
        return along * speed[:, None], along[:, :1] * along[:, 1:]
