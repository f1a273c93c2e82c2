"""Condition of actuators and battery: what is fouled, stuck, wired the wrong way round or worn.

A propeller that lost thrust turns as it is commanded and gives a share of its force. One wired the wrong way round
turns against its command. A stuck propeller, gear or rudder goes to a command and stays there, whatever it is told.

    condition = make_condition(model, [ActuatorFault("propeller 0", thrust_loss=0.4)], [])
    state = replace(state, condition=condition)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from sim_core.frames import Array
from sim_core.vessel.battery import BatteryCondition
from sim_core.vessel.spec import VesselSpec


@dataclass(frozen=True, slots=True)
class ActuatorFault:
    """What is wrong with one actuator of a vessel.

    actuator: its name (`VesselSpec.command_names`). thrust_loss: share of a propeller's thrust. held_at: the share of
    full speed or angle that it stays at, None where it obeys. reversed: it does the opposite of its command.
    """

    actuator: str
    thrust_loss: float = 0.0
    held_at: float | None = None
    reversed: bool = False


@dataclass(frozen=True, slots=True)
class BatteryFault:
    """What is wrong with a vessel's battery; failed_cells: of those in series."""

    added_resistance_ohm: float = 0.0
    failed_cells: int = 0
    voltage_drop_v: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """Of N vessels with C commands and P propellers.

    sign: (N, C) of each command. held_at: (N, C) command in place of what comes, NaN where that counts. thrust_share:
    (N, P) what is left of each thrust.
    """

    sign: Array
    held_at: Array
    thrust_share: Array
    battery: BatteryCondition

    def actual(self, command: Array) -> Array:
        """(N, C): what the actuators follow, for (N, C) or (1, C) commands."""
        actual: Array = np.where(np.isnan(self.held_at), self.sign * command, self.held_at)
        return actual


def make_condition(
    model: VesselSpec, actuators: Sequence[ActuatorFault], batteries: Sequence[BatteryFault]
) -> Condition | None:
    """Of one vessel (N = 1); None where nothing is wrong.

    Losses each take their share of what the others leave, of several that hold an actuator the last one counts, and
    resistances, cells and drops add up. Raises ValueError for an actuator that the vessel does not have.
    """
    if not actuators and not batteries:
        return None
    names = model.command_names
    sign, held_at, share = np.ones((1, len(names))), np.full((1, len(names)), math.nan), np.ones((1, len(names)))
    for fault in actuators:
        if fault.actuator not in names:
            raise ValueError(f"{model.name} has no {fault.actuator!r}; use {', '.join(names)}")
        column = names.index(fault.actuator)
        share[0, column] *= 1.0 - fault.thrust_loss
        if fault.reversed:
            sign[0, column] *= -1.0
        if fault.held_at is not None:
            held_at[0, column] = fault.held_at
    cells = 1 if model.battery is None else model.battery.cells
    failed = min(sum(fault.failed_cells for fault in batteries), cells)
    battery = BatteryCondition(
        added_resistance_ohm=np.array([math.fsum(fault.added_resistance_ohm for fault in batteries)]),
        cell_share=np.array([1.0 - failed / cells]),
        voltage_drop_v=np.array([math.fsum(fault.voltage_drop_v for fault in batteries)]),
    )
    return Condition(sign, held_at, share[:, : len(model.propellers)], battery)


def healthy(model: VesselSpec, vessels: int) -> Condition:
    """Of N vessels with nothing wrong: for those beside one that has."""
    commands, propellers = model.commands, len(model.propellers)
    battery = BatteryCondition(np.zeros(vessels), np.ones(vessels), np.zeros(vessels))
    free = np.full((vessels, commands), math.nan)
    return Condition(np.ones((vessels, commands)), free, np.ones((vessels, propellers)), battery)


def with_row(condition: Condition, row: int, own: Condition) -> Condition:
    """`condition` of N vessels with that of one in its row."""

    def put(values: Array, value: Array) -> Array:
        changed = values.copy()
        changed[row] = value[0]
        return changed

    battery = BatteryCondition(
        *(put(getattr(condition.battery, each.name), getattr(own.battery, each.name)) for each in fields(own.battery))
    )
    return Condition(
        put(condition.sign, own.sign),
        put(condition.held_at, own.held_at),
        put(condition.thrust_share, own.thrust_share),
        battery,
    )
