"""True motion of the vessels. The sensors measure it and the recorder writes it."""

from __future__ import annotations

from numpy import float64
from numpy.typing import NDArray

from sim_core.state_class import state_class


@state_class
class Kinematics:
    """True motion of the body origin of N vessels."""

    pos_ned_m: NDArray[float64]
    """Position, (N, 3), NED axes."""
    vel_ned_mps: NDArray[float64]
    """Velocity, (N, 3), NED axes."""
    acc_ned_mps2: NDArray[float64]
    """Time derivative of the velocity, (N, 3), NED axes, without gravity: zero for a vessel at rest."""
    quat_ned_frd: NDArray[float64]
    """Unit quaternion (w, x, y, z) that turns body FRD into NED, (N, 4)."""
    rot_ned_frd: NDArray[float64]
    """The same rotation as a matrix, (N, 3, 3): `v_ned = rot_ned_frd @ v_frd`."""
    gyro_frd_radps: NDArray[float64]
    """Angular velocity relative to NED, (N, 3), body axes."""
    angular_acc_frd_radps2: NDArray[float64]
    """Time derivative of the angular velocity, (N, 3), body axes."""
