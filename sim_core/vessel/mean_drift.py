"""Mean force of the waves on a hull, of second order in their height, always in their direction; docs/seas.md.

At rest, the force is that of a table over frequency and direction: that of a panel code, or, without one, that of the
reflected waves. Maruo (1960) derived the force rho g a_R^2 / 2 per metre of wall, and Faltinsen et al. (1980)
integrated it along a waterline of any shape:

    rho g a^2 / 2  alpha  integral (e . n)^2 (-n) dl

over the part that faces the waves, with its outward normal n and the wave direction e. alpha = (a_R / a)^2 is that of a
vertical barrier as deep as the hull (Ursell 1947; Fujii and Takahashi 1975).

Under way, the hull takes more power P out of the waves, and with it their momentum, P k / omega (Gerritsma and
Beukelman 1972), and it meets more of the reflected waves.
"""

from __future__ import annotations

import math

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2
from sim_core.environment.waves import FeltWaves, HullSurface, WaveField
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.vessel.panel_tables import at_frequencies
from sim_core.vessel.spec import Damping, DemiHull, VesselSpec


@dataclass(frozen=True, slots=True)
class NoDrift:
    """No mean force, in flat water."""

    def force_frd_n(self, motion: Kinematics, water_ned_mps: Array, surface: HullSurface) -> Array:
        """Return zeros (N, 2)."""
        return np.zeros((len(motion.pos_ned_m), 2))


@dataclass(frozen=True, slots=True, eq=False)
class DriftTable:
    """Mean force at rest per square metre of amplitude, for K frequencies and D directions of the waves."""

    omega_radps: Array
    """Frequencies, rising, (K,)."""
    direction_rad: Array
    """Directions that the waves travel to, clockwise from the bow, in equal steps from 0, (D,)."""
    force_frd_n: Array
    """Force forward and right, (K, D, 2)."""
    power_w: Array
    """Power that linear damping takes out of the waves, (K, D)."""


@dataclass(frozen=True, slots=True, eq=False)
class MeanDrift:
    """Constants of one vessel in one sea.

    The force follows the height of the waves at the hull, so it varies slowly with their groups (Newman 1974).
    """

    linear: Array  # (3,) damping in heave, roll and pitch
    quadratic: Array  # (3,)
    along_ned: Array  # (3,) k / omega of the sea along its waves
    harmonics: Array  # (M,) of the heading
    of_cosines: Array  # (M, 3): force forward and right, and power, per mean square of the elevation
    of_sines: Array  # (M, 3)

    @classmethod
    def from_table(
        cls, table: DriftTable, waves: WaveField, felt: FeltWaves, linear_damping: Array, quadratic: Damping
    ) -> MeanDrift:
        """Compute the constants. linear_damping: (6, 6)."""
        energy = waves.amplitude_m**2
        of_points = 0.5 * float((energy * felt.vertical**2).sum())  # mean square of what the points feel
        course = np.arctan2(waves.wave_vector_radpm[:, 1], waves.wave_vector_radpm[:, 0])
        values = np.concatenate([table.force_frd_n, table.power_w[:, :, None]], axis=2)
        values = at_frequencies(waves.omega_radps, table.omega_radps, values)
        # Series in the direction of the waves off the bow, and its sum over the components at heading 0
        count = len(table.direction_rad)
        series = np.fft.rfft(values, axis=1) * (2.0 / count)
        series[:, 0] *= 0.5
        series[:, -1] *= 0.5 if count % 2 == 0 else 1.0
        harmonics = np.arange(series.shape[1], dtype=float)
        total = np.einsum("w,wm,wmi->mi", energy / of_points, np.exp(1j * course[:, None] * harmonics), series)
        along = np.zeros(3)
        along[:2] = energy @ (waves.wave_vector_radpm / waves.omega_radps[:, None]) / energy.sum()
        return cls(
            linear=np.diag(linear_damping)[2:5].copy(),
            quadratic=np.array([quadratic.heave, quadratic.roll, quadratic.pitch]),
            along_ned=along,
            harmonics=harmonics,
            of_cosines=total.real.copy(),
            of_sines=total.imag.copy(),
        )

    def force_frd_n(self, motion: Kinematics, water_ned_mps: Array, surface: HullSurface) -> Array:
        """Return the (N, 2) force forward and right on N vessels in water that moves at (N, 3)."""
        # At rest: the table, at this heading and for the waves at the hull now
        points, rot = surface.point_elevation_m, motion.rot_ned_frd
        square_m2 = np.vecdot(points, points) / points.shape[1]
        angle = np.arctan2(rot[:, 1, 0], rot[:, 0, 0])[:, None] * self.harmonics
        at_rest = np.cos(angle) @ self.of_cosines
        at_rest += np.sin(angle) @ self.of_sines
        at_rest *= square_m2[:, None]
        # Under way: the power beyond that at rest, and shorter waves of encounter
        relative_ned_mps = motion.vel_ned_mps - water_ned_mps
        speed = np.empty_like(relative_ned_mps)
        speed[:, 0] = relative_ned_mps[:, 2]
        np.subtract(motion.gyro_frd_radps[:, :2], surface.turn_frd_radps[:, :2], out=speed[:, 1:])
        square = speed * speed
        power_w = square @ self.linear + (square * np.abs(speed)) @ self.quadratic
        headway = relative_ned_mps @ self.along_ned  # relative to the speed of the waves
        excess = (power_w - at_rest[:, 2]) / np.maximum(1.0 - headway, 1.0)
        along = self.along_ned @ rot
        force: Array = at_rest[:, :2] * np.maximum(1.0 - 2.0 * headway, 0.0)[:, None]
        force += excess[:, None] * along[:, :2]
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


def wall_m(hull: DemiHull, width_m: float, direction_rad: Array) -> Array:
    """Return the (D, 2) walls, forward and right, to which a waterline is equal in waves from D directions.

    It is the integral of (e . n)^2 (-n) over the part that faces the waves. A wall of length l across the waves gives
    l, a round end of width b gives 2/3 b.
    """
    place, share = np.array(hull.taper).T
    x, half = place * hull.length_m, 0.5 * share * width_m
    dx, dy = np.diff(x), np.diff(half)
    length = np.concatenate([np.hypot(dx, dy), np.hypot(dx, dy), [2.0 * half[0], 2.0 * half[-1]]])
    normal = np.stack([-dy, dx], axis=1) / np.hypot(dx, dy)[:, None]
    normal = np.concatenate([normal, normal * [1.0, -1.0], [[-1.0, 0.0], [1.0, 0.0]]])
    course = np.stack([np.cos(direction_rad), np.sin(direction_rad)], axis=1)
    met = np.minimum(course @ normal.T, 0.0) ** 2
    walls: Array = -(met * length) @ normal
    return walls


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


def closed_form_drift(
    model: VesselSpec, depth_m: float, weight_npm3: float, omega_radps: Array, direction_rad: Array
) -> Array:
    """Return the (K, D, 2) mean force per square metre of amplitude on a vessel at rest, by reflection at barriers.

    depth_m: depth of the body's origin at rest. weight_npm3: rho g of the water. Of the waves from abeam, each hull
    transmits what it does not reflect. The force is never more than that of total reflection.
    """
    wave_number = omega_radps**2 / GRAVITY_MPS2
    force = np.zeros((len(omega_radps), len(direction_rad), 2))
    reflected, passed = np.zeros(len(omega_radps)), np.ones(len(omega_radps))
    for hull in model.demi_hulls:
        draft_m = max(hull.keel_frd_m[2] + depth_m, 0.0)
        share = barrier_reflection(wave_number, draft_m)
        force = force + share[:, None, None] * wall_m(hull, waterline_width_m(hull, draft_m), direction_rad)
        reflected, passed = reflected + share, passed * (1.0 - share)
    # In the lee of other hulls
    together = (1.0 - passed) / np.maximum(reflected, 1e-300)
    abeam = np.sin(direction_rad) ** 2
    total: Array = 0.5 * weight_npm3 * force * (1.0 - abeam + abeam * together[:, None])[:, :, None]
    return total
