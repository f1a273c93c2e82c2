"""The Mariner class cargo ship: table of Chislett & Strom-Tejsen 1965 (report Hy-5) and its equations, as in MSS.

State: u, v and r about midship, north, east, yaw, rudder angle, positive for the bow to starboard. The table counts
angles to port as positive. Its Y_r, N_r, X_rr and X_vr contain the Coriolis terms of mass and added mass.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tests.oracles.integration import Array
from tests.oracles.kvlcc2 import steered

LENGTH, SPEED = 160.93, 7.7175
MASS, INERTIA, GRAVITY_X = 798e-5, 39.2e-5, -0.023
LEVER = MASS * GRAVITY_X
COUPLED = np.array([[MASS + 748e-5, LEVER + 9.354e-5], [LEVER - 4.646e-5, INERTIA + 43.8e-5]])
"""Mass in sway and yaw."""
(SIDE_Y, SIDE_N), (TURN_Y, TURN_N) = np.linalg.inv(COUPLED).tolist()


def _table(u: float, v: float, r: float, d: float) -> tuple[float, float, float]:
    x = -184 * u - 110 * u**2 - 215 * u**3 - 899 * v**2 + 18 * r**2 + 798 * r * v
    x += -95 * d**2 - 190 * u * d**2 + 93 * v * d + 93 * u * v * d
    y = (-1160 * v - 499 * r) * (1 + u) - 8078 * v**3 + 15356 * v**2 * r
    y += 278 * d * (1 + 2 * u + u**2) - 90 * d**3 - 4 * v * d**2 + 1190 * v**2 * d - 4 * (1 + u) ** 2
    n = (-264 * v - 166 * r) * (1 + u) + 1636 * v**3 - 5483 * v**2 * r
    n += -139 * d * (1 + 2 * u + u**2) + 45 * d**3 + 13 * v * d**2 - 489 * v**2 * d + 3 * (1 + u) ** 2
    return x * 1e-5, y * 1e-5, n * 1e-5


def rates(state: Array) -> Array:
    """Derivatives of the state, with the rudder held."""
    u, v, r, _, _, psi, delta = state.tolist()
    speed = math.hypot(u, v)
    x, y, n = _table((u - SPEED) / speed, v / speed, r * LENGTH / speed, -delta)
    side, turn = SIDE_Y * y + SIDE_N * n, TURN_Y * y + TURN_N * n
    scale = speed**2 / LENGTH
    north, east = u * math.cos(psi) - v * math.sin(psi), u * math.sin(psi) + v * math.cos(psi)
    return np.array([x / (MASS + 42e-5) * scale, side * scale, turn * scale / LENGTH, north, east, r, 0.0])


def sail(ordered_deg: Callable[[float], float], duration: float, step: float = 0.1) -> Array:
    """States of a run from the nominal speed, (K, 7), with the gear's 5 degrees per second."""
    return steered(rates, SPEED, ordered_deg, 5.0, duration, step)
