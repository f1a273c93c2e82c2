"""QGroundControl's parameter files, also used for PX4: vehicle, component, name, value and type, separated by tabs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from datetime import UTC, datetime

from agent.mavlink.exchange import Target
from agent.mavlink.parameter_rows import ParameterError

SUFFIX = ".params"
COLUMNS = ("Vehicle-Id", "Component-Id", "Name", "Value", "Type")
AUTOPILOT_COMPONENT = 1
REAL32 = 9  # MAV_PARAM_TYPE
_REALS = (REAL32, 10)
_BITS = {1: (0, 8), 2: (1, 7), 3: (0, 16), 4: (1, 15), 5: (0, 32), 6: (1, 31), 7: (0, 64), 8: (1, 63)}
"""For each whole-number type: 1 with a sign, and the number of other bits."""


def is_station_file(text: str) -> bool:
    """Whether the first line that is no comment has five columns, with whole numbers in 1, 2 and 5."""
    rows = (line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#"))
    first = next(rows, [])
    return len(first) == len(COLUMNS) and all(first[number].isdecimal() for number in (0, 1, 4))


def load_station_file(text: str, source: str) -> dict[str, float]:
    """Return names and values of the autopilot. Other components are ignored, and the last value of a name counts.

    Raises ParameterError with file and line.
    """
    values: dict[str, float] = {}
    for line, raw in enumerate(text.splitlines(), start=1):
        fields = raw.split()
        if not fields or fields[0].startswith("#"):
            continue
        where = f"{source}:{line}"
        if len(fields) != len(COLUMNS) or not all(fields[number].isdecimal() for number in (0, 1, 4)):
            raise ParameterError(f"{where}: expected {' '.join(COLUMNS)}, found {raw.strip()[:60]!r}")
        if int(fields[1]) == AUTOPILOT_COMPONENT:
            values[fields[2].upper()] = _value(f"{where}: {fields[2]}", fields[3], int(fields[4]))
    if not values and text.strip():
        raise ParameterError(f"{source}: has no parameter of an autopilot (component {AUTOPILOT_COMPONENT})")
    return values


def _value(what: str, text: str, kind: int) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ParameterError(f"{what} = {text[:40]!r} is not a number") from None
    if not math.isfinite(value):
        raise ParameterError(f"{what} = {text} is not a finite number")
    if kind in _REALS:
        return value
    if kind not in _BITS:
        raise ParameterError(f"{what} has type {kind}, which is none (MAV_PARAM_TYPE: 6 whole, 9 real)")
    signed, bits = _BITS[kind]
    if value != int(value) or not -signed * 2**bits <= value < 2**bits:
        raise ParameterError(f"{what} = {text} is no value of its type {kind}; use a whole number that it holds")
    return value


def station_file_text(
    values: Mapping[str, float],
    types: Mapping[str, int],
    target: Target,
    source: str,
    format_value: Callable[[float], str],
    now: datetime | None = None,
) -> str:
    """Return a file with a vehicle's parameters; a name without a type is a real number."""
    stamp = (now or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC")
    lines = [
        f"# Onboard parameters for Vehicle {target[0]}",
        f"# {len(values)} parameters of {source}, {stamp}",
        "#",
        f"# {' '.join(COLUMNS)}",
    ]
    for name, value in sorted(values.items()):
        kind = types.get(name, REAL32)
        text = format_value(value) if kind in _REALS else str(int(value))
        lines.append("\t".join((str(target[0]), str(target[1]), name, text, str(kind))))
    return "\n".join(lines) + "\n"
