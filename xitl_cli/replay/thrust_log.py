"""Motor commands from the commands of nodes to thrusters: topics `thrusters/*/cmd` and `pos` of a bag."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from sim_core.vessel.spec import VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Table
from xitl_cli.profile.schema import RunProfile

_ALSO_CALLED = {"/cmd": "/thrust"}  # in VRX


@dataclass(frozen=True, slots=True)
class ThrustLog:
    """Motor commands of a bag."""

    source: str
    at_s: NDArray[np.float64]
    """Rising instants on the recording's clock, (N,)."""
    commands: NDArray[np.float64]
    """(N, k) in [-1, 1], in the vessel's order; 0 until the first message."""


def read_thrust_log(path: Path, profile: RunProfile) -> ThrustLog | None:
    """Return the commands to the profile's thrusters; None for a log with servo outputs, or without such a topic.

    Raises UserError with the problem in the file.
    """
    try:
        with open_log(path) as log:
            return None if signals.outputs(log) else _read(log, profile)
    except LogError as error:
        raise UserError(str(error)) from error


def _read(log: Log, profile: RunProfile) -> ThrustLog | None:
    named = list(motor_commands(profile, profile.driver.replay.thrust == "share"))
    tables = [_topic(log, topic) for topic, _ in named]
    present = [table for table in tables if table is not None]
    if not present:
        return None
    stamp_ns = np.unique(np.concatenate([table.stamp_ns for table in present]))
    commands = np.zeros((len(stamp_ns), len(named)))
    for number, (table, (topic, command)) in enumerate(zip(tables, named, strict=True)):
        if table is None:
            continue
        values = table.values("data").astype(np.float64)
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            at_s = (int(table.stamp_ns[row]) - log.zero_ns) * 1e-9
            raise UserError(f"{log.path}: {topic} is {values[row]:g} at {at_s:.3f} s; use a bag with finite commands")
        order = np.argsort(table.stamp_ns, kind="stable")
        steps = np.array([0.0, *(command(value) for value in values[order].tolist())])
        commands[:, number] = steps[np.searchsorted(table.stamp_ns[order], stamp_ns, side="right")]
    return ThrustLog(str(log.path), (stamp_ns - log.zero_ns) * 1e-9, commands)


def _topic(log: Log, topic: str) -> Table | None:
    """Return the topic with this ending. Raises UserError when several have it."""
    before, slash, last = topic.rpartition("/")
    endings = (f"/{topic}", f"/{before}{_ALSO_CALLED.get(slash + last, slash + last)}")
    names = [name for name, table in log.tables.items() if name.endswith(endings) and "data" in table.columns]
    if len(names) > 1:
        raise UserError(f"{log.path} has {' and '.join(names)}; use a bag of one vessel, such as from `rosbag filter`")
    return log.tables[names[0]] if names else None


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
        (name, propeller.steering.max_angle_deg)
        for name, propeller in zip(names, vehicle.propellers, strict=True)
        if propeller.steering is not None
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
