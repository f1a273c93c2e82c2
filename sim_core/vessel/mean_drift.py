"""Mean force of the waves on a hull, of second order in their height, always in their direction; docs/seas.md.

The force has two parts, as in the methods for added resistance (ITTC 7.5-02-07-02.8). A hull that moves relative to the
water takes power P out of the waves, and with it their momentum, P k / omega (Gerritsma and Beukelman 1972; Maruo's
formula for radiated waves). Its sides and ends reflect short waves. Maruo (1960) derived the force rho g a_R^2 / 2 per
metre of wall, and Faltinsen et al. (1980) integrated it along a waterline of any shape:

    rho g a^2 / 2  alpha  integral (e . n)^2 (-n) dl

over the part that faces the waves, with its outward normal n and the wave direction e. alpha = (a_R / a)^2 for the ends
is that of a vertical barrier as deep as the hull (Ursell 1947; Fujii and Takahashi 1975). For the sides it is that of a
floating box (Macagno 1954). Each hull transmits the waves that it does not reflect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.environment.waves import HullSurface, WaveField
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.vessel.spec import DemiHull, VesselSpec


@dataclass(frozen=True, slots=True)
class NoDrift:
    """No mean force, in flat water."""

    def force_frd_n(self, motion: Kinematics, water_ned_mps: Array, surface: HullSurface) -> Array:
        """Return zeros (N, 2)."""
        return np.zeros((len(motion.pos_ned_m), 2))


@dataclass(frozen=True, slots=True, eq=False)
class MeanDrift:
    """Constants of one vessel in one sea.

    The force follows the height of the waves at the hull, so it varies slowly with their groups (Newman 1974).
    """

    linear: Array  # (3,) damping in heave, roll and pitch
    quadratic: Array  # (3,)
    along_ned: Array  # (3, 3) rows: k / omega of the sea along its waves; reflection by ends and by sides, in N/m2

    @classmethod
    def from_parts(
        cls, model: VesselSpec, waves: WaveField, water: Water, depth_m: float, linear_damping: Array
    ) -> MeanDrift:
        """Compute the constants. depth_m: depth of the body's origin at rest. linear_damping: (6, 6)."""
        quadratic = model.damping_quadratic
        share = waves.amplitude_m**2 / np.sum(waves.amplitude_m**2)
        wave_number = np.hypot(*waves.wave_vector_radpm.T)
        course = waves.wave_vector_radpm / wave_number[:, None]
        drafts_m = [max(hull.keel_frd_m[2] + depth_m, 0.0) for hull in model.demi_hulls]
        widths_m = [waterline_width_m(hull, draft_m) for hull, draft_m in zip(model.demi_hulls, drafts_m, strict=True)]
        walls_m = np.array([wall_m(hull, width_m) for hull, width_m in zip(model.demi_hulls, widths_m, strict=True)])
        ends = sum(
            along_m * barrier_reflection(wave_number, draft_m)
            for (along_m, _), draft_m in zip(walls_m, drafts_m, strict=True)
        )
        passed = np.prod(
            [
                1.0 - box_reflection(wave_number, width_m, draft_m)
                for width_m, draft_m in zip(widths_m, drafts_m, strict=True)
            ],
            axis=0,
        )
        sides = walls_m[:, 1].max() * (1.0 - passed)
        weight = water.density_kgpm3 * GRAVITY_MPS2
        along = np.zeros((3, 3))
        along[0, :2] = share @ (waves.wave_vector_radpm / waves.omega_radps[:, None])
        along[1, :2] = weight * (share * ends) @ course
        along[2, :2] = weight * (share * sides) @ course
        return cls(
            linear=np.diag(linear_damping)[2:5].copy(),
            quadratic=np.array([quadratic.heave, quadratic.roll, quadratic.pitch]),
            along_ned=along,
        )

    def force_frd_n(self, motion: Kinematics, water_ned_mps: Array, surface: HullSurface) -> Array:
        """Return the (N, 2) force forward and right on N vessels in water that moves at (N, 3)."""
        relative_ned_mps = motion.vel_ned_mps - water_ned_mps
        speed = np.empty_like(relative_ned_mps)
        speed[:, 0] = relative_ned_mps[:, 2]
        np.subtract(motion.gyro_frd_radps[:, :2], surface.turn_frd_radps[:, :2], out=speed[:, 1:])
        square = speed * speed
        power_w = square @ self.linear + (square * np.abs(speed)) @ self.quadratic
        points = surface.point_elevation_m
        square_m2 = np.vecdot(points, points) / points.shape[1]
        headway = relative_ned_mps @ self.along_ned[0]  # relative to the speed of the waves
        along = self.along_ned @ motion.rot_ned_frd
        absorbed = power_w / np.maximum(1.0 - headway, 1.0)
        thrown = square_m2 * np.maximum(1.0 - 2.0 * headway, 0.0)
        force: Array = absorbed[:, None] * along[:, 0, :2]
        force[:, 0] += thrown * along[:, 1, 0]
        force[:, 1] += thrown * along[:, 2, 1]
        return force


def waterline_width_m(hull: DemiHull, draft_m: float) -> float:
    """Return the greatest width of a hull at its waterline."""
    section = hull.section
    if section is None:
        return hull.width_m
    if section.radius_m is not None:
        deep_m = min(draft_m, 2.0 * section.radius_m)
        return 2.0 * math.sqrt(deep_m * (2.0 * section.radius_m - deep_m))
    if section.offsets_m is not None:
        heights_m, halves_m = zip(*section.offsets_m, strict=True)
        return 2.0 * float(np.interp(draft_m, heights_m, halves_m))
    return section.greatest_width_m


def wall_m(hull: DemiHull, width_m: float) -> tuple[float, float]:
    """Return the equivalent wall lengths of a waterline in waves from ahead and from abeam.

    They are the integral of (e . n)^2 (-n) over the part that faces the waves, over all their directions e. The x part
    is its component with the cosine of the direction, the y part its component with the sine. A wall of length l gives
    8 / (3 pi) l, a round end of width b gives 2/3 b.
    """
    place, share = np.array(hull.taper).T
    x, half = place * hull.length_m, 0.5 * share * width_m
    dx, dy = np.diff(x), np.diff(half)
    length = np.concatenate([np.hypot(dx, dy), np.hypot(dx, dy), [2.0 * half[0], 2.0 * half[-1]]])
    normal = np.stack([-dy, dx], axis=1) / np.hypot(dx, dy)[:, None]
    normal = np.concatenate([normal, normal * [1.0, -1.0], [[-1.0, 0.0], [1.0, 0.0]]])
    angle = 2.0 * math.pi * np.arange(180) / 180
    course = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    met = np.minimum(course @ normal.T, 0.0) ** 2
    force = -(met * length) @ normal
    return tuple((2.0 * (force * course).mean(axis=0)).tolist())


def barrier_reflection(wave_number_radpm: Array, draft_m: float) -> Array:
    """Return the share of the energy of deep-water waves that a thin vertical barrier reflects (Ursell 1947).

    pi^2 I1^2 / (pi^2 I1^2 + K1^2) of k T, with the modified Bessel functions as integrals.
    """
    kt = np.minimum(wave_number_radpm * draft_m, 20.0)[:, None]
    angle = (np.arange(128) + 0.5) * (math.pi / 128)
    i1 = (np.exp(kt * np.cos(angle)) * np.cos(angle)).mean(axis=1)
    far = (np.arange(1600) + 0.5) * 0.01
    k1 = (np.exp(-kt * np.cosh(far)) * np.cosh(far)).sum(axis=1) * 0.01
    share: Array = (math.pi * i1) ** 2 / ((math.pi * i1) ** 2 + k1**2)
    return share


def box_reflection(wave_number_radpm: Array, width_m: float, draft_m: float) -> Array:
    """Return the share of the energy of deep-water waves that a fixed floating box reflects (Macagno 1954).

    x^2 / (1 + x^2), x = k b exp(k T) / 2.
    """
    x = 0.5 * wave_number_radpm * width_m * np.exp(np.minimum(wave_number_radpm * draft_m, 20.0))
    share: Array = x * x / (1.0 + x * x)
    return share
