"""MAVLink messages by number, from the generated classes of ArduPilot's dialect and of xitl's.

The module also has the units of a log's columns, and the values that mean "unknown".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Literal, NamedTuple

import numpy as np

from xitl_cli.logs.model.table import Column


class Scale(NamedTuple):
    """Scale of a raw value: values = raw · number, or raw ÷ number.

    Decimal fractions use division: 1e-7 has no exact float, 1e7 has.
    """

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
"""Instants (ms, us, ns) are not listed: they remain whole numbers."""

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


def scale_for(unit: str) -> Scale | None:
    """Scale of a unit; None if the unit is kept."""
    return _SCALES.get(unit)


def unknown_value(message: str, field: str) -> int | None:
    """Raw value that means "unknown" for a field, from the text of its definition; None if there is none."""
    return _UNKNOWN.get((message, field))


_MODULES = ("pymavlink.dialects.v20.ardupilotmega", "agent.wire.dialect")
"""The first module that knows a number defines it, because xitl's dialect omits extension fields of common messages."""


@dataclass(frozen=True, slots=True)
class MavlinkField:
    """One field of a message."""

    name: str
    offset: int
    """In the payload, bytes."""
    dtype: np.dtype[np.generic]
    count: int
    """Numbers of `dtype`, or characters; 0 for a single number."""
    text: bool
    scale: Scale | None
    unknown: int | None
    column: Column

    @property
    def end(self) -> int:
        return self.offset + max(self.count, 1) * self.dtype.itemsize


@dataclass(frozen=True, slots=True)
class MavlinkDefinition:
    """One message of a dialect."""

    number: int
    name: str
    crc_extra: int
    fields: Mapping[str, MavlinkField]
    """In the order of the definition, not of the wire."""
    instance: str | None
    """Field that distinguishes sources."""

    @property
    def size(self) -> int:
        """Size of the payload with all extension fields."""
        return max((field.end for field in self.fields.values()), default=0)


@cache
def definitions() -> Mapping[int, MavlinkDefinition]:
    """Message definitions by message number."""
    found: dict[int, MavlinkDefinition] = {}
    for module in _MODULES:
        for number, generated in import_module(module).mavlink_map.items():
            if number not in found:
                made = vars(generated)
                fields: dict[str, MavlinkField] = {}
                offset = 0
                units = made["fieldunits_by_name"]
                codes = made["native_format"].decode().lstrip("<")
                for name, code, count in zip(made["ordered_fieldnames"], codes, made["array_lengths"], strict=True):
                    text = code == "c"
                    dtype = np.dtype("u1") if text else np.dtype(f"<{code}")
                    message = made["msgname"]
                    unit = units.get(name, "")
                    scale = None if text else scale_for(unit)
                    column = Column(
                        name,
                        unit if scale is None else scale.unit,
                        unit,
                        "text" if text else "number",
                        () if text or not count else (count,),
                    )
                    fields[name] = MavlinkField(
                        name, offset, dtype, count, text, scale, unknown_value(message, name), column
                    )
                    offset = fields[name].end
                instance = made["instance_field"]
                found[number] = MavlinkDefinition(
                    number,
                    made["msgname"],
                    made["crc_extra"],
                    {name: fields[name] for name in made["fieldnames"]},
                    None if instance is None or fields[instance].text else instance,
                )
    return found
