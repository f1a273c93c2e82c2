"""Units of results: m/s times s is m. "" means unknown; None is the unit of a plain number, which fits any unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TypeAlias

Unit: TypeAlias = str | None

_FACTOR = re.compile(r"(?P<symbol>[A-Za-zµ°%]+)\^?(?P<power>[²³]|\d)?")
_RAISED = {"²": 2, "³": 3}
_SHOWN = {1: "", 2: "²", 3: "³"}


def same_unit(units: Sequence[Unit]) -> Unit:
    """Unit of a sum, a choice or a distance: the common unit of all."""
    known = [unit for unit in units if unit is not None]
    if not known:
        return None
    return known[0] if len(set(known)) == 1 else ""


def product_unit(left: Unit, right: Unit, power: int = 1) -> Unit:
    """Unit of left times right to the power of 1 or -1."""
    if right is None:
        return left
    divisor = _powers(right)
    factors = {} if left is None else _powers(left)
    if factors is None or divisor is None:
        return ""
    return _text({name: factors.get(name, 0) + power * divisor.get(name, 0) for name in {**factors, **divisor}})


def power_unit(unit: Unit, exponent: float) -> Unit:
    """Unit of a quantity to a power; "" if the powers are not whole."""
    if unit is None:
        return None
    factors = _powers(unit)
    if factors is None:
        return ""
    raised = {name: power * exponent for name, power in factors.items()}
    powers = raised.values()
    return (
        _text({name: round(power) for name, power in raised.items()})
        if all(float(power).is_integer() for power in powers)
        else ""
    )


def _powers(unit: str) -> dict[str, int] | None:
    """Powers of base units: {"m": 1, "s": -2} for "m/s/s". None if the unit is no such product, or is empty."""
    if not unit:
        return None
    powers: dict[str, int] = {}
    for number, part in enumerate(unit.split("/")):
        for factor in re.split(r"[.·*]", part):
            if number == 0 and factor == "1":
                continue
            found = _FACTOR.fullmatch(factor)
            if found is None:
                return None
            power = _RAISED.get(found["power"] or "", 0) or int(found["power"] or 1)
            powers[found["symbol"]] = powers.get(found["symbol"], 0) + (power if number == 0 else -power)
    return powers


def _text(powers: dict[str, int]) -> str:
    """Unit in the notation of logs: m/s/s."""
    above = [f"{name}{_SHOWN.get(power, f'^{power}')}" for name, power in powers.items() if power > 0]
    below = [f"/{name}" * -power for name, power in powers.items() if power < 0]
    return ".".join(above) + "".join(below) if above else "1" + "".join(below) if below else ""
