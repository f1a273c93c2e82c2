"""Magnetometers, barometers, rangefinders and the rest: series with a rate, a health flag, values that may stick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.sensing.columns import labelled, numbers, stacked, stamps, tables_of
from xitl_cli.logs.sensing.inertial import sample_clock
from xitl_cli.logs.table import Table, by_instance, first_of

Sort = Literal["magnetometer", "barometer", "rangefinder", "airspeed", "wind", "AHRS"]


@dataclass(frozen=True, slots=True)
class Plain:
    """values: (N, k) in `unit`. healthy: (N,) by the autopilot. stamps as of an inertial unit."""

    name: str
    sort: Sort
    message: str
    fields: tuple[str, ...]
    unit: str
    stamp_ns: NDArray[np.int64]
    sample_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    healthy: NDArray[np.bool_] | None
    temperature_degc: NDArray[np.float64] | None


@dataclass(frozen=True, slots=True)
class _Message:
    kind: str
    sort: Sort
    fields: tuple[tuple[str, ...], ...]
    unit: str
    health: tuple[str, ...] = ()
    temperature: tuple[str, ...] = ()
    raw: bool = False  # logged in whole mGauss
    factor: float = 1.0


_MAG = (("MagX", "MagY", "MagZ"),)
_MESSAGES = (
    *(_Message(kind, "magnetometer", _MAG, "mGauss", ("Health",), raw=True) for kind in ("MAG", "MAG2", "MAG3")),
    _Message("XITL_MAGNETOMETER", "magnetometer", (("field",),), "mGauss", factor=1e3),
    *(
        _Message(kind, "barometer", (("Press",),), "Pa", ("H", "Health"), ("Temp",))
        for kind in ("BARO", "BAR2", "BAR3")
    ),
    _Message("XITL_BAROMETER", "barometer", (("pressure",),), "Pa", (), ("temperature",)),
    *(
        _Message(kind, "barometer", (("press_abs",),), "Pa", (), ("temperature",))
        for kind in ("SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3")
    ),
    _Message("RFND", "rangefinder", (("Dist",), ("Dist1",)), "m"),
    _Message("RNGF", "rangefinder", (("Dist",), ("Dist1",)), "m"),
    _Message("DPTH", "rangefinder", (("Depth",),), "m"),
    _Message("DISTANCE_SENSOR", "rangefinder", (("current_distance",),), "m"),
    _Message("RANGEFINDER", "rangefinder", (("distance",),), "m"),
    _Message("ARSP", "airspeed", (("DiffPress",), ("Airspeed",)), "", ("H",), ("Temp",)),
    _Message("WIND", "wind", (("SpdRaw", "DrRaw"), ("SpdApp", "DrApp")), ""),
    _Message("EAHR", "AHRS", (("Roll", "Pitch", "Yaw"),), "deg"),
    _Message("VNKF", "AHRS", (("Lat", "Lon", "Alt"),), ""),
    _Message("VNAT", "AHRS", (("Q1", "Q2", "Q3", "Q4"),), ""),
)


def sensors(log: Log) -> list[Plain]:
    """Every instance that has at least three rows and ever shows anything but zeros."""
    found: list[Plain] = []
    for message in _MESSAGES:
        for table in tables_of(log, (message.kind,)):
            for number, each in by_instance(table).items():
                names = next((names for names in message.fields if all(name in each.columns for name in names)), None)
                if len(each) < 3 or names is None:
                    continue
                values = _values(each, names, message)
                if values is None or not np.nan_to_num(values).any():
                    continue
                health = first_of(each, message.health)
                flags = None if health is None else numbers(each, health, raw=True)
                warmth = first_of(each, message.temperature)
                clock = sample_clock(each)
                found.append(
                    Plain(
                        name=labelled(table, number),
                        sort=message.sort,
                        message=table.name,
                        fields=names,
                        unit=message.unit or each.columns[names[0]].unit,
                        stamp_ns=stamps(each),
                        sample_ns=stamps(each) if clock is None else clock,
                        values=values.reshape(len(values), -1),
                        healthy=None if flags is None else flags > 0.0,
                        temperature_degc=None if warmth is None else numbers(each, warmth),
                    )
                )
    return found


def _values(table: Table, names: tuple[str, ...], message: _Message) -> NDArray[np.float64] | None:
    if len(names) == 1:
        found = numbers(table, names[0], raw=message.raw)
        return None if found is None else found * message.factor
    return stacked(table, names, raw=message.raw)
