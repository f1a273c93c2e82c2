"""Rows of a table of parameters with name, default, range, unit, meaning and type, and ArduPilot's .parm files."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9  # MAV_PARAM_TYPE; ArduPilot has no others


class Parameter(NamedTuple):
    """One row of the table."""

    name: str
    default: float
    low: float
    """Inclusive. Equal to `high` for a constant."""
    high: float
    """Inclusive."""
    unit: str
    meaning: str
    type: int = REAL32
    """MAV_PARAM_TYPE. All types except REAL32 are integers."""
    choices: tuple[int, ...] = ()
    """The only valid values, empty if the whole range is valid."""

    @property
    def fixed(self) -> bool:
        """Whether it cannot be set."""
        return self.low == self.high

    def nearest(self, value: float) -> float:
        """Return the nearest value in range."""
        return min(max(value, self.low), self.high)


class ParameterError(ValueError):
    """Raised for a refused parameter or parameter file. The message says what, where and how to fix it."""


def within(row: Parameter, value: float) -> float:
    """Return the value as a row of a table stores it. Raises ParameterError for NaN or an invalid value."""
    whole = row.type != REAL32
    # A limit that was converted to a 32-bit float on the wire is still accepted.
    slack = 0.0 if whole else 1e-6 * max(1.0, abs(row.low), abs(row.high))
    unit = f" {row.unit}" if row.unit else ""
    if not row.low - slack <= value <= row.high + slack:
        if row.fixed:
            raise ParameterError(f"{row.name} = {value:g} is refused: it is {row.low:g}{unit} and cannot be set")
        raise ParameterError(f"{row.name} = {value:g} is out of range; use {row.low:g} to {row.high:g}{unit}")
    if whole and value != int(value):
        raise ParameterError(f"{row.name} = {value:g} is not a whole number; use {row.low:g} to {row.high:g}{unit}")
    if row.choices and value not in row.choices:
        known = ", ".join(map(str, (choice for choice in row.choices if row.low <= choice <= row.high)))
        raise ParameterError(f"{row.name} = {value:g} is not one of the choices; use one of {known}")
    return float(min(max(value, row.low), row.high))


def load_parm(text: str, source: str = "parameters") -> dict[str, float]:
    """Return names and values of an ArduPilot .parm text, not checked against the table.

    The last of a repeated name wins.

    A line is `NAME value` or `NAME,value`. A comment begins with `#`. Raises ParameterError with file and line.
    """
    return {name: value for _, name, value in parm_lines(text, source)}


def parm_lines(text: str, source: str) -> Iterator[tuple[int, str, float]]:
    """Yield (line number, name, value) of each line of a .parm text that sets a parameter."""
    for line, raw in enumerate(text.splitlines(), start=1):
        fields = raw.split("#", 1)[0].replace(",", " ").split()
        if not fields:
            continue
        if len(fields) != 2:
            raise ParameterError(f"{source}:{line}: expected NAME value, found {raw.strip()[:60]!r}")
        try:
            value = float(fields[1])
        except ValueError:
            raise ParameterError(f"{source}:{line}: {fields[0]} = {fields[1][:40]!r} is not a number") from None
        if not math.isfinite(value):
            raise ParameterError(f"{source}:{line}: {fields[0]} = {fields[1]} is not a finite number")
        yield line, fields[0].upper(), value
