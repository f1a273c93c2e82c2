"""Condition of actuators and battery: fouled, stuck, reversed or worn parts.

A propeller with lost thrust turns as commanded and gives a share of its force. A propeller with reversed wiring turns
against its command. A stuck propeller, gear or rudder moves to a fixed command and ignores all others.

    condition = make_condition(model, [ActuatorFault("propeller 0", thrust_loss=0.4)], [])
    state = replace(state, condition=condition)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.vessel.battery import BatteryCondition
from sim_core.vessel.spec import VesselSpec


@dataclass(frozen=True, slots=True)
class ActuatorFault:
    """Fault of one actuator of a vessel."""

    actuator: str
    """Name of the actuator (`VesselSpec.command_names`)."""
    thrust_loss: float = 0.0
    """Lost share of a propeller's thrust."""
    held_at: float | None = None
    """Fixed share of full speed or angle, None if the actuator obeys."""
    reversed: bool = False
    """The actuator does the opposite of its command."""


@dataclass(frozen=True, slots=True)
class BatteryDamage:
    """Fault of a vessel's battery."""

    added_resistance_ohm: float = 0.0
    failed_cells: int = 0
    """Number of failed cells in series."""
    voltage_drop_v: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """Condition of N vessels with C commands and P propellers."""

    sign: Array
    """Sign of each command, (N, C)."""
    held_at: Array
    """Command that replaces the received one, (N, C), NaN for none."""
    thrust_share: Array
    """Remaining share of each thrust, (N, P)."""
    battery: BatteryCondition

    def actual(self, command: Array) -> Array:
        """Return the (N, C) commands that the actuators follow, for (N, C) or (1, C) commands."""
        actual: Array = np.where(np.isnan(self.held_at), self.sign * command, self.held_at)
        return actual


def make_condition(
    model: VesselSpec, actuators: Sequence[ActuatorFault], batteries: Sequence[BatteryDamage]
) -> Condition | None:
    """Return the condition of one vessel (N = 1), None for no fault.

    Several losses multiply: each takes its share of the remainder. If several faults hold an actuator, the last one
    counts. Resistances, cells and drops add up. Raises ValueError for an actuator that the vessel does not have.
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
    """Return the condition of N vessels without faults, for batches that contain a faulty vessel."""
    commands, propellers = model.commands, len(model.propellers)
    battery = BatteryCondition(np.zeros(vessels), np.ones(vessels), np.zeros(vessels))
    free = np.full((vessels, commands), math.nan)
    return Condition(np.ones((vessels, commands)), free, np.ones((vessels, propellers)), battery)


def with_row(condition: Condition, row: int, own: Condition) -> Condition:
    """Return `condition` of N vessels with one vessel's condition in its row."""

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
