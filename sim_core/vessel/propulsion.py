"""Air propellers, some of which turn about their masts: thrust ~ n |n|, speed a first-order lag behind the command.

The lag has its own time constant for speeding up and for slowing down, as PX4's motor model has. Speed is a fraction
of full speed in [-1, 1]; forward and reverse have their own full thrust. Thrust is static: at the few m/s of a boat the
inflow of an air propeller changes it little. An angle delta of a steering gear turns the thrust to
(cos delta, -sin delta): at the stern a positive one brings the bow to starboard. The gear turns at its rate towards the
command and stops there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import intp
from numpy.typing import NDArray

from sim_core.environment.spec import Water
from sim_core.frames import Array
from sim_core.vessel.spec import VesselSpec


@dataclass(frozen=True, slots=True, eq=False)
class Propulsion:
    """Constants of P propellers; a gain is the share of the speed's error that one step takes away."""

    spin_down_gain: Array  # (P,)
    spin_up_extra: Array  # (P,) what speeding up adds to it
    wrench: Array  # (2 P, 6) force and moment per n |n|, then per n^2, which tells reverse from forward

    @classmethod
    def from_spec(cls, model: VesselSpec, dt_s: float) -> Propulsion:
        """Constants from the vessel's propellers for steps of dt_s."""
        forward, reverse = np.array([p.static_thrust_n(Water().density_kgpm3) for p in model.propellers]).T
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


@dataclass(frozen=True, slots=True, eq=False)
class SteeredPropulsion:
    """Constants of P propellers and S gears. Commands and what follows them: P speeds, then S shares of full angle."""

    propulsion: Propulsion
    steered: NDArray[intp]  # (S,) which propellers
    max_angle_rad: Array  # (S,)
    most_per_step: Array  # (S,) share of the full angle that a gear turns in one step
    wrench: Array  # (4 P, 6) as of Propulsion for thrust ahead, then the same for thrust to port

    @classmethod
    def from_spec(cls, model: VesselSpec, dt_s: float) -> SteeredPropulsion:
        """Constants from the vessel's propellers for steps of dt_s."""
        propulsion = Propulsion.from_spec(model, dt_s)
        gears = [(index, p.steering) for index, p in enumerate(model.propellers) if p.steering is not None]
        forward, reverse = np.array([p.static_thrust_n(Water().density_kgpm3) for p in model.propellers]).T
        to_port = np.array([0.0, -1.0, 0.0])
        per_newton = np.array([[*to_port, *np.cross(p.position_frd_m, to_port)] for p in model.propellers])
        aside = [0.5 * (forward + reverse)[:, None] * per_newton, 0.5 * (forward - reverse)[:, None] * per_newton]
        return cls(
            propulsion=propulsion,
            steered=np.array([index for index, _ in gears], dtype=intp),
            max_angle_rad=np.radians([gear.max_angle_deg for _, gear in gears]),
            most_per_step=np.array([gear.rate_degps * dt_s / gear.max_angle_deg for _, gear in gears]),
            wrench=np.concatenate([propulsion.wrench, *aside]),
        )

    def spin(self, rotor_speed: Array, command: Array) -> Array:
        """(N, P + S) one step later, for (N, P + S) commands, which are clamped to [-1, 1]."""
        propellers = self.propulsion.spin_down_gain.size
        speed = self.propulsion.spin(rotor_speed[:, :propellers], command[:, :propellers])
        share, wanted = rotor_speed[:, propellers:], np.minimum(np.maximum(command[:, propellers:], -1.0), 1.0)
        turn = np.minimum(np.maximum(wanted - share, -self.most_per_step), self.most_per_step)
        return np.concatenate((speed, share + turn), axis=1)

    def terms(self, rotor_speed: Array) -> tuple[Array, ...]:
        """Four of (N, P): n |n| and n^2 times the cosine of the angle, then times its sine."""
        propellers = self.propulsion.spin_down_gain.size
        angle = np.zeros((len(rotor_speed), propellers))
        angle[:, self.steered] = rotor_speed[:, propellers:] * self.max_angle_rad
        cosine, sine = np.cos(angle), np.sin(angle)
        signed, square = self.propulsion.terms(rotor_speed[:, :propellers])
        return signed * cosine, square * cosine, signed * sine, square * sine


def make_propulsion(model: VesselSpec, dt_s: float) -> Propulsion | SteeredPropulsion:
    """Whichever the vessel's propellers need."""
    return (
        Propulsion.from_spec(model, dt_s)
        if model.commands == len(model.propellers)
        else SteeredPropulsion.from_spec(model, dt_s)
    )
