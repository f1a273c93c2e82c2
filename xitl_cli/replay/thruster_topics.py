"""Topics that command the thrusters of a vessel, live and in bags: names, and motor commands from their numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

from sim_core.vessel.spec import VesselSpec
from xitl_cli.profile.schema import RunProfile


def thruster_names(vehicle: VesselSpec) -> tuple[str, ...]:
    """Of the propellers in their order, as topics and links have them.

    Two side by side are `left` and `right`, as VRX has them; others `propeller_0`, `propeller_1`, …
    """
    propellers = vehicle.propellers
    if len(propellers) == 2 and propellers[0].position_frd_m[1] < 0.0 < propellers[1].position_frd_m[1]:
        return "left", "right"
    return tuple(f"propeller_{number}" for number in range(len(propellers)))


def motor_commands(profile: RunProfile, shares: bool) -> Iterator[tuple[str, Callable[[float], float]]]:
    """The topic of each motor command in its order, and what makes a command in [-1, 1] of a message's number.

    Thrust at rest grows with the square of the speed, which the command sets: T = T_0 n |n| (sim_core's propulsion).
    shares: the numbers of propellers are commands already.
    """
    vehicle, names = profile.vehicle, thruster_names(profile.vehicle)
    density = profile.environment.water.density_kgpm3
    for name, propeller in zip(names, vehicle.propellers, strict=True):
        ahead_n, astern_n = propeller.static_thrust_n(density)
        command = _limited if shares else lambda newton, full=(ahead_n, astern_n): command_of_thrust(newton, *full)
        yield f"thrusters/{name}/cmd", command
    turning = [
        (name, one.steering.max_angle_deg)
        for name, one in zip(names, vehicle.propellers, strict=True)
        if one.steering is not None
    ]
    turning += [(f"rudder_{number}", rudder.max_angle_deg) for number, rudder in enumerate(vehicle.rudders)]
    for name, most_deg in turning:
        yield f"thrusters/{name}/pos", partial(_share_of, math.radians(most_deg))


def _share_of(most_rad: float, angle_rad: float) -> float:
    return _limited(angle_rad / most_rad)


def command_of_thrust(newton: float, ahead_n: float, astern_n: float) -> float:
    """The motor command that gives a thrust at rest, cut at full speed."""
    full_n = ahead_n if newton >= 0.0 else astern_n
    return math.copysign(math.sqrt(min(abs(newton) / full_n, 1.0)), newton) if full_n > 0.0 else 0.0


def _limited(command: float) -> float:
    return min(max(command, -1.0), 1.0)
