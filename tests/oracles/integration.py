"""Runge and Kutta's classical step, and what the published models have in common (Fossen 2021)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Array = np.ndarray


def integrated(derivative: Callable[[Array], Array], state: Array, seconds: float, dt_s: float = 0.01) -> Array:
    """(steps + 1, n) states from `state` (n,) on, each dt_s after the one before."""
    states = np.empty((round(seconds / dt_s) + 1, len(state)))
    states[0] = state
    for k in range(len(states) - 1):
        x = states[k]
        first = derivative(x)
        second = derivative(x + 0.5 * dt_s * first)
        third = derivative(x + 0.5 * dt_s * second)
        fourth = derivative(x + dt_s * third)
        states[k + 1] = x + dt_s / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    return states


def cross_matrix(a: Array) -> Array:
    """S(a) with S(a) b = a x b (eq 2.12)."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def moved_by(r: Array) -> Array:
    """H(r): velocities at a point r off, of velocities at the origin (eq 3.30)."""
    moved = np.eye(6)
    moved[:3, 3:] = cross_matrix(r).T
    return moved


def coriolis(mass: Array, nu: Array) -> Array:
    """C(nu) of a symmetric (6, 6) mass matrix (theorem 3.2)."""
    momentum = mass @ nu
    matrix = np.zeros((6, 6))
    matrix[:3, 3:] = matrix[3:, :3] = -cross_matrix(momentum[:3])
    matrix[3:, 3:] = -cross_matrix(momentum[3:])
    return matrix


def rotation(euler_rad: Array) -> Array:
    """R_zyx: body to NED (eq 2.31)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler_rad), np.sin(euler_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def euler_rates(euler_rad: Array, gyro_radps: Array) -> Array:
    """Of the zyx angles (eq 2.39)."""
    (cr, cp, _), (sr, sp, _) = np.cos(euler_rad), np.sin(euler_rad)
    p, q, r = gyro_radps
    turning = sr * q + cr * r
    return np.array([p + turning * sp / cp, cr * q - sr * r, turning / cp])
