"""One output while armed, on the way from its trim to its ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.sensing.settings import armed_rows
from xitl_cli.logs.signals import Series
from xitl_cli.logs.words.outputs import FIXED, function_name

_NO_PULSE_US = 500.0


@dataclass(frozen=True, slots=True)
class Output:
    """command: (N,) from -1 to 1 about trim, by SERVOn_MIN, _MAX, _TRIM and _REVERSED. armed: (N,)."""

    channel: int
    name: str
    function: int | None
    series: Series
    command: NDArray[np.float64]
    armed: NDArray[np.bool_]


def output_of(log: Log, channel: int, each: Series, parameters: Mapping[str, float]) -> Output | None:
    """None for one that drives nothing."""
    armed = armed_rows(log, each.stamp_ns)
    on = np.ones(len(each.stamp_ns), dtype=np.bool_) if armed is None else armed
    if each.unit != "us":
        if not each.values.any():
            return None
        return Output(channel, f"motor {channel}", None, each, each.values, on)
    function = parameters.get(f"SERVO{channel}_FUNCTION")
    if function is None and any(name.endswith("_FUNCTION") and name.startswith("SERVO") for name in parameters):
        return None
    if function is not None and (int(function) in FIXED or int(function) <= 0):
        return None
    low, high = parameters.get(f"SERVO{channel}_MIN", 1100.0), parameters.get(f"SERVO{channel}_MAX", 1900.0)
    if f"SERVO{channel}_MAX" not in parameters and ((each.values > high).any() or (_pulses(each) < low).any()):
        low, high = 1000.0, 2000.0
    trim = parameters.get(f"SERVO{channel}_TRIM", 1500.0)
    if not low < trim < high:
        trim = 0.5 * (low + high)
    pulse = np.where(each.values < _NO_PULSE_US, np.nan, each.values)
    if not np.isfinite(pulse).any() or not high > low:
        return None
    offset = pulse - trim
    command = np.where(offset >= 0.0, offset / (high - trim), offset / (trim - low))
    if parameters.get(f"SERVO{channel}_REVERSED", 0.0) > 0.0:
        command = -command
    name = f"output {channel}" if function is None else f"output {channel} ({function_name(int(function))})"
    return Output(channel, name, None if function is None else int(function), each, command, on)


def _pulses(each: Series) -> NDArray[np.float64]:
    """(M,) without the rows that hold no pulse."""
    return each.values[each.values >= _NO_PULSE_US]
