"""Gains of the embedded autopilot that follow from the vessel, for one that nobody has tuned yet.

Feed-forwards are drag over thrust. Feed-back and limits are those of the full-size catamaran (firmware_params), which
was tuned, carried over as a share of what thrust and moment can accelerate, and by Froude's law: lengths by the
length of the hull, times by its root.
"""

from __future__ import annotations

import math

from sim_core.environment.spec import Water
from sim_core.vessel.spec import VesselSpec

TUNED_LENGTH_M = 2.3
_SPEED_RADPS, _RATE_RADPS = 2.5, 1.67  # of the two loops of the tuned vessel: gain times what full demand accelerates
_TURN_RADPS, _MOST_RADPS = 0.3, math.radians(30.0)  # at which the yaw drag is taken, and what it turns at most


def vessel_gains(vessel: VesselSpec, speed_mps: float) -> dict[str, float]:
    """Parameters by name, for a mission at `speed_mps`."""
    length, masses = vessel.length_m / TUNED_LENGTH_M, vessel.added_mass
    quicker = 1.0 / math.sqrt(length)
    thrusts_n = [propeller.static_thrust_n(Water().density_kgpm3) for propeller in vessel.propellers]
    ahead_n, astern_n = sum(ahead for ahead, _ in thrusts_n), sum(astern for _, astern in thrusts_n)
    drag_n = vessel.damping_linear.surge * speed_mps + vessel.damping_quadratic.surge * speed_mps**2
    ahead_mps2 = ahead_n / (vessel.mass_kg + masses.surge_kg)
    speed_p = _limited(_SPEED_RADPS * quicker / ahead_mps2, 0.05, 2.0)
    gains = {
        "CRUISE_SPEED": _limited(speed_mps, 0.1, 30.0),
        "CRUISE_THROTTLE": float(round(_limited(100.0 * drag_n / ahead_n, 1.0, 100.0))),
        "ATC_SPEED_P": speed_p,
        "ATC_SPEED_I": 0.4 * speed_p * quicker,
        "ATC_ACCEL_MAX": _limited(0.3 * ahead_mps2, 0.05, 0.7),
        "ATC_DECEL_MAX": _limited(0.3 * ahead_mps2, 0.05, 0.7),
        "LOS_LOOKAHEAD": _limited(6.0 * length, 3.0, 500.0),  # a satellite receiver does not scale
        "LOS_KAPPA": 0.8 / quicker,
        "WP_SPEED_MIN": _limited(speed_mps / 3.0, 0.1, 100.0),
        "MOT_THST_EXPO": 1.0,
        "MOT_THST_ASYM": _limited(ahead_n / astern_n, 1.0, 10.0) if astern_n else 10.0,
        "MOT_SLEWRATE": float(round(_limited(500.0 * quicker, 50.0, 1000.0))),
    }
    levers_m = [abs(propeller.position_frd_m[1]) for propeller in vessel.propellers]
    moment_nm = sum(ahead * lever_m for (ahead, _), lever_m in zip(thrusts_n, levers_m, strict=True))
    if moment_nm <= 0.0:
        return gains
    turn_radps = _TURN_RADPS * quicker
    drag_nms = vessel.damping_linear.yaw + vessel.damping_quadratic.yaw * turn_radps
    spin_radps2 = moment_nm / (vessel.inertia_kgm2[2] + masses.yaw_kgm2)
    most_radps = min(_MOST_RADPS * quicker, 0.7 * moment_nm / drag_nms if drag_nms else math.inf)
    rate_p = _limited(_RATE_RADPS * quicker / spin_radps2, 0.02, 5.0)
    return gains | {
        "ATC_STR_ANG_P": _limited(1.5 * quicker, 0.3, 2.0),
        "ATC_STR_RAT_FF": _limited(drag_nms / moment_nm, 0.0, 10.0),
        "ATC_STR_RAT_P": rate_p,
        "ATC_STR_RAT_I": _limited(rate_p * quicker, 0.0, 10.0),
        "ATC_STR_RAT_MAX": _limited(math.degrees(most_radps), 3.0, 90.0),
        "ATC_STR_ACC_MAX": _limited(math.degrees(0.5 * spin_radps2), 3.0, 300.0),
    }


def _limited(value: float, least: float, most: float) -> float:
    return min(max(value, least), most)
