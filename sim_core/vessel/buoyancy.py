"""Buoyancy of two round demi-hulls, strip by strip, on the local surface of the water.

Pressure on a circular section points at the section's centre, so each strip's lift acts on the hull's axis whatever
the roll; what it amounts to depends on the depth of that axis alone. Along the hull it acts at the centre of buoyancy,
taken at the draft of rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.environment.waves import HullSurface
from sim_core.frames import Array
from sim_core.vessel.spec import Hull, VesselSpec


def segment_area_m2(submerged_m: Array, radius_m: float) -> Array:
    """Area below the surface of a circle whose lowest point is `submerged_m` deep; 0 when dry, pi r^2 when under.

    r^2 acos((r - h) / r) - (r - h) sqrt(2 r h - h^2)
    """
    cosine = np.clip((radius_m - submerged_m) / radius_m, -1.0, 1.0)
    area: Array = radius_m * radius_m * _unit_segment(cosine)
    return area


def _unit_segment(cosine: Array) -> Array:
    """Segment of the unit circle whose half angle has this cosine."""
    area: Array = np.arccos(cosine)
    area -= cosine * np.sqrt(1.0 - cosine * cosine)
    return area


def _centroid_below_axis_m(submerged_m: Array, radius_m: float) -> Array:
    """Depth of the segment's centroid below the centre of the circle: 2/3 (half width)^3 / area."""
    half_width = np.sqrt(submerged_m * (2.0 * radius_m - submerged_m))
    below: Array = (2.0 / 3.0) * half_width**3 / segment_area_m2(submerged_m, radius_m)
    return below


def strip_axes_frd_m(hull: Hull) -> Array:
    """(2 strips, 3) middle of each strip's axis: port hull from stern to bow, then starboard."""
    along = hull.length_m * ((np.arange(hull.strips) + 0.5) / hull.strips - 0.5)
    depth_m = hull.keel_below_cg_m - hull.radius_m
    sides = [np.column_stack([along, np.full(hull.strips, y), np.full(hull.strips, depth_m)]) for y in (-1.0, 1.0)]
    axes: Array = np.concatenate(sides) * np.array([1.0, hull.centreline_m, 1.0])
    return axes


def floating_draft_m(model: VesselSpec, water: Water) -> float:
    """Depth of the keel at rest. Raises ValueError when the hulls cannot carry the vessel."""
    assert model.hull is not None
    kg_per_m2 = 2.0 * water.density_kgpm3 * model.hull.length_m
    carried = model.mass_kg / kg_per_m2
    low, high = 0.0, 2.0 * model.hull.radius_m
    if carried >= math.pi * model.hull.radius_m**2:
        raise ValueError(
            f"vehicle.mass_kg = {model.mass_kg} sinks its hulls, which displace "
            f"{kg_per_m2 * math.pi * model.hull.radius_m**2:.1f} kg when submerged"
        )
    for _ in range(60):  # bisection to rounding
        middle = 0.5 * (low + high)
        if segment_area_m2(np.array([middle]), model.hull.radius_m)[0] < carried:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@dataclass(frozen=True, slots=True, eq=False)
class Buoyancy:
    """Constants of one vessel in one water. S strips in all."""

    axes_frd_m: Array  # (S, 3)
    level_m: float
    minus_axes_in_radii: Array  # (3, S)
    per_radius: float
    lift_n: Array  # (S, 4): lift per unit segment, and its moments about the axes
    wrench: Array  # (12, 6): (lift, lift x position) times the direction of the lift

    @classmethod
    def from_spec(cls, model: VesselSpec, water: Water) -> Buoyancy:
        """Constants from the vessel's hull and the water."""
        hull = model.hull
        assert hull is not None
        axes = strip_axes_frd_m(hull)
        strip_n = water.density_kgpm3 * GRAVITY_MPS2 * hull.length_m / hull.strips * hull.radius_m**2
        draft = np.array([floating_draft_m(model, water)])
        wrench = np.zeros((4, 3, 6))
        wrench[0, (0, 1, 2), (0, 1, 2)] = 1.0
        for i, j, k, sign in ((0, 1, 2, 1), (1, 2, 0, 1), (2, 0, 1, 1), (0, 2, 1, -1), (2, 1, 0, -1), (1, 0, 2, -1)):
            wrench[1 + i, j, 3 + k] = sign  # position x force
        wrench[0, 0, 4] = _centroid_below_axis_m(draft, hull.radius_m)[0]
        return cls(
            axes_frd_m=axes,
            level_m=water.level_m,
            minus_axes_in_radii=-axes.T / hull.radius_m,
            per_radius=1.0 / hull.radius_m,
            lift_n=strip_n * np.column_stack([np.ones(len(axes)), axes]),
            wrench=wrench.reshape(12, 6),
        )

    def terms(self, pos_ned_m: Array, down_frd: Array, up_frd: Array, surface: HullSurface) -> tuple[Array]:
        """(N, 12) what the force is linear in, for vessels at (N, 3).

        down_frd: (N, 3) the vertical in the body; up_frd: (N, 3) where the lift points.
        """
        cosine = down_frd @ self.minus_axes_in_radii
        cosine -= (surface.point_elevation_m + (pos_ned_m[:, 2:] + self.level_m)) * self.per_radius
        np.maximum(cosine, -1.0, out=cosine)
        np.minimum(cosine, 1.0, out=cosine)
        lift = _unit_segment(cosine) @ self.lift_n
        return ((lift[:, :, None] * up_frd[:, None, :]).reshape(-1, 12),)
