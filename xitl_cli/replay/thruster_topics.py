"""Topics that command the thrusters of a vessel, live and in bags: names, and conversion to motor commands."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

from sim_core.vessel.spec import VesselSpec
from xitl_cli.profile.schema import RunProfile


def thruster_names(vehicle: VesselSpec) -> tuple[str, ...]:
    """Return the names of the propellers in their order, for topics and links.

    Two side by side are `left` and `right`, as in VRX. Others are `propeller_0`, `propeller_1`, …
    """
    propellers = vehicle.propellers
    if len(propellers) == 2 and propellers[0].position_frd_m[1] < 0.0 < propellers[1].position_frd_m[1]:
        return "left", "right"
    return tuple(f"propeller_{number}" for number in range(len(propellers)))


def motor_commands(profile: RunProfile, shares: bool) -> Iterator[tuple[str, Callable[[float], float]]]:
    """Yield the topic of each motor command in order, with a function from a message's number to a command in [-1, 1].

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
    """Return the motor command for a thrust at rest in N, limited to full speed."""
    full_n = ahead_n if newton >= 0.0 else astern_n
    return math.copysign(math.sqrt(min(abs(newton) / full_n, 1.0)), newton) if full_n > 0.0 else 0.0


def _limited(command: float) -> float:
    return min(max(command, -1.0), 1.0)
