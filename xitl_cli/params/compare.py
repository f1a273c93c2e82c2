"""What differs between two sets of parameters, and bringing a vehicle to one of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from xitl_cli.params.source import ParameterSet
from xitl_cli.params.text import same, shown
from xitl_cli.params.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class Difference:
    """One parameter on both sides; None where that side has no such parameter."""

    name: str
    one: float | None
    other: float | None


@dataclass(frozen=True, slots=True)
class Change:
    """What was asked of a vehicle and what it keeps; `reason` is empty when it took the value."""

    name: str
    wanted: float
    before: float | None
    kept: float | None
    reason: str = ""


def differences(one: ParameterSet, other: ParameterSet) -> list[Difference]:
    """By name. A name that only one side has counts where the other side would have to have it."""
    found: list[Difference] = []
    for name in sorted({*one.values, *other.values}):
        a, b = one.values.get(name), other.values.get(name)
        if a is not None and b is not None:
            if not same(a, b):
                found.append(Difference(name, a, b))
        elif (other if b is None else one).complete:
            found.append(Difference(name, a, b))
    return found


def push(
    vehicle: Vehicle, wanted: Mapping[str, float], present: Mapping[str, float], complete: bool = True
) -> list[Change]:
    """Set what differs from `present`, each read back. Nothing raises for a value that the vehicle refuses.

    `complete`: all that the vehicle has is in `present`; else what is not there was asked for in vain.
    """
    changes: list[Change] = []
    for name, value in wanted.items():
        before = present.get(name)
        if before is None:
            said = f": {vehicle.texts[-1]}" if vehicle.texts else "; it may have no such parameter"
            reason = "the vehicle has no such parameter" if complete else f"the vehicle does not answer for it{said}"
            changes.append(Change(name, value, None, None, reason))
        elif not same(before, value):
            answer = vehicle.set(name, value)
            if answer.took(value):
                changes.append(Change(name, value, before, answer.kept))
                continue
            kept = "does not answer" if answer.kept is None else f"keeps {shown(answer.kept)}"
            said = f": {answer.texts[-1]}" if answer.texts else ""
            changes.append(Change(name, value, before, answer.kept, f"the vehicle {kept}{said}"))
    return changes
