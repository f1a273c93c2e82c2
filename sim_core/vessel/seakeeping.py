"""The linear response of a vessel to waves, and what the strips leave out of it.

The equations of small motions and the forces of the waves are taken from the simulation itself, by differences: with
the states x = (pose, velocity) about rest, and waves of amplitude a and frequency omega from one direction,

    pose'' = J_x pose + J_v pose' + w a      pose = X a exp(-i omega t)

With tables of a panel code, the response X is that of the tables. The acceleration that the strips leave out is

    d = (-omega^2 + i omega J_v - J_x) X - w

It is written as a sum over the points of the hull, d = sum c_s exp(i k . r_s), so that it holds on any heading. The
motion of a free vessel at rest in waves is then that of the tables, at any frequency. docs/seas.md has the details.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import complex128

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2
from sim_core.environment.waves import FeltWaves, WaveField
from sim_core.frames import Array, ComplexArray
from sim_core.vessel.mean_drift import DriftTable
from sim_core.vessel.panel_tables import PanelTables, at_frequencies, smooth_at_frequencies

DIRECTIONS = 36
_POSE, _RATES = 3, 6
_FIT = 1e-3
"""Weight of the size of the sources in their fit, which keeps them small where the waves are long."""


@dataclass(frozen=True, slots=True, eq=False)
class SmallWaves:
    """What waves of one metre of amplitude do to the vessel held at rest, for D directions of the waves."""

    acceleration: ComplexArray
    """(D, 6), complex: force over mass, in body axes."""
    water: ComplexArray
    """Speeds of the water in heave, roll and pitch as the hull feels them, (D, 3), complex."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearResponse:
    """K frequencies and D directions of the waves."""

    omega_radps: Array
    """(K,)."""
    direction_rad: Array
    """Directions that the waves travel to, clockwise from the bow, in equal steps from 0, (D,)."""
    motion: ComplexArray
    """Displacements of the origin and turns per metre of amplitude, (K, D, 6), complex."""
    relative: ComplexArray
    """Speeds in heave, roll and pitch relative to the water, (K, D, 3), complex."""
    missing: ComplexArray
    """Accelerations that the strips leave out, (K, D, 6), complex; 0 without tables."""


def linear_response(
    omega_radps: Array,
    direction_rad: Array,
    small_motions: Array,
    waves: Sequence[SmallWaves],
    mass: Array,
    rigid_mass: Array,
    tables: PanelTables | None = None,
) -> LinearResponse:
    """Return the response of a vessel at rest.

    small_motions: the (9, 9) matrix of `step_length`. waves: those of each frequency. mass: (6, 6),
    with added mass. rigid_mass: without. With tables, the frequencies and directions are those of the tables.
    """
    stiffness, damping = np.zeros((6, 6)), small_motions[_POSE:, _POSE:]
    stiffness[:, 2:5] = small_motions[_POSE:, :_POSE]
    acceleration, water = np.stack([part.acceleration for part in waves]), np.stack([part.water for part in waves])
    w = omega_radps[:, None, None]
    impedance = (1j * w * damping - w**2 * np.eye(6) - stiffness).astype(complex128)
    missing: ComplexArray = np.zeros_like(acceleration)
    if tables is None:
        motion = np.linalg.solve(impedance[:, None], acceleration[..., None])[..., 0].astype(complex128)
    else:
        restoring = np.zeros((6, 6))
        restoring[2:5, 2:5] = tables.stiffness
        damped = tables.radiation_damping.copy()
        damped[:, 3, 3] += tables.roll_friction
        of_tables = -(w**2) * (rigid_mass + tables.added_mass) - 1j * w * damped + restoring
        motion = np.linalg.solve(of_tables[:, None], tables.excitation[..., None])[..., 0].astype(complex128)
        missing = (impedance[:, None] @ motion[..., None])[..., 0] - acceleration
    relative: ComplexArray = -1j * w * motion[..., 2:5] - water
    return LinearResponse(omega_radps, direction_rad, motion, relative, missing)


@dataclass(frozen=True, slots=True, eq=False)
class Seakeeping:
    """Response of one vessel to waves, at K frequencies."""

    omega_radps: Array
    """(K,)."""
    vertical: Array
    """See `FeltWaves`, (K,)."""
    horizontal: Array
    """(K,)."""
    source_radps: Array
    """Frequencies of the sources, (F,)."""
    sources: ComplexArray | None
    """(F, S + E, 6), complex; None without tables of a panel code."""
    more_points_frd_m: Array
    """Points of sources besides the points of the hull, (E, 3)."""
    drift: DriftTable
    response: LinearResponse

    def felt(self, waves: WaveField) -> FeltWaves:
        """Return how the hull feels a sea."""
        sources = self.sources
        if sources is not None:
            sources = smooth_at_frequencies(waves.omega_radps, self.source_radps, sources)
        shares = np.stack([self.vertical, self.horizontal], axis=1)
        vertical, horizontal = at_frequencies(waves.omega_radps, self.omega_radps, shares).T
        return FeltWaves(vertical, horizontal, sources, self.more_points_frd_m)


def more_points(midship_frd_x_m: float, length_m: float, width_m: float) -> Array:
    """Return (6, 3) points for sources off the hulls.

    Sources on two hulls that are a wave apart make no moment or side force in beam seas.
    """
    places = [(x * length_m, y * width_m, 0.0) for x in (-0.35, 0.0, 0.35) for y in (-0.25, 0.25)]
    points: Array = np.array(places) + np.array([midship_frd_x_m, 0.0, 0.0])
    return points


def between(omega_radps: Array) -> Array:
    """Return frequencies with four steps between neighbours. Sources change faster with the frequency than forces."""
    count = len(omega_radps)
    finer: Array = np.interp(np.arange(4 * count - 3) / 4.0, np.arange(count), omega_radps)
    return finer


def point_sources(response: LinearResponse, omega_radps: Array, points_frd_m: Array) -> ComplexArray:
    """Return the (F, P, 6) complex sources c with sum_s c_s exp(i k . r_s) = missing, by least squares."""
    wave_number = omega_radps**2 / GRAVITY_MPS2
    missing = smooth_at_frequencies(omega_radps, response.omega_radps, response.missing)
    course = np.stack([np.cos(response.direction_rad), np.sin(response.direction_rad)], axis=1)
    waves = np.exp(1j * wave_number[:, None, None] * (course @ points_frd_m[:, :2].T))
    adjoint = waves.conj().swapaxes(1, 2)
    points = len(points_frd_m)
    damped = adjoint @ waves + _FIT**2 * len(course) * np.eye(points)
    sources: ComplexArray = np.linalg.solve(damped, adjoint @ missing)
    return sources
