"""From the units of the MAVLink definitions to those of a log's columns, and the values that stand for "not known"."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple


class Scale(NamedTuple):
    """values = raw · or ÷ `number`. Divided where a decimal fraction is meant: 1e-7 is no float, 1e7 is one."""

    how: Literal["times", "over"]
    number: float
    unit: str


_SCALES: Mapping[str, Scale] = {
    "degE7": Scale("over", 1e7, "deg"),
    "degE5": Scale("over", 1e5, "deg"),
    "cdeg": Scale("over", 100.0, "deg"),
    "deg/2": Scale("times", 2.0, "deg"),
    "ddeg/s": Scale("over", 10.0, "deg/s"),
    "mrad/s": Scale("over", 1000.0, "rad/s"),
    "mm": Scale("over", 1000.0, "m"),
    "cm": Scale("over", 100.0, "m"),
    "dm": Scale("over", 10.0, "m"),
    "dam": Scale("times", 10.0, "m"),
    "cm^2": Scale("over", 1e4, "m^2"),
    "mm/s": Scale("over", 1000.0, "m/s"),
    "cm/s": Scale("over", 100.0, "m/s"),
    "dm/s": Scale("over", 10.0, "m/s"),
    "m/s*5": Scale("over", 5.0, "m/s"),
    "mG": Scale("times", 9.80665e-3, "m/s/s"),
    "mgauss": Scale("over", 1000.0, "gauss"),
    "mV": Scale("over", 1000.0, "V"),
    "cV": Scale("over", 100.0, "V"),
    "mA": Scale("over", 1000.0, "A"),
    "cA": Scale("over", 100.0, "A"),
    "hJ": Scale("times", 100.0, "J"),
    "hPa": Scale("times", 100.0, "Pa"),
    "mbar": Scale("times", 100.0, "Pa"),
    "kPa": Scale("times", 1000.0, "Pa"),
    "cdegC": Scale("over", 100.0, "degC"),
    "d%": Scale("over", 10.0, "%"),
    "c%": Scale("over", 100.0, "%"),
    "cs": Scale("over", 100.0, "s"),
    "ds": Scale("over", 10.0, "s"),
}
"""Instants (ms, us, ns) are not here: they stay whole numbers."""

_U8, _U16, _I16 = 0xFF, 0xFFFF, 0x7FFF

_UNKNOWN: Mapping[tuple[str, str], int] = {
    ("SYS_STATUS", "voltage_battery"): _U16,
    ("SYS_STATUS", "current_battery"): -1,
    ("SYS_STATUS", "battery_remaining"): -1,
    **{("BATTERY_STATUS", name): -1 for name in ("current_battery", "current_consumed", "energy_consumed")},
    ("BATTERY_STATUS", "battery_remaining"): -1,
    ("BATTERY_STATUS", "temperature"): _I16,
    ("BATTERY_STATUS", "voltages"): _U16,
    **{
        (name, field): value
        for name in ("GPS_RAW_INT", "GPS2_RAW", "HIL_GPS")
        for field, value in {"eph": _U16, "epv": _U16, "vel": _U16, "cog": _U16, "satellites_visible": _U8}.items()
    },
    ("GLOBAL_POSITION_INT", "hdg"): _U16,
    ("DISTANCE_SENSOR", "signal_quality"): 0,
    ("OBSTACLE_DISTANCE", "distances"): _U16,
    **{("RC_CHANNELS", f"chan{channel}_raw"): _U16 for channel in range(1, 19)},
    **{("RC_CHANNELS_RAW", f"chan{channel}_raw"): _U16 for channel in range(1, 9)},
    ("RC_CHANNELS", "rssi"): _U8,
    ("RC_CHANNELS_RAW", "rssi"): _U8,
    **{("RADIO_STATUS", name): _U8 for name in ("rssi", "remrssi", "noise", "remnoise")},
}


def scale_of(unit: str) -> Scale | None:
    """None: the unit is kept."""
    return _SCALES.get(unit)


def unknown_of(message: str, field: str) -> int | None:
    """The raw value that says "not known" of a field, from the text of its definition; None: it has none."""
    return _UNKNOWN.get((message, field))
