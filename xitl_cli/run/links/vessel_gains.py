"""Gains and outputs of the embedded autopilot that follow from the vessel, for a vessel without tuning.

Feed-forward gains are drag over thrust. The throttle's gain uses the thrust at cruise speed. Feedback gains and limits
come from the tuned full-size catamaran (firmware_params). They are scaled by the acceleration from thrust and moment,
and by Froude's law: lengths by the length of the hull, times by its square root.

Outputs: two propellers side by side steer by their difference. A single propeller at the stern steers by its gear or by
rudders. Both are as in ArduRover. Other vessels get motors and rudders at their places
(agent/fcu/control/allocation.py).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from agent.fcu.control.allocation import MotorsMixer, make_mixer
from agent.fcu.control.thrusters import ForceAllocation
from agent.fcu.parameters import MOTORS, OUTPUTS, RUDDERS, Parameters
from sim_core.environment.spec import Water
from sim_core.vessel.propulsion import FLOW
from sim_core.vessel.rudders import Rudders
from sim_core.vessel.spec import Propeller, Rudder, VesselSpec
from sim_core.vessel.vessel import Vessel

TUNED_LENGTH_M = 2.3
_SPEED_RADPS, _RATE_RADPS = 2.5, 1.67  # gains times full-demand acceleration of the two loops, tuned vessel
_TURN_RADPS, _MOST_RADPS = 0.3, math.radians(30.0)  # rate at which the yaw drag is taken, and the largest rate
_STEP_S = 1e-6  # only its forces are used, so the step does not matter


class _Steering(NamedTuple):
    """Moment of full steering, moment at which drag and loop are evaluated, and largest moment at cruise speed."""

    full_nm: float
    at_cruise_nm: float
    most_nm: float


_KEPT = 16
_computed: deque[tuple[VesselSpec, float, dict[str, float]]] = deque(maxlen=_KEPT)


def vessel_gains(vessel: VesselSpec, speed_mps: float) -> dict[str, float]:
    """Return parameters by name, for a mission at `speed_mps`. Raises ValueError for a vessel that does not float.

    The results for the latest vessels are kept, because most fleets have many alike.
    """
    for known, known_mps, gains in _computed:
        if known_mps == speed_mps and known == vessel:
            return dict(gains)
    _computed.append((vessel, speed_mps, _compute_gains(vessel, speed_mps)))
    return dict(_computed[-1][2])


def _compute_gains(vessel: VesselSpec, speed_mps: float) -> dict[str, float]:
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


_FUNCTION = "SERVO{}_FUNCTION"
_STEERING, _THROTTLE, _FIRST_MOTOR = 26, 70, 33
RUDDER_BASE_SHARE = 0.5
"""Share of the cruise speed up to which a rudder turns by the full demand."""


def output_parameters(vessel: VesselSpec, cruise_mps: float) -> dict[str, float]:
    """Return SERVOn_, MOTn_, RUDn_ and related parameters; none for the usual two propellers."""
    if is_skid_steered(vessel):
        return {}
    base_mps = min(max(RUDDER_BASE_SHARE * cruise_mps, 0.05), 10.0) if vessel.rudders else 0.0
    if is_steered_at_the_stern(vessel):
        gear = vessel.propellers[0].steering
        return {
            **_functions({3: _THROTTLE, 1: _STEERING} | {4 + n: _STEERING for n in range(1, len(vessel.rudders))}),
            "MOT_VEC_ANGLEMAX": 0.0 if gear is None else gear.max_angle_deg,
            "MOT_SPD_SCA_BASE": base_mps,
        }
    propellers = vessel.propellers[:MOTORS]
    functions = {number: _FIRST_MOTOR + number - 1 for number in range(1, len(propellers) + 1)}
    functions |= dict.fromkeys(range(len(propellers) + 1, min(vessel.own_commands, OUTPUTS) + 1), _STEERING)
    values = _functions(functions)
    if vessel.rudders:
        values["MOT_SPD_SCA_BASE"] = base_mps
    for number, propeller in enumerate(propellers, 1):
        ahead_n, astern_n = _thrust_n(propeller)
        values |= {
            f"MOT{number}_POS_X": propeller.position_frd_m[0],
            f"MOT{number}_POS_Y": propeller.position_frd_m[1],
            f"MOT{number}_ANGLE": propeller.angle_deg,
            f"MOT{number}_THRUST": ahead_n,
            f"MOT{number}_ASYM": min(ahead_n / astern_n, 100.0) if astern_n else 100.0,
        }
        if propeller.steering is not None:
            values[f"MOT{number}_VEC_MAX"] = propeller.steering.max_angle_deg
    for number, rudder in enumerate(vessel.rudders[:RUDDERS], 1):
        values |= {
            f"RUD{number}_POS_X": rudder.position_frd_m[0],
            f"RUD{number}_FORCE": rudder_force_n(vessel, rudder, base_mps),
        }
        if rudder.propeller is not None:
            # The race speed at the rudder, at rest with full thrust ahead, over the share of it in the race
            blade = Rudders.from_spec(replace(vessel, rudders=(rudder,)), Water())
            ahead_n, _ = _thrust_n(vessel.propellers[rudder.propeller])
            race_mps = math.sqrt(blade.speed2_per_newton[0] * ahead_n * rudder.race_share) * blade.reached_behind[0]
            if race_mps:
                values |= {f"RUD{number}_MOT": float(rudder.propeller + 1), f"RUD{number}_RACE": float(race_mps)}
    return values


def is_skid_steered(vessel: VesselSpec) -> bool:
    """Whether the vessel has two equal fixed propellers, port and starboard at equal distance, and no rudder."""
    if len(vessel.propellers) != 2 or vessel.commands != 2:
        return False
    port, starboard = vessel.propellers
    (port_n, port_astern_n), (starboard_n, starboard_astern_n) = _thrust_n(port), _thrust_n(starboard)
    out_m = starboard.position_frd_m[1]
    return (
        port.angle_deg == starboard.angle_deg == 0.0
        and out_m > 0.0
        and math.isclose(-port.position_frd_m[1], out_m, rel_tol=0.01)
        and math.isclose(port_n, starboard_n, rel_tol=0.01)
        and math.isclose(port_astern_n, starboard_astern_n, rel_tol=0.01)
    )


def is_steered_at_the_stern(vessel: VesselSpec) -> bool:
    """Whether the vessel has one forward propeller on the centreline, with a gear or with rudders behind the origin."""
    if len(vessel.propellers) != 1:
        return False
    (propeller,) = vessel.propellers
    gear, (x_m, y_m, _) = propeller.steering, propeller.position_frd_m
    if propeller.angle_deg != 0.0 or abs(y_m) > 0.01 * vessel.length_m:
        return False
    if gear is not None:
        return not vessel.rudders and x_m < 0.0 and gear.max_angle_deg <= 90.0
    return bool(vessel.rudders) and all(rudder.position_frd_m[0] < 0.0 for rudder in vessel.rudders)


def rudder_force_n(vessel: VesselSpec, rudder: Rudder, speed_mps: float) -> float:
    """Return the lateral force in N at full angle, at this speed of the hull and outside any propeller race."""
    alone_in_flow = (replace(rudder, propeller=None),)
    plain = replace(vessel, mmg=None, abkowitz=None, derivatives_contain=None, rudders=alone_in_flow)
    alone = Rudders.from_spec(plain, Water())
    flow = np.array([[speed_mps, *[0.0] * (FLOW - 1)]])
    _, right_n = alone.forces_n(np.radians([[rudder.max_angle_deg]]), np.zeros((1, len(vessel.propellers))), flow)
    return -float(right_n[0, 0])


def _thrust_n(propeller: Propeller) -> tuple[float, float]:
    return propeller.static_thrust_n(Water().density_kgpm3)


def _functions(used: dict[int, int]) -> dict[str, float]:
    """Return the functions of the outputs. The usual outputs have none unless they are used."""
    return {_FUNCTION.format(output): float(function) for output, function in sorted(({1: 0, 3: 0} | used).items())}
