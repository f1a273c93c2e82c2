"""True motions the sensor tests measure: at rest, and one rich enough that every term of a lever arm counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sim_core.frames import Array, euler_to_quat, quat_to_matrix
from sim_core.kinematics import Kinematics


def at_rest(
    vessels: int = 1, euler_rad: ArrayLike = (0.0, 0.0, 0.0), pos_ned_m: ArrayLike = (0.0, 0.0, 0.0)
) -> Kinematics:
    """Still vessels; the attitude and position for all or one a row."""
    zero = np.zeros((vessels, 3))
    quat = np.array(euler_to_quat(zero + np.asarray(euler_rad, dtype=np.float64)))
    return Kinematics(zero + np.asarray(pos_ned_m), zero, zero, quat, quat_to_matrix(quat), zero, zero)


def swinging(time_s: float) -> Kinematics:
    """One vessel that rolls, pitches, yaws and travels; rates from the Euler kinematics (Fossen 2021, eq 2.28)."""
    roll, pitch, yaw = 0.3 * np.sin(1.1 * time_s), 0.2 * np.sin(1.7 * time_s + 0.5), 0.8 * np.sin(0.7 * time_s + 1.0)
    position = [8.0 * np.sin(0.4 * time_s), 5.0 * np.cos(0.6 * time_s), 0.5 * np.sin(1.3 * time_s)]
    velocity = [3.2 * np.cos(0.4 * time_s), -3.0 * np.sin(0.6 * time_s), 0.65 * np.cos(1.3 * time_s)]
    acceleration = [
        -1.28 * np.sin(0.4 * time_s),
        -1.8 * np.cos(0.6 * time_s),
        -0.845 * np.sin(1.3 * time_s),
    ]
    quat = np.array(euler_to_quat(np.array([[roll, pitch, yaw]])))
    half = 1e-4
    spin = (_swing_rate(time_s + half) - _swing_rate(time_s - half)) / (2.0 * half)
    return Kinematics(
        np.array([position]),
        np.array([velocity]),
        np.array([acceleration]),
        quat,
        quat_to_matrix(quat),
        _swing_rate(time_s),
        spin,
    )


def _swing_rate(time_s: float) -> Array:
    roll, pitch = 0.3 * np.sin(1.1 * time_s), 0.2 * np.sin(1.7 * time_s + 0.5)
    roll_rate, pitch_rate = 0.33 * np.cos(1.1 * time_s), 0.34 * np.cos(1.7 * time_s + 0.5)
    yaw_rate = 0.56 * np.cos(0.7 * time_s + 1.0)
    return np.array(
        [
            [
                roll_rate - yaw_rate * np.sin(pitch),
                pitch_rate * np.cos(roll) + yaw_rate * np.cos(pitch) * np.sin(roll),
                -pitch_rate * np.sin(roll) + yaw_rate * np.cos(pitch) * np.cos(roll),
            ]
        ]
    )
