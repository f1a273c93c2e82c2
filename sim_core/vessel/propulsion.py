"""Air propellers: thrust ~ n |n|, speed a first-order lag behind the command.

The lag has its own time constant for speeding up and for slowing down, as PX4's motor model has. Speed is a fraction
of full speed in [-1, 1]; forward and reverse have their own full thrust. Thrust is static: at the few m/s of a boat the
inflow of an air propeller changes it little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.vessel.model import VesselModel

Array = NDArray[float64]


@dataclass(frozen=True, slots=True, eq=False)
class Propulsion:
    """Constants of P propellers; a gain is the share of the speed's error that one step takes away."""

    spin_down_gain: Array  # (P,)
    spin_up_extra: Array  # (P,) what speeding up adds to it
    wrench: Array  # (2 P, 6) force and moment per n |n|, then per n^2, which tells reverse from forward

    @classmethod
    def of(cls, model: VesselModel, dt_s: float) -> Propulsion:
        """Constants from the vessel's propellers for steps of dt_s."""
        forward = np.array([propeller.max_thrust_n for propeller in model.propellers])
        reverse = np.array([propeller.max_reverse_thrust_n for propeller in model.propellers])
        ahead = np.array([1.0, 0.0, 0.0])
        per_newton = np.array([[*ahead, *np.cross(p.position_frd_m, ahead)] for p in model.propellers])
        up_gain = 1.0 - np.exp([-dt_s / propeller.spin_up_s for propeller in model.propellers])
        down_gain = 1.0 - np.exp([-dt_s / propeller.spin_down_s for propeller in model.propellers])
        return cls(
            spin_down_gain=down_gain,
            spin_up_extra=up_gain - down_gain,
            wrench=np.concatenate(
                [0.5 * (forward + reverse)[:, None] * per_newton, 0.5 * (forward - reverse)[:, None] * per_newton]
            ),
        )

    def spin(self, rotor_speed: Array, command: Array) -> Array:
        """(N, P) speeds one step later, for (N, P) commands, which are clamped to [-1, 1]; exact for a held command."""
        wanted = np.minimum(np.maximum(command, -1.0), 1.0)
        faster = np.abs(wanted) > np.abs(rotor_speed)
        gain = self.spin_down_gain + faster * self.spin_up_extra
        speed: Array = rotor_speed + (wanted - rotor_speed) * gain
        return speed

    def terms(self, rotor_speed: Array) -> tuple[Array, Array]:
        """(N, P), (N, P): n |n| and n^2, what the thrust is linear in."""
        return rotor_speed * np.abs(rotor_speed), rotor_speed * rotor_speed
