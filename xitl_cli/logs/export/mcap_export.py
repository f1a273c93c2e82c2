"""One MCAP of ROS 2 messages (CDR), one topic per message type, in the order of the log.

Each message type gets its own definition, with the names and units of the log in comments. A type with much data in a
batch gets its own chunks, as in a recording, so that a reader of one topic decompresses little.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.clocks.readings import UtcOffset, in_utc
from xitl_cli.logs.export.files import unique_names
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.query import merge_rows, rows_at_once
from xitl_cli.logs.model.table import Column, Table

_HEADER = b"\x00\x01\x00\x00"  # CDR, little-endian
_TYPES = {
    "b1": "uint8",
    "i1": "int8",
    "u1": "uint8",
    "i2": "int16",
    "u2": "uint16",
    "i4": "int32",
    "u4": "uint32",
    "i8": "int64",
    "u8": "uint64",
    "f4": "float32",
    "f8": "float64",
}


@dataclass(frozen=True, slots=True)
class _Field:
    """One field of a message definition."""

    name: str
    column: Column
    dtype: np.dtype[Any]
    count: int | None
    """Length of a fixed array; None for a single number; -1 for a sequence."""

    @property
    def declared(self) -> str:
        if self.column.kind == "text":
            return "string"
        if self.column.kind == "bytes":
            return "uint8[]"
        suffix = "" if self.count is None else "[]" if self.count < 0 else f"[{self.count}]"
        return _TYPES[self.dtype.str[1:]] + suffix


class TableMessages:
    """Rows of a table as ROS 2 messages. definition: of the message, in ros2msg."""

    def __init__(self, table: Table, raw: bool) -> None:
        self._table, self._raw = table, raw
        names = field_names(table.columns)
        self._fields = [self._field(column, names[column.name]) for column in table.columns.values()]
        self.definition = "".join(
            f"{field.declared} {field.name}  # {self._comment(field.column)}\n" for field in self._fields
        )

    def payloads(self, rows: NDArray[np.intp]) -> Iterator[bytes]:
        """One payload per row."""
        values = [self._values(field, rows) for field in self._fields]
        if all(field.column.kind == "number" and field.count != -1 for field in self._fields):
            count = len(rows)
            names, formats, offsets, size = [], [], [], 0
            for field in self._fields:
                size += -size % field.dtype.itemsize
                names.append(field.name)
                formats.append((field.dtype, () if field.count is None else (field.count,)))
                offsets.append(len(_HEADER) + size)
                size += field.dtype.itemsize * (1 if field.count is None else field.count)
            layout = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(_HEADER) + size})
            packed = np.zeros(count, dtype=layout)
            for name, column in zip(names, values, strict=True):
                packed[name] = column
            packed.view(np.uint8).reshape(count, layout.itemsize)[:, :4] = np.frombuffer(_HEADER, np.uint8)
            data = packed.tobytes()
            return (data[at : at + layout.itemsize] for at in range(0, len(data), layout.itemsize))
        return self._varying(values, len(rows))

    def _varying(self, values: Sequence[NDArray[Any]], count: int) -> Iterator[bytes]:
        for row in range(count):
            payload = bytearray(_HEADER)
            for field, column in zip(self._fields, values, strict=True):
                _append(payload, field, column[row])
            yield bytes(payload)

    def _field(self, column: Column, name: str) -> _Field:
        if column.kind != "number":
            return _Field(name, column, np.dtype("u1"), None)
        stored = self._table.values(column.name, slice(0, 1), raw=self._raw).dtype
        dtype = np.dtype(np.float32) if stored == np.float16 else stored.newbyteorder("<")
        if not column.shape:
            return _Field(name, column, dtype, None)
        return _Field(name, column, dtype, -1 if -1 in column.shape else int(np.prod(column.shape)))

    def _values(self, field: _Field, rows: NDArray[np.intp]) -> NDArray[Any]:
        values = self._table.values(field.column.name, rows, raw=self._raw)
        if field.count is not None and len(values):
            values = values.reshape(len(values), -1)
        return values if field.column.kind != "number" else values.astype(field.dtype)

    def _comment(self, column: Column) -> str:
        unit = column.raw_unit if self._raw else column.unit
        return (f"{column.name}, {unit}" if unit else column.name).replace("\n", " ")


def _append(payload: bytearray, field: _Field, value: Any) -> None:
    if field.column.kind == "text":
        text = str(value).replace("\0", "").encode("utf-8", errors="replace")
        _pad(payload, 4)
        payload += struct.pack("<I", len(text) + 1) + text + b"\0"
    elif field.column.kind == "bytes":
        data = bytes(value)
        _pad(payload, 4)
        payload += struct.pack("<I", len(data)) + data
    elif field.count is None or field.count >= 0:
        _pad(payload, field.dtype.itemsize)
        payload += value.tobytes()
    else:
        # Length without the NaN that pad a row.
        if value.dtype.kind != "f":
            used = len(value)
        else:
            there = np.flatnonzero(~np.isnan(value))
            used = int(there[-1]) + 1 if len(there) else 0
        items = value[:used]
        _pad(payload, 4)
        payload += struct.pack("<I", len(items))
        if len(items):
            _pad(payload, field.dtype.itemsize)
            payload += items.tobytes()


def _pad(payload: bytearray, size: int) -> None:
    payload += bytes(-(len(payload) - len(_HEADER)) % size)


_CHUNK_BYTES = 1 << 20
_APART_BYTES = 32 << 10


def write_mcap(
    path: Path,
    log: Log,
    tables: Sequence[Table],
    span_ns: tuple[int | None, int | None],
    utc: UtcOffset | None,
    raw: bool,
) -> tuple[int, int]:
    """Write `path`, with times in UTC if that is known.

    Returns the number of rows, and the number of rows written at 0 because their stamp is before the log's zero.
    """
    from mcap.writer import CompressionType, Writer

    names = type_names(table.name for table in tables)
    messages = [TableMessages(table, raw) for table in tables]
    rows_written = early = 0
    with path.open("xb") as file:
        writer: Any = Writer(file, chunk_size=_CHUNK_BYTES, compression=CompressionType.LZ4)
        writer.start("ros2", "xitl")
        channels = []
        for table, message in zip(tables, messages, strict=True):
            name = f"xitl_export/msg/{names[table.name]}"
            schema = writer.register_schema(name, "ros2msg", message.definition.encode())
            channels.append(writer.register_channel(f"/{table.name.removeprefix('/')}", "cdr", schema))
        source = {
            "source": log.path.name,
            "format": log.format,
            "time_base": log.base if utc is None else "utc",
            "utc_offset_ns": "" if utc is None else str(utc.offset_ns),
            "values": "raw" if raw else "scaled",
        }
        writer.add_metadata("xitl export", source)
        for batch in merge_rows(tables, *span_ns, None, 0, rows_at_once(log, tables), raw=raw):
            rows_written += len(batch.order)
            waiting = []
            for table, message, channel, own in zip(tables, messages, channels, batch.rows, strict=True):
                stamps, payloads = in_utc(table.stamp_ns[own], utc), list(message.payloads(own))
                early += int(np.count_nonzero(stamps < 0))
                rows = zip(np.clip(stamps, 0, None).tolist(), payloads, strict=True)
                if sum(map(len, payloads)) >= _APART_BYTES:
                    for stamp_ns, payload in rows:
                        writer.add_message(channel, stamp_ns, payload, stamp_ns)
                    writer.flush()
                waiting.append(rows)  # written rows must not be held in memory
            for owner in batch.order.tolist():
                for stamp_ns, payload in islice(waiting[owner], 1):
                    writer.add_message(channels[owner], stamp_ns, payload, stamp_ns)
            writer.flush()
        writer.finish()
    return rows_written, early


def field_names(columns: Iterable[str]) -> dict[str, str]:
    """ROS 2 field names, of small letters, digits and single underscores: "GyrX" → "gyrx", "pose.x" → "pose_x"."""

    def named(column: str) -> str:
        name = re.sub(r"[^a-z0-9]+", "_", column.lower()).strip("_")
        return name if name[:1].isalpha() else f"f_{name}".rstrip("_")

    return unique_names(columns, named)


def type_names(messages: Iterable[str]) -> dict[str, str]:
    """ROS 2 type names, of letters and digits with an initial capital: "GPS_RAW_INT" → "GpsRawInt", "ATT" → "ATT"."""

    def named(message: str) -> str:
        parts = re.findall(r"[A-Za-z0-9]+", message)
        name = parts[0] if len(parts) == 1 else "".join(part.capitalize() for part in parts)
        return name[0].upper() + name[1:] if name[:1].isalpha() else f"M{name}"

    return unique_names(messages, named, joined="")
