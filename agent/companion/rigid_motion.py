"""Rotations and rigid motions: unit quaternions, (4, 4) matrices of SE(3), and twists (6,).

A twist is velocity, then angular velocity, in the body. Closed forms of SE(3): Barfoot, State Estimation for Robotics,
2017, sec. 7.1.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Points = NDArray[np.float32]

_SMALL_RAD = 1e-6


def cross_matrix(vector: Array) -> Array:
    """(3, 3): `cross_matrix(a) @ b` is a x b."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exponential(twist: Array) -> Array:
    """(4, 4) motion of a body that keeps a twist (6,) for one unit of time."""
    turn = cross_matrix(twist[3:])
    squared = turn @ turn
    angle = float(np.linalg.norm(twist[3:]))
    if angle < _SMALL_RAD:
        a, b, c = 1.0, 0.5, 1.0 / 6.0
    else:
        a = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / angle**2
        c = (1.0 - a) / angle**2
    motion = np.eye(4)
    motion[:3, :3] += a * turn + b * squared
    motion[:3, 3] = (np.eye(3) + b * turn + c * squared) @ twist[:3]
    return motion


def logarithm(motion: Array) -> Array:
    """(6,) the twist whose exponential is `motion`, for turns of less than half a circle."""
    rotation = motion[:3, :3]
    axis = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, 0.5 * (float(np.trace(rotation)) - 1.0))
    turned = axis if sine < _SMALL_RAD else axis * (angle / sine)
    turn = cross_matrix(turned)
    # (1 - (angle / 2) cot(angle / 2)) / angle^2, which tends to 1/12
    half = 0.5 * angle
    c = 1.0 / 12.0 if angle < 1e-3 else (1.0 - half / math.tan(half)) / angle**2
    back = np.eye(3) - 0.5 * turn + c * (turn @ turn)
    return np.concatenate([back @ motion[:3, 3], turned])


def inverse(motion: Array) -> Array:
    """(4, 4) the motion back."""
    back = np.eye(4)
    back[:3, :3] = motion[:3, :3].T
    back[:3, 3] = -motion[:3, :3].T @ motion[:3, 3]
    return back


def moved(motion: Array, points_m: Points) -> Points:
    """(n, 3) points after a motion (4, 4)."""
    rotation, shift = motion[:3, :3].astype(np.float32), motion[:3, 3].astype(np.float32)
    there: Points = points_m @ rotation.T + shift
    return there


def drifted(points_m: Points, lag_s: Points, twist: Array) -> Points:
    """(n, 3) where points that were seen from the body at instants lag_s (n,) lie seen from it at 0.

    The exponential to the second order in the angle: at 1 rad/s and a lag of 0.1 s it is within 2e-4 of the range.
    """
    velocity, turn = twist[:3].astype(np.float32), cross_matrix(twist[3:]).astype(np.float32)
    lag: Points = lag_s[:, None]
    first: Points = points_m @ turn.T + velocity
    second: Points = first @ turn.T
    there: Points = points_m + lag * (first + lag * (second / np.float32(2.0)))
    return there
