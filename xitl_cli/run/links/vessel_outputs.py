"""Outputs of the embedded autopilot that follow from the vessel: its actuators, their places and their strength.

Two propellers side by side steer by their difference. A single propeller at the stern steers by its gear or by rudders.
Both are as in ArduRover. Other vessels get motors and rudders at their places (agent/fcu/control/allocation.py).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from agent.fcu.parameters import MOTORS, OUTPUTS, RUDDERS
from sim_core.environment.spec import Water
from sim_core.vessel.propulsion import FLOW
from sim_core.vessel.rudders import Rudders
from sim_core.vessel.spec import Propeller, Rudder, VesselSpec

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
    return _motors(vessel, base_mps)


def is_skid_steered(vessel: VesselSpec) -> bool:
    """Whether the vessel has two equal fixed propellers, port and starboard at equal distance, and no rudder."""
    if len(vessel.propellers) != 2 or vessel.commands != 2:
        return False
    port, starboard = vessel.propellers
    (port_n, port_astern_n), (starboard_n, starboard_astern_n) = (_thrust_n(each) for each in vessel.propellers)
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
    alone = Rudders.from_spec(replace(vessel, rudders=(replace(rudder, propeller=None),)), Water())
    flow = np.array([[speed_mps, *[0.0] * (FLOW - 1)]])
    _, right_n = alone.forces_n(np.radians([[rudder.max_angle_deg]]), np.zeros((1, len(vessel.propellers))), flow)
    return -float(right_n[0, 0])


def _thrust_n(propeller: Propeller) -> tuple[float, float]:
    return propeller.static_thrust_n(Water().density_kgpm3)


def _functions(used: dict[int, int]) -> dict[str, float]:
    """Return the functions of the outputs. The usual outputs have none unless they are used."""
    return {_FUNCTION.format(output): float(function) for output, function in sorted(({1: 0, 3: 0} | used).items())}


def _motors(vessel: VesselSpec, base_mps: float) -> dict[str, float]:
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
        if rudder.propeller is not None and (race_mps := _race_mps(vessel, rudder)):
            values |= {f"RUD{number}_MOT": float(rudder.propeller + 1), f"RUD{number}_RACE": race_mps}
    return values


def _race_mps(vessel: VesselSpec, rudder: Rudder) -> float:
    """Return the race speed in m/s at the rudder, at rest with full thrust ahead, over the share of it in the race."""
    assert rudder.propeller is not None
    blade = Rudders.from_spec(replace(vessel, rudders=(rudder,)), Water())
    ahead_n, _ = _thrust_n(vessel.propellers[rudder.propeller])
    return float(math.sqrt(blade.speed2_per_newton[0] * ahead_n * rudder.race_share) * blade.reached_behind[0])
