"""MAVLink messages by number, and their frames, processed together.

Messages come from the generated classes of ArduPilot's dialect and of xitl's, with the units of a log's columns and the
values that mean "unknown".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import import_module
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.table import ALL, Column, Rows, Table


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
                    scale = None if text else _SCALES.get(unit)
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


# MAVLink frames, processed together: their headers and checksums, and one table per message.

_POLYNOMIAL = 0x8408


def checksums(
    data: NDArray[np.uint8], start: NDArray[np.int64], length: NDArray[np.int64], extra: NDArray[np.uint8]
) -> NDArray[np.uint16]:
    """Checksums (N,) of `length` bytes of `data` from `start`, each followed by its byte `extra`.

    The loop processes two bytes of all frames at a time. Frames are sorted by length, the longest first, so that
    unfinished frames form the front of an array. Every frame must lie in `data`.
    """
    order = np.argsort(-length, kind="stable")
    place, words, last = start[order], length[order] >> 1, (length[order] & 1).astype(np.bool_)
    table, one_byte = _tables()
    crc = np.full(len(order), 0xFFFF, dtype=np.uint16)
    if len(data) >= 2:
        pairs: NDArray[np.uint16] = np.ndarray((len(data) - 1,), "<u2", data, strides=(1,))  # at any offset, odd too
        going_on = len(order) - np.searchsorted(words[::-1], np.arange(int(words.max(initial=0))), side="right")
        for step, count in enumerate(going_on.tolist()):
            crc[:count] = table[crc[:count] ^ pairs[place[:count] + 2 * step]]
    crc[last] = _byte(one_byte, crc[last], data[(place + 2 * words)[last]])
    crc = _byte(one_byte, crc, extra[order])
    result: NDArray[np.uint16] = np.empty_like(crc)
    result[order] = crc
    return result


def _byte(table: NDArray[np.uint16], crc: NDArray[np.uint16], byte: NDArray[np.uint8]) -> NDArray[np.uint16]:
    after: NDArray[np.uint16] = (crc >> np.uint16(8)) ^ table[(crc ^ byte) & np.uint16(0xFF)]
    return after


@cache
def _tables() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Checksum tables of two bytes (65536 entries) and of one byte (256)."""
    one = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        one = np.where(one & 1, (one >> 1) ^ _POLYNOMIAL, one >> 1).astype(np.uint16)
    every = np.arange(65536, dtype=np.uint16)
    first = (every >> np.uint16(8)) ^ one[every & 0xFF]
    return (first >> np.uint16(8)) ^ one[first & 0xFF], one


MAGIC_1, MAGIC_2 = 0xFE, 0xFD
LONGEST_FRAME = 10 + 255 + 2 + 13
SIGNED = 0x01

UNKNOWN = -1
"""Replaces a message number that no dialect has."""


@dataclass(frozen=True, slots=True)
class FrameHeaders:
    """Headers of the frames that begin at `start`; each array is (N,)."""

    start: NDArray[np.int64]
    payload: NDArray[np.int64]
    length: NDArray[np.int64]
    size: NDArray[np.int64]
    """Of the whole frame."""
    number: NDArray[np.int64]
    kind: NDArray[np.int16]
    """Index of the message number in the known numbers, or UNKNOWN."""
    signed: NDArray[np.bool_]
    readable: NDArray[np.bool_]
    """The frame lies within the data and has no unknown incompatibility flag."""

    def select(self, rows: NDArray[np.intp]) -> FrameHeaders:
        return FrameHeaders(*(getattr(self, name)[rows] for name in FrameHeaders.__slots__))


def parse_headers(data: NDArray[np.uint8], start: NDArray[np.int64]) -> FrameHeaders:
    """Parse the headers at `start`, where the data has a byte MAGIC_1 or MAGIC_2."""
    last = len(data) - 1

    def at(offset: int) -> NDArray[np.int64]:
        return data[np.minimum(start + offset, last)].astype(np.int64)

    second = data[start] == MAGIC_2
    length, flags = at(1), np.where(second, at(2), 0)
    signed = (flags & SIGNED) != 0
    head = np.where(second, 10, 6)
    size = head + length + 2 + np.where(signed, 13, 0)
    number = np.where(second, at(7) | at(8) << 8 | at(9) << 16, at(5))
    kinds = _kind_by_number()
    kind = np.where(number < len(kinds), kinds[np.minimum(number, len(kinds) - 1)], np.int16(UNKNOWN))
    readable = (start + size <= len(data)) & ((flags & ~SIGNED) == 0)
    readable &= second | (kind == UNKNOWN) | (length <= _size_by_kind()[kind])  # MAVLink 1 has no extension fields
    return FrameHeaders(start, start + head, length, size, number, kind.astype(np.int16), signed, readable)


def intact(data: NDArray[np.uint8], frames: FrameHeaders) -> NDArray[np.bool_]:
    """(N,) whether the message is known and the checksum is correct."""
    result: NDArray[np.bool_] = frames.readable & (frames.kind != UNKNOWN)
    known = np.flatnonzero(result)
    ends = frames.payload[known] + frames.length[known]
    first = frames.start[known] + 1
    extra = _extra_by_kind()[frames.kind[known]]
    stored = data[ends].astype(np.uint16) | data[ends + 1].astype(np.uint16) << np.uint16(8)
    result[known] = checksums(data, first, ends - first, extra) == stored
    return result


@cache
def numbers() -> tuple[int, ...]:
    """Message numbers by kind."""
    return tuple(sorted(definitions()))


@cache
def _kind_by_number() -> NDArray[np.int16]:
    known = numbers()
    kinds = np.full(known[-1] + 2, UNKNOWN, dtype=np.int16)
    kinds[list(known)] = np.arange(len(known))
    return kinds


@cache
def _size_by_kind() -> NDArray[np.int64]:
    return np.array([definitions()[number].size for number in numbers()], dtype=np.int64)


@cache
def _extra_by_kind() -> NDArray[np.uint8]:
    return np.array([definitions()[number].crc_extra for number in numbers()], dtype=np.uint8)


_FROM_HEADER = {"_sysid": (5, 3), "_compid": (6, 4), "_seq": (4, 2)}
"""Position of the byte in a frame of MAVLink 2 and 1."""


class FrameTable(Table):
    """Frames of one message, each beginning at `start` of `data`. Columns: the fields, then `_sysid`, `_compid`,
    `_seq`.

    Bytes that a frame does not carry are 0: MAVLink 2 truncates zeros, and fields may be newer than the sender. A value
    that means "unknown" is NaN unless `raw`.
    """

    def __init__(
        self,
        name: str,
        definition: MavlinkDefinition,
        data: NDArray[np.uint8],
        start: NDArray[np.int64],
        stamp_ns: NDArray[np.int64],
        place: NDArray[np.int64],
    ) -> None:
        self.name, self.instance = name, definition.instance
        self._stamp_ns, self._place = stamp_ns, place
        stamp_ns.flags.writeable = place.flags.writeable = False
        self._definition, self._data, self._start = definition, data, start

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        own = {name: field.column for name, field in self._definition.fields.items()}
        return own | {name: Column(name) for name in _FROM_HEADER}

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        return self._stamp_ns

    @property
    def file_offset(self) -> NDArray[np.int64]:
        return self._place

    def __len__(self) -> int:
        return len(self._start)

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        start = self._start[rows]
        second = self._data[start] == MAGIC_2
        if column in _FROM_HEADER:
            in_second, in_first = _FROM_HEADER[column]
            return self._data[start + np.where(second, in_second, in_first)]
        field = self._definition.fields[column]
        payload = start + np.where(second, 10, 6)
        stored = self._stored(field, payload, self._data[start + 1].astype(np.int64))
        if field.text:
            # Text up to the first NUL.
            if not stored.size:
                return np.zeros(len(stored), dtype="U1")
            texts = np.ascontiguousarray(stored).view(f"S{stored.shape[1]}")[:, 0]
            shown = [text.split(b"\0", 1)[0].decode("ascii", errors="replace") for text in texts.tolist()]
            return np.array(shown, dtype=np.str_)
        return stored if raw else _scaled(field, stored)

    def _stored(self, field: MavlinkField, payload: NDArray[np.int64], length: NDArray[np.int64]) -> NDArray[Any]:
        count, item = max(field.count, 1), field.dtype.itemsize
        result = np.zeros((len(payload), count), field.dtype)
        carried = length >= field.end
        if carried.any():
            at_any_byte: NDArray[Any] = np.ndarray((len(self._data) - item + 1,), field.dtype, self._data, strides=(1,))
            begin = payload + field.offset
            steps = np.arange(count) * item
            if carried.all():
                result[:] = at_any_byte[begin[:, None] + steps]
            else:
                result[carried] = at_any_byte[begin[carried, None] + steps]
        cut = np.flatnonzero(~carried & (length > field.offset))
        if len(cut):
            offsets = field.offset + np.arange(count * item)
            inside = offsets < length[cut, None]
            found = self._data[np.where(inside, payload[cut, None] + offsets, 0)] * inside
            result[cut] = np.ascontiguousarray(found, dtype=np.uint8).view(field.dtype)
        return result if field.count else result[:, 0]


def _scaled(field: MavlinkField, stored: NDArray[Any]) -> NDArray[Any]:
    values = stored
    if field.scale is not None:
        number = field.scale.number
        values = stored / number if field.scale.how == "over" else stored * number
    if field.unknown is not None:
        values = np.where(stored == field.unknown, np.nan, values)
    return values


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """Counts of MAVLink frames."""

    frames: int
    decoded: int
    damaged: int
    """Not a frame, cut off, or with a wrong checksum."""
    signed: int
    """Subset of `decoded`."""
    unknown: Mapping[int, int] = field(default_factory=dict)
    """By message number."""


def frame_tables(
    prefix: str, frames: Sequence[bytes], stamp_ns: NDArray[np.int64], place: NDArray[np.int64]
) -> tuple[dict[str, Table], FrameCounts]:
    """Tables "`prefix`:ATTITUDE" (just "ATTITUDE" without a prefix), sorted by name.

    stamp_ns, place: (N,) of the frames. Signatures are not checked.
    """
    lengths = np.fromiter((len(frame) for frame in frames), dtype=np.int64, count=len(frames))
    data = np.frombuffer(b"".join(frames), dtype=np.uint8)
    begin = np.cumsum(lengths) - lengths
    there = np.flatnonzero(lengths)
    framed = there[np.isin(data[begin[there]], (MAGIC_1, MAGIC_2))] if len(data) else there
    found = parse_headers(data, begin[framed]) if len(framed) else None
    if found is None:
        return {}, FrameCounts(len(frames), 0, len(frames), 0)
    complete = found.readable & (found.size == lengths[framed])
    unknown = complete & (found.kind == UNKNOWN)
    good = np.flatnonzero(intact(data, found) & complete)
    rows = framed[good]
    decoded = found.select(good)
    tables = tables_by_message(prefix, data, decoded.start, decoded.kind, stamp_ns[rows], place[rows])
    counts = FrameCounts(
        frames=len(frames),
        decoded=len(good),
        damaged=len(frames) - len(good) - int(unknown.sum()),
        signed=int(decoded.signed.sum()),
        unknown=unknown_numbers(found, unknown),
    )
    return tables, counts


def tables_by_message(
    prefix: str,
    data: NDArray[np.uint8],
    start: NDArray[np.int64],
    kind: NDArray[np.int16],
    stamp_ns: NDArray[np.int64],
    place: NDArray[np.int64],
) -> dict[str, Table]:
    """One table per message. Rows keep the order of the frames."""
    if not len(kind):
        return {}
    order = np.argsort(kind, kind="stable")
    present, first = np.unique(kind[order], return_index=True)
    tables: dict[str, Table] = {}
    for number, rows in zip(present.tolist(), np.split(order, first[1:]), strict=True):
        definition = definitions()[numbers()[number]]
        name = f"{prefix}:{definition.name}" if prefix else definition.name
        tables[name] = FrameTable(name, definition, data, start[rows], stamp_ns[rows], place[rows])
    return dict(sorted(tables.items()))


def unknown_numbers(frames: FrameHeaders, unknown: NDArray[np.bool_]) -> dict[int, int]:
    """Number of frames for each message number that no dialect has."""
    found, count = np.unique(frames.number[unknown], return_counts=True)
    return dict(zip(found.tolist(), count.tolist(), strict=True))
