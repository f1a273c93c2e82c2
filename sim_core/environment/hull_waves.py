"""Waves as a hull feels them: one pass over all strips of all vessels.

A hull of S points and a sea of W components need N S W cosines a step. The phase at each vessel's origin is reduced
to one turn in double precision; what a point's lever adds, a few radians, is one product of the attitude with a
constant matrix; the cosines are then taken in single precision, which costs 1e-6 of the wave's amplitude and a
twentieth of the time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import float32, float64
from numpy.typing import NDArray

Array = NDArray[float64]
Array32 = NDArray[float32]


@dataclass(frozen=True, slots=True, eq=False)
class HullSurface:
    """The surface at N hulls of S points.

    elevation_m: (N,) at the vessel's origin, and point_elevation_m: (N, S), up positive over the still level.
    orbital_ned_mps: (N, 3) velocity of the water, horizontally the mean over the hull.
    slope_frd: (N, 3) gradient of the plane fitted to the points along forward and right, third component 0.
    rise_mps2: (N, 1) vertical acceleration of the surface, up positive, the mean over the hull.
    """

    elevation_m: Array
    point_elevation_m: Array
    orbital_ned_mps: Array
    slope_frd: Array
    rise_mps2: Array


@dataclass(frozen=True, slots=True)
class StillHull:
    """Sampler of flat water for hulls of `points` points."""

    points: int

    def sample(self, time_s: float, pos_ned_m: Array, rot_ned_frd: Array) -> HullSurface:
        """All zero."""
        vessels = len(pos_ned_m)
        zero = np.zeros((vessels, 3))
        return HullSurface(np.zeros(vessels), np.zeros((vessels, self.points)), zero, zero, np.zeros((vessels, 1)))


@dataclass(frozen=True, slots=True, eq=False)
class HullWaves:
    """Sampler of a wave field for hulls of S points; made by `bind`, which explains the arrays."""

    turns_per_m: Array  # (2, W)
    turns_per_s: Array  # (W,)
    turns: Array  # (W,)
    lever: Array32  # (6, (1 + S) W), the origin first
    at_point: Array32  # (W, 4): elevation, vertical acceleration, orbital north, orbital east
    over_hull: Array32  # (4 (1 + S), 8)
    at_origin: Array32  # (W, 8)

    @classmethod
    def bind(
        cls,
        amplitude_m: Array,
        omega_radps: Array,
        wave_vector_radpm: Array,
        phase_rad: Array,
        drift_mps: Array,
        points_frd_m: Array,
    ) -> HullWaves:
        """Constants of `sample`; its eight columns: orbital velocity (3), slope (3), vertical acceleration, elevation.

        amplitude, omega, phase: (W,); wave vectors and drift (amplitude of the horizontal velocity): (W, 2) north,
        east; points: (S, 3).
        """
        components, points = len(amplitude_m), len(points_frd_m)
        origin_too = np.concatenate([np.zeros((1, 3)), points_frd_m])
        lever = np.einsum("wi,sj->ijsw", wave_vector_radpm, origin_too).reshape(6, -1)
        at_point = np.column_stack([amplitude_m, -amplitude_m * omega_radps**2, drift_mps])
        over_hull = np.zeros((1 + points, 4, 8))
        over_hull[1:, 2, 0] = over_hull[1:, 3, 1] = over_hull[1:, 1, 6] = 1.0 / points
        # Least-squares plane through the points' elevations: rows 1 and 2 of the pseudo-inverse are its slopes.
        over_hull[1:, 0, 3:5] = np.linalg.pinv(np.column_stack([np.ones(points), points_frd_m[:, :2]]))[1:].T
        over_hull[0, 0, 7] = 1.0
        at_origin = np.zeros((components, 8))
        at_origin[:, 2] = -amplitude_m * omega_radps  # of sin theta: the surface rises, down is positive
        turn = 2.0 * math.pi
        return cls(
            turns_per_m=wave_vector_radpm.T / turn,
            turns_per_s=omega_radps / turn,
            turns=phase_rad / turn,
            lever=lever.astype(float32),
            at_point=at_point.astype(float32),
            over_hull=over_hull.reshape(-1, 8).astype(float32),
            at_origin=at_origin.astype(float32),
        )

    def sample(self, time_s: float, pos_ned_m: Array, rot_ned_frd: Array) -> HullSurface:
        """The surface at time_s under N vessels at (N, 3) positions with (N, 3, 3) attitudes."""
        vessels, components = len(pos_ned_m), len(self.turns)
        phase = self._phase_at_origin(time_s, pos_ned_m)
        lever = rot_ned_frd.reshape(vessels, 9)[:, :6].astype(float32) @ self.lever
        wave = lever.reshape(vessels, -1, components)
        wave += phase[:, None, :]
        np.cos(wave, out=wave)
        point = wave @ self.at_point
        summed = point.reshape(vessels, -1) @ self.over_hull
        summed += np.sin(phase) @ self.at_origin
        hull = summed.astype(float64)
        return HullSurface(hull[:, 7], point[:, 1:, 0].astype(float64), hull[:, :3], hull[:, 3:6], hull[:, 6:7])

    def _phase_at_origin(self, time_s: float, pos_ned_m: Array) -> Array32:
        """(N, W) theta in (-pi, pi]."""
        turns = pos_ned_m[:, :2] @ self.turns_per_m
        turns += self.turns - self.turns_per_s * time_s
        turns -= np.rint(turns)
        turns *= 2.0 * math.pi
        return turns.astype(float32)
