"""Gains of the embedded autopilot that follow from the vessel, for a vessel without tuning.

Feed-forward gains are drag over thrust. The throttle's gain uses the thrust at cruise speed. Feedback gains and limits
come from the tuned full-size catamaran (firmware_params). They are scaled by the acceleration from thrust and moment,
and by Froude's law: lengths by the length of the hull, times by its square root. The actuators are in vessel_outputs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agent.fcu.control.allocation import MotorsMixer, make_mixer
from agent.fcu.control.thrusters import ForceAllocation
from agent.fcu.parameters import Parameters
from sim_core.environment.spec import Water
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import Vessel
from xitl_cli.run.links.vessel_outputs import (
    RUDDER_BASE_SHARE,
    is_steered_at_the_stern,
    output_parameters,
    rudder_force_n,
)

TUNED_LENGTH_M = 2.3
_SPEED_RADPS, _RATE_RADPS = 2.5, 1.67  # gains times full-demand acceleration of the two loops, tuned vessel
_TURN_RADPS, _MOST_RADPS = 0.3, math.radians(30.0)  # rate at which the yaw drag is taken, and the largest rate
_STEP_S = 1e-6  # only its forces are used, so the step does not matter


class _Steering(NamedTuple):
    """Moment of full steering, moment at which drag and loop are evaluated, and largest moment at cruise speed."""

    full_nm: float
    at_cruise_nm: float
    most_nm: float


def vessel_gains(vessel: VesselSpec, speed_mps: float) -> dict[str, float]:
    """Return parameters by name, for a mission at `speed_mps`. Raises ValueError for a vessel that does not float."""
    quicker = math.sqrt(TUNED_LENGTH_M / vessel.length_m)
    outputs = output_parameters(vessel, speed_mps)
    mixer = make_mixer(Parameters(outputs))
    body = Vessel.from_spec(vessel, Water(), _STEP_S)
    inertia = body.hydrodynamics.rigid_mass + body.hydrodynamics.added_mass
    thrusts_n = [propeller.static_thrust_n(Water().density_kgpm3) for propeller in vessel.propellers]
    along = [1.0 if p.steering else math.cos(math.radians(p.angle_deg)) for p in vessel.propellers]
    ahead_n = sum(max(share * ahead, -share * astern) for share, (ahead, astern) in zip(along, thrusts_n, strict=True))
    astern_n = sum(max(share * astern, -share * ahead) for share, (ahead, astern) in zip(along, thrusts_n, strict=True))
    drag_n = _drag(body, 0, speed_mps)
    ahead_mps2 = ahead_n / float(inertia[0, 0])
    speed_p = _limited(_SPEED_RADPS * quicker / ahead_mps2, 0.05, 2.0)
    hardest_mps2 = 0.7 if mixer.pivots else 0.5  # thrust that brakes steers in the wrong direction or not at all
    gains = outputs | {
        "CRUISE_SPEED": _limited(speed_mps, 0.1, 30.0),
        "CRUISE_THROTTLE": float(round(_limited(100.0 * _demand(body, drag_n, speed_mps), 1.0, 100.0))),
        "ATC_SPEED_P": speed_p,
        "ATC_SPEED_I": 0.4 * speed_p * quicker,
        "ATC_ACCEL_MAX": _limited(0.3 * ahead_mps2, 0.05, hardest_mps2),
        "ATC_DECEL_MAX": _limited(0.3 * ahead_mps2, 0.05, hardest_mps2),
        "LOS_LOOKAHEAD": _limited(6.0 / quicker**2, 3.0, 500.0),  # the error of a satellite receiver does not scale
        "LOS_KAPPA": 0.8 / quicker,
        "WP_SPEED_MIN": _limited(speed_mps / 3.0 if mixer.pivots else 0.75 * speed_mps, 0.1, 100.0),
        "MOT_THST_EXPO": 1.0,
        "MOT_THST_ASYM": _limited(ahead_n / astern_n, 1.0, 10.0) if astern_n else 10.0,
        "MOT_SLEWRATE": float(round(_limited(500.0 * quicker, 50.0, 1000.0))),
    }
    if vessel.rudders and not mixer.pivots:
        gains["LOIT_TYPE"] = 1.0  # a rudder needs flow from ahead to steer
    steering = _steering(vessel, mixer.force if isinstance(mixer, MotorsMixer) else None, ahead_n, drag_n, speed_mps)
    if steering.full_nm <= 0.0:
        return gains
    turn_radps = _TURN_RADPS * quicker
    drag_nms = _drag(body, 5, turn_radps, 0.0 if mixer.pivots else speed_mps) / turn_radps
    about_z_kgm2 = float(inertia[5, 5])
    spin_radps2 = steering.at_cruise_nm / about_z_kgm2
    most_radps = min(_MOST_RADPS * quicker, 0.7 * steering.most_nm / drag_nms if drag_nms > 0.0 else math.inf)
    rate_p = _limited(_RATE_RADPS * quicker / spin_radps2, 0.02, 5.0)
    return gains | {
        "ATC_STR_ANG_P": _limited(1.5 * quicker, 0.3, 2.0),
        "ATC_STR_RAT_FF": _limited(drag_nms / steering.at_cruise_nm, 0.0, 10.0),
        "ATC_STR_RAT_P": rate_p,
        "ATC_STR_RAT_I": _limited(rate_p * quicker, 0.0, 10.0),
        "ATC_STR_RAT_MAX": _limited(math.degrees(most_radps), 3.0, 90.0),
        "ATC_STR_ACC_MAX": _limited(math.degrees(0.5 * steering.most_nm / about_z_kgm2), 3.0, 300.0),
    }


def _steering(
    vessel: VesselSpec, force: ForceAllocation | None, ahead_n: float, drag_n: float, speed_mps: float
) -> _Steering:
    if force is not None:
        return _Steering(force.full_moment_nm, force.full_moment_nm, force.full_moment_nm)
    if not is_steered_at_the_stern(vessel):
        levers_m = [abs(propeller.position_frd_m[1]) for propeller in vessel.propellers]
        full_nm = ahead_n * sum(levers_m) / len(levers_m)
        return _Steering(full_nm, full_nm, full_nm)
    if (gear := vessel.propellers[0].steering) is not None:
        lever_m = abs(vessel.propellers[0].position_frd_m[0])
        lent_nm = min(drag_n * math.tan(math.radians(min(gear.max_angle_deg, 89.0))), ahead_n) * lever_m
        return _Steering(ahead_n * lever_m, ahead_n * lever_m, lent_nm)
    moment_nm = sum(rudder_force_n(vessel, rudder, speed_mps) * -rudder.position_frd_m[0] for rudder in vessel.rudders)
    # Full steering is full rudder at the base speed. Above it the angle falls and the force grows with the speed.
    return _Steering(moment_nm * RUDDER_BASE_SHARE**2, moment_nm * RUDDER_BASE_SHARE, moment_nm)


def _drag(body: Vessel, axis: int, rate: float, speed_mps: float = 0.0) -> float:
    """Return the drag of a motion along or about one axis in N or N m, at the given forward speed."""
    velocity = np.zeros((1, 6))
    velocity[0, 0] = speed_mps
    velocity[0, axis] = rate
    terms = np.concatenate(body.hydrodynamics.terms(velocity), axis=1)
    return float(-(terms @ body.hydrodynamics.wrench)[0, axis])


def _demand(body: Vessel, drag_n: float, speed_mps: float) -> float:
    """Return the share of full thrust at rest that balances the drag at this speed."""
    demands = np.linspace(0.0, 1.0, 1001)
    ahead = np.cos(np.radians([propeller.angle_deg for propeller in body.model.propellers])).round(3)
    actuators = np.zeros((len(demands), body.model.commands))
    actuators[:, : len(ahead)] = np.sqrt(demands)[:, None] * np.sign(ahead)
    velocity = np.zeros((len(demands), 6))
    velocity[:, 0] = speed_mps
    terms = np.concatenate(body.propulsion.terms(actuators, velocity, velocity[:, :3]), axis=1)
    enough = (terms @ body.propulsion.wrench)[:, 0] >= drag_n
    return float(demands[enough.argmax()]) if enough.any() else 1.0


def _limited(value: float, least: float, most: float) -> float:
    return min(max(value, least), most)
