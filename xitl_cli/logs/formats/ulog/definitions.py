"""Description of rows in a ULog: types, names and units of the fields.

A format gives types and names of fields, and may nest other formats. A ULog has no units; these are from PX4's message
definitions (msg/*.msg). Suffixes give the unit of a field (`_us`, `_rad`, `_v` …). The fields of the messages that
analyses use are listed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

TYPES: Mapping[str, str] = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4",
    "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8", "bool": "i1", "char": "i1",
}  # fmt: skip
"""numpy's code of each basic type."""

_FIELD = re.compile(r"([A-Za-z_]\w*)(?:\[(\d{1,5})\])? ([A-Za-z_]\w*)")
_NAME = re.compile(r"[A-Za-z_][\w/]*")
_PADDING = "_padding"
_DEEPEST = 8
_MOST_FIELDS = 8192
_LONGEST_ROW = 1 << 16


@dataclass(frozen=True, slots=True)
class FormatField:
    """A field as written in a format."""

    type_name: str
    count: int
    """Length of an array, 0 for a single value."""
    name: str


@dataclass(frozen=True, slots=True)
class MessageFormat:
    name: str
    fields: tuple[FormatField, ...]


@dataclass(frozen=True, slots=True)
class RowField:
    """One column."""

    name: str
    type_name: str
    at: int
    """Offset of its first byte in a row, behind the number of the subscription."""
    items: int
    """Length of an array, else 1."""
    array: bool

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(TYPES[self.type_name])

    @property
    def is_text(self) -> bool:
        return self.type_name == "char"


@dataclass(frozen=True, slots=True)
class RowLayout:
    """Fields of a row."""

    fields: tuple[RowField, ...]
    shortest: int
    """Bytes of a row without the padding at its end, which is not always written."""
    longest: int
    """Bytes of a row with the padding."""
    why: str = ""
    """Reason why rows cannot be read; then there are no fields."""

    @property
    def time(self) -> RowField | None:
        """Column with the time of a row, in microseconds."""
        return next((f for f in self.fields if f.name == "timestamp" and f.type_name == "uint64_t"), None)


def parse_format(content: bytes) -> MessageFormat | None:
    """Format from the content of its record; None if the content is invalid."""
    try:
        name, colon, rest = content.decode("ascii").partition(":")
    except UnicodeDecodeError:
        return None
    if not colon or not _NAME.fullmatch(name):
        return None
    fields = []
    for text in rest.split(";"):
        if not text:
            continue
        match = _FIELD.fullmatch(text)
        if match is None:
            return None
        fields.append(FormatField(match[1], int(match[2] or 0), match[3]))
    return MessageFormat(name, tuple(fields)) if fields else None


def row_layout(name: str, formats: Mapping[str, MessageFormat]) -> RowLayout:
    """Layout of the rows of a message. Nested fields have dots, elements of nested arrays brackets."""
    try:
        fields = list(_flat(name, formats, "", 0))
    except _UnreadableError as error:
        return RowLayout((), 0, _LONGEST_ROW, str(error))
    placed, at = [], 0
    for field in fields:
        items = max(field.count, 1)
        placed.append(RowField(field.name, field.type_name, at, items, field.count > 0))
        at += np.dtype(TYPES[field.type_name]).itemsize * items
        if at > _LONGEST_ROW or len(placed) > _MOST_FIELDS:
            return RowLayout((), 0, _LONGEST_ROW, f"its format {name!r} is longer than a record can be")
    while placed and placed[-1].name.startswith(_PADDING):
        placed.pop()
    end = placed[-1].at + placed[-1].dtype.itemsize * placed[-1].items if placed else 0
    return RowLayout(tuple(placed), end, at, "" if placed else f"its format {name!r} has no fields")


class _UnreadableError(Exception):
    pass


def _flat(name: str, formats: Mapping[str, MessageFormat], prefix: str, depth: int) -> Iterator[FormatField]:
    message = formats.get(name)
    if message is None:
        raise _UnreadableError(f"the log has no format {name!r}")
    if depth > _DEEPEST:
        raise _UnreadableError(f"its format nests {name!r} without end")
    for field in message.fields:
        if field.type_name in TYPES:
            yield FormatField(field.type_name, field.count, prefix + field.name)
            continue
        places = [f"{prefix}{field.name}[{index}]." for index in range(field.count)] or [f"{prefix}{field.name}."]
        if len(places) > _MOST_FIELDS:
            raise _UnreadableError(f"its format {name!r} is longer than a record can be")
        for place in places:
            yield from _flat(field.type_name, formats, place, depth + 1)


@dataclass(frozen=True, slots=True)
class FieldUnit:
    """Unit of a field."""

    unit: str = ""
    raw_unit: str = ""
    divisor: float = 1.0
    """From the stored number, in raw_unit, to a number in unit."""


_SUFFIXES: Mapping[str, str] = {
    "m": "m", "s": "s", "ms": "ms", "us": "us", "usec": "us", "deg": "deg", "rad": "rad", "m_s": "m/s", "v": "V",
    "a": "A", "w": "W", "celcius": "degC", "celsius": "degC", "degc": "degC", "pa": "Pa", "hz": "Hz", "ns": "ns",
    "rpm": "rpm", "wh": "Wh", "mah": "mAh",
}  # fmt: skip
_LOCAL = {
    **dict.fromkeys(("x", "y", "z", "eph", "epv", "ref_alt", "dist_bottom"), "m"),
    **dict.fromkeys(("vx", "vy", "vz", "evh", "evv", "z_deriv"), "m/s"),
    **dict.fromkeys(("ax", "ay", "az"), "m/s/s"),
    **dict.fromkeys(("ref_lat", "ref_lon"), "deg"),
    "heading": "rad",
}
_GLOBAL = {**dict.fromkeys(("lat", "lon"), "deg"), **dict.fromkeys(("alt", "alt_ellipsoid", "eph", "epv"), "m")}
_WHOLE_FIX = {
    **dict.fromkeys(("lat", "lon"), FieldUnit("deg", "1e-7 deg", 1e7)),
    **dict.fromkeys(("alt", "alt_ellipsoid"), FieldUnit("m", "mm", 1e3)),
}
"""Until 1.14, a fix was in whole numbers."""
_FIX = dict.fromkeys(("eph", "epv"), "m")
_BY_MESSAGE: Mapping[str, Mapping[str, str]] = {
    "vehicle_local_position": _LOCAL,
    "vehicle_local_position_groundtruth": _LOCAL,
    "vehicle_global_position": _GLOBAL,
    "vehicle_global_position_groundtruth": _GLOBAL,
    "vehicle_gps_position": _FIX,
    "sensor_gps": _FIX,
    "sensor_combined": {"gyro_rad": "rad/s", "accelerometer_m_s2": "m/s/s"},
    "sensor_gyro": dict.fromkeys("xyz", "rad/s"),
    "sensor_accel": dict.fromkeys("xyz", "m/s/s"),
    "sensor_mag": dict.fromkeys("xyz", "Gauss"),
    "vehicle_magnetometer": {"magnetometer_ga": "Gauss"},
    "vehicle_angular_velocity": {"xyz": "rad/s"},
    "vehicle_acceleration": {"xyz": "m/s/s"},
    "sensor_baro": {"pressure": "Pa", "temperature": "degC"},
    "vehicle_rates_setpoint": dict.fromkeys(("roll", "pitch", "yaw"), "rad/s"),
    "input_rc": {"values": "us"},
    "dropouts": {"duration": "ms"},
}


def measure_of(message: str, field: str, *, whole: bool = False) -> FieldUnit:
    """Measure of a field; empty if unknown. whole: the field has whole numbers."""
    if whole and message in ("vehicle_gps_position", "sensor_gps") and field in _WHOLE_FIX:
        return _WHOLE_FIX[field]
    unit = _BY_MESSAGE.get(message, {}).get(field)
    if field.startswith(("timestamp", "time_")):
        unit = "us"
    if unit is None:
        words = field.rpartition(".")[2].split("_")
        suffixes = ("_".join(words[-length:]) for length in (2, 1) if length < len(words))
        unit = next((_SUFFIXES[suffix] for suffix in suffixes if suffix in _SUFFIXES), "")
    return FieldUnit(unit, unit)
