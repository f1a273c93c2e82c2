"""Forces of the waves on a hull: to first order in their slope, and their mean.

The displaced mass slides down the slope of the surface with g. So does the added mass of the water, which also rises
and turns with the surface. The lift of the strips stays vertical. The model omits products of two wave motions, which
would push a free vessel against the waves. `mean_drift` gives the mean force. docs/seas.md has the equations.
"""

from __future__ import annotations

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2
from sim_core.environment.waves import HullSurface, StillHull
from sim_core.frames import Array
from sim_core.vessel.buoyancy import Buoyancy
from sim_core.vessel.hydrodynamics import Hydrodynamics
from sim_core.vessel.mean_drift import MeanDrift, NoDrift


@dataclass(frozen=True, slots=True, eq=False)
class WaveForces:
    """Constants of one vessel in one sea."""

    wrench: Array  # (14, 6), or (20, 6) with forces of a panel code
    drift: MeanDrift | NoDrift
    panel: bool
    """Whether the surface brings forces of a panel code."""

    @classmethod
    def from_parts(
        cls, hydrodynamics: Hydrodynamics, buoyancy: Buoyancy, depth_m: float, drift: MeanDrift | NoDrift, panel: bool
    ) -> WaveForces:
        """Compute the constants. depth_m: depth of the body's origin at rest below the still surface."""
        mass = hydrodynamics.added_mass.T  # rows: the force of one acceleration
        # Force and moment of the lift at rest, as if it acted along x, y or z of the body
        surface = StillHull(len(buoyancy.points_frd_m)).sample(0.0, np.zeros((3, 3)), np.zeros((3, 3, 3)))
        pos_ned_m = np.tile([0.0, 0.0, depth_m - buoyancy.level_m], (3, 1))
        (terms,) = buoyancy.terms(pos_ned_m, np.tile([0.0, 0.0, 1.0], (3, 1)), np.eye(3), surface)
        slide = -(terms @ buoyancy.wrench) - GRAVITY_MPS2 * mass[:3]
        # Heave damping acts along the vertical at any tilt of the body. The momentum of the water that heaves with the
        # hull turns with the body alone, not with the water.
        upright = np.zeros((4, 6))
        upright[0, 0] = upright[1, 1] = -hydrodynamics.linear_damping[2, 2]
        upright[2, 1], upright[3, 0] = mass[2, 2], -mass[2, 2]
        at_surface = np.array([[1.0, 0.0, 0.0, 0.0, -depth_m, 0.0], [0.0, 1.0, 0.0, depth_m, 0.0, 0.0]])
        wrench = np.concatenate([slide, -mass[:3], mass[3:5], upright, at_surface])
        return cls(np.concatenate([wrench, np.eye(6)]) if panel else wrench, drift, panel)

    def terms(
        self, heave_mps: Array, down_frd: Array, gradient_frd: Array, surface: HullSurface, drift_frd_n: Array
    ) -> tuple[Array, ...]:
        """Return the linear terms of the forces: (N, 3), (N, 3), (N, 2), (N, 2), (N, 2), (N, 2), and (N, 6) of a panel
        code.

        heave_mps: (N, 1) vertical velocity of the vessel relative to the water, down positive. down_frd: (N, 3)
        vertical in body axes. gradient_frd: (N, 3) slope of the surface along the body's axes. drift_frd_n: (N, 2)
        force from `drift`.
        """
        return (
            gradient_frd,
            surface.rise_mps2 * down_frd,
            surface.turn_radps2,
            heave_mps * down_frd[:, :2],
            heave_mps * surface.turn_frd_radps[:, :2],
            drift_frd_n,
            *((surface.panel_wrench_frd,) if self.panel else ()),
        )


@dataclass(frozen=True, slots=True, eq=False)
class NoWaveForces:
    """No wave forces, in flat water."""

    wrench: Array
    drift: NoDrift

    def terms(
        self, heave_mps: Array, down_frd: Array, gradient_frd: Array, surface: HullSurface, drift_frd_n: Array
    ) -> tuple[Array, ...]:
        """Return no terms."""
        return ()


FLAT = NoWaveForces(np.zeros((0, 6)), NoDrift())
