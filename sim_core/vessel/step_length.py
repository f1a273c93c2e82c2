"""Check that the steps of a simulation are short enough for a vessel.

The vessel's small motions about rest, x' = A x, are integrated like `vessel.advance`. The numerical solution must grow
no faster than the motions themselves. A purely decaying motion allows rate x step up to 1 (Adams and Bashforth's second
order). A purely oscillating motion allows omega x step up to 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from sim_core.frames import Array

_POSE, _RATES = 3, 6
_ROUNDING = 1e-6
_OFFSETS = np.array([1e-4] * _POSE + [1e-3] * _RATES)  # m, rad, m/s, rad/s: far below a draft, above rounding


def check_step_length(acceleration: Callable[[Array], Array], dt_s: float) -> None:
    """Raises ValueError if steps of dt_s do not follow the vessel: see `small_motions`."""
    matrix = small_motions(acceleration)
    if is_followed(matrix, dt_s):
        return
    # The axis of the fastest motion, and the step length that follows it
    rates, shapes = np.linalg.eig(matrix)
    fastest = int(np.argmax(np.abs(rates)))
    share = np.abs(shapes[:, fastest] * np.linalg.pinv(shapes)[fastest])[_POSE:]
    axis = ("surge", "sway", "heave", "roll", "pitch", "yaw")[int(np.argmax(share))]
    needed = next(factor for factor in (2**n for n in range(1, 64)) if is_followed(matrix, dt_s / factor))
    raise ValueError(
        f"the vessel changes its {axis} at {abs(rates[fastest]):.0f} /s: steps of {1e3 * dt_s:g} ms do not follow it;"
        f" set clock.physics_rate_hz to {needed / dt_s:.0f}, or look for a damping too large or a mass too small"
    )


def small_motions(acceleration: Callable[[Array], Array]) -> Array:
    """Return the (9, 9) A of depth, roll and pitch, then the six velocities.

    acceleration: returns (K, 6) for (K, 9) states slightly off rest.
    """
    matrix = np.zeros((9, 9))
    matrix[(0, 1, 2), (5, 6, 7)] = 1.0
    matrix[_POSE:] = slopes(acceleration)
    return matrix


def slopes(rates: Callable[[Array], Array]) -> Array:
    """Return the (R, 9) derivatives of (K, R) rates by the 9 states of `small_motions`, by central differences."""
    values = rates(np.concatenate([np.diag(_OFFSETS), -np.diag(_OFFSETS)]))
    matrix: Array = (values[:9] - values[9:]).T / (2.0 * _OFFSETS)
    return matrix


def is_followed(matrix: Array, dt_s: float) -> bool:
    """Return True if steps of dt_s stay as bounded as the motions of `small_motions` themselves."""
    # One step of the integration: pose, velocity and last acceleration
    pose, moved = slice(0, _POSE), slice(_POSE, _POSE + _RATES)
    before = slice(_POSE + _RATES, _POSE + 2 * _RATES)
    acceleration = np.zeros((_RATES, _POSE + 2 * _RATES))
    acceleration[:, pose], acceleration[:, moved] = matrix[_POSE:, :_POSE], matrix[_POSE:, _POSE:]
    acceleration[:, before] = 0.5 * dt_s * matrix[_POSE:, _POSE:]
    step = np.zeros((_POSE + 2 * _RATES, _POSE + 2 * _RATES))
    step[before] = acceleration
    step[moved] = dt_s * acceleration
    step[moved, moved] += np.eye(_RATES)
    step[pose] = dt_s * matrix[:_POSE, _POSE:] @ step[moved]
    step[pose, pose] += np.eye(_POSE)
    # Compare its growth with that of the motions
    grows = max(float(np.linalg.eigvals(matrix).real.max()), 0.0)
    return float(np.abs(np.linalg.eigvals(step)).max()) <= math.exp(grows * dt_s) * (1.0 + _ROUNDING)
