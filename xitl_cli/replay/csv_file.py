"""Pulse widths from a table: `time_s` (or `TimeUS`) and C1, C2, … in µs.

`mavlogdump.py --format csv --types RCOU` writes such a table.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator
from pathlib import Path

from xitl_cli.errors import UserError
from xitl_cli.replay.pulses import LONGEST_US, SHORTEST_US, PulseLog, is_pulse

_TIMES = {"time_s": 1.0, "timeus": 1e-6}
_OUTPUT = re.compile(r"c([1-9][0-9]?)")
_SHAPE = "write time_s,C1,C3 (seconds, then one column for each output in µs)"


def read_csv(path: Path) -> PulseLog:
    """Read the table; lines that begin with # are comments, columns of other names are passed over.

    Raises UserError with file, line and column.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return _read(file_rows(file), str(path))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not text; give a table of comma-separated values, or a .bin log") from None
    except csv.Error as error:
        raise UserError(f"{path}: is no table of comma-separated values ({error}); {_SHAPE}") from None


def file_rows(lines: Iterator[str]) -> Iterator[tuple[int, list[str]]]:
    """(line number, cells) of each line that holds any."""
    kept: list[int] = []

    def uncommented() -> Iterator[str]:
        for number, line in enumerate(lines, start=1):
            if line.strip() and not line.lstrip().startswith("#"):
                kept.append(number)
                yield line

    for row in csv.reader(uncommented(), skipinitialspace=True):
        yield kept[-1], [cell.strip() for cell in row]


def _read(rows: Iterator[tuple[int, list[str]]], source: str) -> PulseLog:
    first = next(rows, None)
    if first is None:
        raise UserError(f"{source}: is empty; {_SHAPE}")
    line, names = first
    columns = {name.lower(): number for number, name in enumerate(names)}
    time_name = next((name for name in _TIMES if name in columns), None)
    outputs = {int(match[1]): number for name, number in columns.items() if (match := _OUTPUT.fullmatch(name))}
    if time_name is None:
        raise UserError(f"{source}:{line}: has no column time_s; {_SHAPE}")
    if not outputs:
        raise UserError(f"{source}:{line}: has no column of an output; {_SHAPE}")
    at_s: list[float] = []
    pulses: dict[int, list[float]] = {channel: [] for channel in sorted(outputs)}
    for line, cells in rows:
        if len(cells) != len(names):
            raise UserError(
                f"{source}:{line}: has {len(cells)} columns where the first line names {len(names)}; give as many"
            )
        now_s = _number(cells[columns[time_name]], names[columns[time_name]], f"{source}:{line}") * _TIMES[time_name]
        if at_s and now_s <= at_s[-1]:
            raise UserError(
                f"{source}:{line}: column {names[columns[time_name]]}: {now_s:g} s is not after the line before "
                f"({at_s[-1]:g} s); put the lines in order of time"
            )
        at_s.append(now_s)
        for channel, values in pulses.items():
            name = names[outputs[channel]]
            pulse = _number(cells[outputs[channel]], name, f"{source}:{line}")
            if not is_pulse(pulse):
                raise UserError(
                    f"{source}:{line}: column {name}: {pulse:g} is no pulse width; "
                    f"use {SHORTEST_US:g} to {LONGEST_US:g} µs, or 0 for none"
                )
            values.append(pulse)
    if not at_s:
        raise UserError(f"{source}:{line}: has no line below its names; add one for each instant")
    return PulseLog(source, tuple(at_s), {channel: tuple(values) for channel, values in pulses.items()})


def _number(cell: str, column: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f"{where}: column {column}: {cell[:40]!r} is not a number; write a finite number")
    return value
