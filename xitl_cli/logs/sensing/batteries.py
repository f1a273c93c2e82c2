"""Batteries of a log, whichever format and message they are in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.sensing.columns import labelled, numbers, stamps, tables_of
from xitl_cli.logs.table import Table, by_instance

_UNKNOWN_MV = 65535.0
_NO_BOAT_V = 900.0


@dataclass(frozen=True, slots=True)
class Battery:
    """All (N,), NaN where not known; None where not logged. number counts from 1, as in BATT2_…."""

    name: str
    message: str
    number: int
    stamp_ns: NDArray[np.int64]
    voltage_v: NDArray[np.float64]
    voltage_field: str
    current_a: NDArray[np.float64] | None
    used_mah: NDArray[np.float64] | None
    remaining_percent: NDArray[np.float64] | None
    resistance_ohm: NDArray[np.float64] | None
    healthy: NDArray[np.bool_] | None


def batteries(log: Log) -> list[Battery]:
    """Every instance that ever shows a voltage. Of telemetry BATTERY_STATUS, or else SYS_STATUS."""
    found: list[Battery] = []
    for kinds in (("BAT", "BAT2"), ("CURR", "CUR2"), ("BATTERY_STATUS",), ("SYS_STATUS",)):
        for table in tables_of(log, kinds):
            for number, each in by_instance(table).items():
                battery = _told(table, each, number) if kinds[0].endswith("_STATUS") else _logged(table, each, number)
                if battery is not None and (np.nan_to_num(battery.voltage_v) > 0.0).any():
                    found.append(battery)
        if found:
            return found
    return found


def _logged(table: Table, each: Table, number: int) -> Battery | None:
    voltage = numbers(each, "Volt")
    if voltage is None or not np.isfinite(voltage).any():
        return None
    if np.nanmedian(voltage) > _NO_BOAT_V:
        voltage = voltage * 0.01  # logs of before 2016 hold hundredths, without saying so
    healthy = numbers(each, "H", raw=True)
    return Battery(
        name=labelled(table, number),
        message=table.name,
        number=number + (2 if table.name.endswith("2") else 1),
        stamp_ns=stamps(each),
        voltage_v=voltage,
        voltage_field="Volt",
        current_a=numbers(each, "Curr"),
        used_mah=numbers(each, "CurrTot", raw=True),
        remaining_percent=numbers(each, "RemPct"),
        resistance_ohm=numbers(each, "Res"),
        healthy=None if healthy is None else healthy > 0.0,
    )


def _told(table: Table, each: Table, number: int) -> Battery | None:
    """MAVLink: mV with 65535 unknown, cA and % with -1 unknown."""
    name = "voltages" if "voltages" in each.columns else "voltage_battery"
    millivolts = numbers(each, name, raw=True)
    if millivolts is None:
        return None
    cells = np.where(millivolts >= _UNKNOWN_MV, np.nan, millivolts).reshape(len(millivolts), -1)
    known = np.isfinite(cells).any(axis=1)
    current = numbers(each, "current_battery", raw=True)
    used = numbers(each, "current_consumed", raw=True)
    remaining = numbers(each, "battery_remaining", raw=True)
    return Battery(
        name=labelled(table, number),
        message=table.name,
        number=number + 1,
        stamp_ns=stamps(each),
        voltage_v=np.where(known, np.nansum(cells, axis=1) * 1e-3, np.nan),
        voltage_field=name,
        current_a=None if current is None else np.where(current < 0.0, np.nan, current * 1e-2),
        used_mah=None if used is None else np.where(used < 0.0, np.nan, used),
        remaining_percent=None if remaining is None else np.where(remaining < 0.0, np.nan, remaining),
        resistance_ohm=None,
        healthy=None,
    )
