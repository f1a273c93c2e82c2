"""The true motion of the vessels: what the sensors measure and the recorder writes."""

from __future__ import annotations

from dataclasses import dataclass

from numpy import float64
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Kinematics:
    """True motion of the body's origin of N vessels.

    pos_ned_m, vel_ned_mps, acc_ned_mps2: (N, 3) position, velocity and its time derivative (gravity not
        included: a vessel at rest has zero acceleration), NED axes.
    quat_ned_frd: (N, 4) unit quaternion (w, x, y, z) turning body FRD into NED; rot_ned_frd: (N, 3, 3) the same
        as a matrix, `v_ned = rot_ned_frd @ v_frd`.
    gyro_frd_radps, angular_acc_frd_radps2: (N, 3) angular velocity against NED and its derivative, body axes.
    """

    pos_ned_m: NDArray[float64]
    vel_ned_mps: NDArray[float64]
    acc_ned_mps2: NDArray[float64]
    quat_ned_frd: NDArray[float64]
    rot_ned_frd: NDArray[float64]
    gyro_frd_radps: NDArray[float64]
    angular_acc_frd_radps2: NDArray[float64]
