"""Recorded pulse widths, read from a table or from a log.

A table has the columns `time_s` (or `TimeUS`) and C1, C2, … in µs, as `mavlogdump.py --format csv --types RCOU` writes
it. The source in a DataFlash log is RCOU, in telemetry and MCAP SERVO_OUTPUT_RAW or RCOU, and in a bag the topic rc/out
of MAVROS. The log also gives the time of arming and the functions of the outputs. A recording of xitl contains
commands, which become pulses of 1500 ± 400 µs.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import field
from io import StringIO
from pathlib import Path

import numpy as np

import xitl_cli.logs.signals as signals
from agent.files import read_bytes
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.signals.states import parameter_values

MOST_BYTES = 256 << 20
NO_PULSE_US = 0.0
SHORTEST_US, LONGEST_US = 500.0, 2500.0
"""Range of a servo output that is not off (0)."""

_TIMES = {"time_s": 1.0, "timeus": 1e-6}
_OUTPUT = re.compile(r"c([1-9][0-9]?)")
_SHAPE = "write time_s,C1,C3 (seconds, then one column for each output in µs)"
_FUNCTION = re.compile(r"SERVO([0-9]{1,2})_FUNCTION")
_CHANNEL = re.compile(r"C([0-9]{1,2})")
_COMMAND_TRIM_US, _COMMAND_SPAN_US = 1500.0, 400.0  # defaults of driver.replay, which reverse the conversion
_PAIR = (73, 74)  # SERVOn_FUNCTION: left and right throttle


@dataclass(frozen=True, slots=True)
class PulseLog:
    """Pulse widths of output channels over time."""

    source: str
    """The file, for messages."""
    at_s: tuple[float, ...]
    """Rising instants on the recording's clock, (M,)."""
    pulses_us: Mapping[int, tuple[float, ...]]
    """By channel number, (M,) each; 0 is no pulse."""
    armed_s: float | None = None
    """Time of arming; None when the recording does not have it."""
    functions: Mapping[int, int] = field(default_factory=dict)
    """ArduPilot's function of each channel (SERVOn_FUNCTION); empty when the recording has none."""


def is_pulse(pulse_us: float) -> bool:
    """Whether the value is possible for an output; False for NaN."""
    return pulse_us == NO_PULSE_US or SHORTEST_US <= pulse_us <= LONGEST_US


def read_pulse_log(path: Path) -> PulseLog:
    """Read the log (`.bin`, `.tlog`, `.mcap`, a bag) or the table at `path`.

    Raises UserError with the problem in it.
    """
    if path.suffix.lower() == ".bin":
        return read_dataflash(path)
    return read_recording(path) if path.suffix.lower() == ".tlog" or holds_messages(path) else read_csv(path)


def holds_messages(path: Path) -> bool:
    """Whether the path is a recording or a bag, by its name. A ROS 2 bag is a folder."""
    return path.suffix.lower() in (".mcap", ".bag", ".db3") or path.is_dir()


def read_csv(path: Path) -> PulseLog:
    """Read the table. Lines that begin with # are comments, and columns with other names are ignored.

    Raises UserError with file, line and column.
    """
    try:
        text = read_bytes(path, MOST_BYTES).decode("utf-8-sig")
        return _read_table(_table_rows(StringIO(text, newline="")), str(path))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except UnicodeDecodeError:
        raise UserError(f"{path} is not text; use a table of comma-separated values, or a .bin log") from None
    except csv.Error as error:
        raise UserError(f"{path}: is no table of comma-separated values ({error}); {_SHAPE}") from None


def _table_rows(lines: Iterator[str]) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, cells) of each line that is not empty."""
    numbers: list[int] = []

    def uncommented() -> Iterator[str]:
        for number, line in enumerate(lines, start=1):
            if line.strip() and not line.lstrip().startswith("#"):
                numbers.append(number)
                yield line

    for row in csv.reader(uncommented(), skipinitialspace=True):
        yield numbers[-1], [cell.strip() for cell in row]


def _read_table(rows: Iterator[tuple[int, list[str]]], source: str) -> PulseLog:
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
                f"{source}:{line}: has {len(cells)} columns, but the first line has {len(names)}; write as many"
            )
        now_s = _number(cells[columns[time_name]], names[columns[time_name]], f"{source}:{line}") * _TIMES[time_name]
        if at_s and now_s <= at_s[-1]:
            raise UserError(
                f"{source}:{line}: column {names[columns[time_name]]}: {now_s:g} s is not after the line before "
                f"({at_s[-1]:g} s); sort the lines by time"
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
        raise UserError(f"{source}:{line}: no data follows the names of the columns; add a line for each instant")
    return PulseLog(source, tuple(at_s), {channel: tuple(values) for channel, values in pulses.items()})


def _number(cell: str, column: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f"{where}: column {column}: {cell[:40]!r} is not a number; write a finite number")
    return value


def read_dataflash(path: Path) -> PulseLog:
    """Read RCOU (channels 1 to 14) from the .bin log of any ArduPilot vehicle or of the embedded autopilot.

    A record that jumps back in time is dropped. Raises UserError when the file is no log or has no outputs.
    """
    try:
        opened = DataFlashLog(path)
    except LogError as error:
        raise UserError(str(error)) from error
    with opened as log:
        outputs = log.tables.get("RCOU")
        if outputs is None or "TimeUS" not in outputs.columns:
            raise UserError(f"{path} has no motor outputs (RCOU); record a log with bit RC OUT of LOG_BITMASK")
        at_us = outputs.stamp_ns // 1000
        rising = np.flatnonzero(np.diff(np.maximum.accumulate(at_us), prepend=-1) > 0)
        channels = {int(match[1]): name for name in outputs.columns if (match := _CHANNEL.fullmatch(name))}
        pulses = {
            channel: tuple(
                pulse if is_pulse(pulse) else 0.0
                for pulse in outputs.values(name, rising, raw=True).astype(np.float64).tolist()
            )
            for channel, name in channels.items()
            if outputs.columns[name].kind == "number" and not outputs.columns[name].shape
        }
        at_s = tuple((at_us[rising] * 1e-6).tolist())
        arming, armed_s = log.tables.get("ARM"), None
        if arming is not None and {"TimeUS", "ArmState"} <= arming.columns.keys():
            armed = np.flatnonzero(arming.values("ArmState", raw=True) == 1)
            if len(armed):
                armed_s = int(arming.stamp_ns[armed[0]]) // 1000 * 1e-6
        functions = {}
        table = log.tables.get("PARM")
        if table is not None and {"Name", "Value"} <= table.columns.keys() and table.columns["Value"].kind == "number":
            values = table.values("Value", raw=True).tolist()
            for name, value in zip(table.values("Name").tolist(), values, strict=True):
                match = _FUNCTION.fullmatch(str(name))
                if match and np.isfinite(value):
                    functions[int(match[1])] = int(value)
        return PulseLog(str(path), at_s, pulses, armed_s, functions)


def read_recording(path: Path) -> PulseLog:
    """Read outputs of telemetry or of an MCAP file, in seconds since the log's zero. Raises UserError without any."""
    try:
        opened = open_log(path)
    except LogError as error:
        raise UserError(str(error)) from error
    with opened as log:
        outputs, functions = signals.outputs(log), output_functions(log)
        if not outputs:
            raise UserError(
                f"{path} has no servo outputs; use a log with RCOU or SERVO_OUTPUT_RAW, or a bag with mavros/rc/out"
            )
        stamp_ns = max((series.stamp_ns for series in outputs.values()), key=len)
        commands = all(not series.unit for series in outputs.values())
        pulses = {}
        for channel, series in outputs.items():
            active = np.clip(np.searchsorted(series.stamp_ns, stamp_ns, side="right") - 1, 0, None)
            values = series.values[active]
            pulses[channel] = _COMMAND_TRIM_US + _COMMAND_SPAN_US * values if commands else values
        armed = signals.armed(log)
        return PulseLog(
            str(path),
            tuple(((stamp_ns - log.zero_ns) * 1e-9).tolist()),
            {
                channel: tuple(pulse if is_pulse(pulse) else NO_PULSE_US for pulse in values.tolist())
                for channel, values in pulses.items()
            },
            (armed[0].from_ns - log.zero_ns) * 1e-9 if armed else None,
            functions,
        )


def output_functions(log: Log) -> dict[int, int]:
    """Return SERVOn_FUNCTION by channel if the log has it.

    A recording of xitl with two propellers gets those of a pair.
    """
    functions = {
        int(match[1]): int(value)
        for name, value in parameter_values(log).items()
        if (match := _FUNCTION.fullmatch(name)) and value.is_integer()
    }
    if not functions and list(signals.output_names(log).values()) == ["propeller 0", "propeller 1"]:
        return dict(zip((1, 2), _PAIR, strict=True))
    return functions
