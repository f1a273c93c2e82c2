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
    """Matrix (3, 3) of a vector a: `cross_matrix(a) @ b` is a x b."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exponential(twist: Array) -> Array:
    """Motion (4, 4) of a body that keeps a twist (6,) for one unit of time."""
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
    """Twist (6,) whose exponential is `motion`, for rotations of less than half a turn."""
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
    """Inverse motion (4, 4)."""
    back = np.eye(4)
    back[:3, :3] = motion[:3, :3].T
    back[:3, 3] = -motion[:3, :3].T @ motion[:3, 3]
    return back


def transform_points(motion: Array, points_m: Points) -> Points:
    """Points (n, 3) after a motion (4, 4)."""
    rotation, shift = motion[:3, :3].astype(np.float32), motion[:3, 3].astype(np.float32)
    there: Points = points_m @ rotation.T + shift
    return there


def deskew(points_m: Points, lag_s: Points, twist: Array) -> Points:
    """Points (n, 3) in the body axes of instant 0, from points in the body axes of instants lag_s (n,).

    The exponential is of second order in the angle. At 1 rad/s and a lag of 0.1 s, its error is below 2e-4 of the
    range.
    """
    velocity, turn = twist[:3].astype(np.float32), cross_matrix(twist[3:]).astype(np.float32)
    lag: Points = lag_s[:, None]
    first: Points = points_m @ turn.T + velocity
    second: Points = first @ turn.T
    there: Points = points_m + lag * (first + lag * (second / np.float32(2.0)))
    return there


def rotation_vector(rotation: Array) -> Array:
    """Rotation vector (3,) of a rotation matrix (3, 3)."""
    motion = np.eye(4)
    motion[:3, :3] = rotation
    return logarithm(motion)[3:]


def rotation_matrix(quat: Array) -> Array:
    """Rotation matrix (3, 3) of a unit quaternion w, x, y, z."""
    w, x, y, z = quat.tolist()
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
    )


def quaternion_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """Unit quaternion of the Euler angles of ATTITUDE."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    return np.array(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
    )


def turn_quaternion(quat: Array, turn_rad: Array) -> Array:
    """Quaternion after a further rotation (3,) about the body's axes."""
    angle = float(np.linalg.norm(turn_rad))
    half = 0.5 * angle
    sine = 0.5 if angle < 1e-9 else math.sin(half) / angle
    turned = quaternion_product(quat, np.concatenate([[math.cos(half)], sine * turn_rad]))
    unit: Array = turned / np.linalg.norm(turned)
    return unit


def quaternion_product(first: Array, second: Array) -> Array:
    """Hamilton product of w, x, y, z (4,)."""
    w, x, y, z = first.tolist()
    p, q, r, s = second.tolist()
    return np.array(
        (
            w * p - x * q - y * r - z * s,
            w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q,
            w * s + x * r - y * q + z * p,
        )
    )


def quaternion_of(rotation: Array) -> list[float]:
    """w, x, y, z of a (3, 3) rotation: the eigenvector of Bar-Itzhack's matrix (J. Guidance 23(6), 2000)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    upper = [
        [xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, yy - xx - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, zz - xx - yy],
    ]
    vectors = np.linalg.eigh(np.array(upper))[1]
    quaternion = vectors[:, -1]
    return [float(value) for value in (quaternion if quaternion[0] >= 0.0 else -quaternion)]
