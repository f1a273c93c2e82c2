"""A ULog as tables, one per message. Its parameters, texts and dropouts are tables as well.

A row has the publication time of its topic. The value of a topic at the start of logging can be much older, and some
topics have no time (0). Such a row gets the latest stamp of the rows before it in the file. So does a row with an
impossible time, which is counted as damage. The column `timestamp` keeps the stored value.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.table import FAR_NS, decode_text, implausible, stamps_ns
from xitl_cli.logs.formats.ulog.definitions import FieldUnit, RowField, RowLayout, measure_of
from xitl_cli.logs.formats.ulog.records import (
    MAGIC,
    ROW_HEAD_BYTES,
    Bytes,
    Placed,
    Places,
    UlogRecords,
    Value,
    read_records,
)
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.file_bytes import FileBytes
from xitl_cli.logs.model.log import Base, Format, Log, LogHealth
from xitl_cli.logs.model.table import ALL, Column, Rows, Stamps, Table
from xitl_cli.logs.model.text import printable

PARAMETERS, TEXTS, DROPOUTS = "parameters", "logged_messages", "dropouts"
SYSTEM_DEFAULT, AIRFRAME_DEFAULT = 1, 2
_LONGEST_FACT = 200
_EARLIEST_UTC_NS = 1_000_000_000_000_000_000  # 2001


class UlogLog(Log):
    """Implements `Log`. Opening finds all records; columns are read on first use.

    Tables that are no messages: `parameters` (name, value, default), `logged_messages` (level, tag, message) and
    `dropouts` (duration). Raises LogError if the file cannot be read or is no ULog.
    """

    format: Format = "ulog"

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = path = Path(path)
        self._bytes = FileBytes(path)
        self._data = self._bytes.data
        if bytes(self._data[: len(MAGIC)]) != MAGIC:
            self.close()
            raise LogError(f"{path}: is not a ULog; choose an .ulg file of PX4")
        self._records: UlogRecords = read_records(self._data)
        if not len(self._records.place) and not self._records.others:
            self.close()
            raise LogError(f"{path}: is a ULog without a readable record; choose a complete file")

    @property
    def base(self) -> Base:
        """Stamps count from the start of PX4. Those of some simulators are UTC."""
        return "utc" if self._times.start_ns > _EARLIEST_UTC_NS else "boot"

    @cached_property
    def tables(self) -> Mapping[str, Table]:
        tables: dict[str, Table] = dict(self._topics)
        for made in (self._parameters(), self._texts(), self._dropouts()):
            if made is not None and made.name not in tables:
                tables[made.name] = made
        return MappingProxyType({name: tables[name] for name in sorted(tables)})

    @cached_property
    def _topics(self) -> dict[str, UlogTable]:
        parts: dict[str, dict[RowLayout, list[int]]] = {}
        for index, kind in enumerate(self._records.kinds):
            if kind.layout.fields and len(self._rows_of[index]):
                parts.setdefault(kind.subscription.name, {}).setdefault(kind.layout, []).append(index)
        return {
            name: UlogTable(
                name,
                self._data,
                [self._part(layout, kinds) for layout, kinds in layouts.items()],
                lambda: self._times.stamp_ns,
            )
            for name, layouts in parts.items()
        }

    @cached_property
    def _rows_of(self) -> list[NDArray[np.int64]]:
        """Indices of the rows of each subscription."""
        counts = np.bincount(self._records.kind, minlength=len(self._records.kinds))
        order = np.argsort(self._records.kind.astype(np.uint16), kind="stable")  # 16 bits use radix sort
        return list(np.split(order, np.cumsum(counts)[:-1]))

    def _part(self, layout: RowLayout, kinds: Sequence[int]) -> RowPart:
        """Rows of these subscriptions in the order of the file."""
        numbers = [self._rows_of[kind] for kind in kinds]
        ids = [self._records.kinds[kind].subscription.multi_id for kind in kinds]
        number, multi_id = np.concatenate(numbers), np.repeat(np.array(ids, np.uint8), list(map(len, numbers)))
        if len(kinds) > 1:
            order = np.argsort(number, kind="stable")
            number, multi_id = number[order], multi_id[order]
        return RowPart(layout, self._records.place[number], number, multi_id)

    @cached_property
    def _times(self) -> RowTimes:
        records = self._records
        stored = np.zeros(len(records.place), np.uint64)
        fields: dict[int, list[int]] = {}
        for index, kind in enumerate(records.kinds):
            time: RowField | None = kind.layout.time
            if time is not None:
                fields.setdefault(time.at, []).append(index)
        view = np.ndarray((max(len(self._data) - 7, 0),), "V8", self._data, strides=(1,))
        for at, kinds in fields.items():
            timed = np.zeros(len(records.kinds), np.bool_)
            timed[kinds] = True
            rows = np.flatnonzero(timed[records.kind])
            stored[rows] = view[records.place[rows] + ROW_HEAD_BYTES + at].view("<u8")
        return row_times(stored, records.kind, records.start_us)

    @cached_property
    def span_ns(self) -> tuple[int, int] | None:
        stamps = self._times.stamp_ns
        return (int(stamps.min()), int(stamps.max())) if len(stamps) else None

    @property
    def rowless(self) -> Collection[str]:
        return {kind.subscription.name for kind in self._records.kinds} - self._topics.keys()

    @cached_property
    def health(self) -> LogHealth:
        records, times = self._records, self._times
        undecoded: dict[str, tuple[int, str]] = {}
        for index, kind in enumerate(records.kinds):
            if not kind.layout.fields and (count := len(self._rows_of[index])):
                name = kind.subscription.name
                undecoded[name] = undecoded.get(name, (0, ""))[0] + count, kind.layout.why
        for number, count in records.unknown.items():
            undecoded[f"message {number}"] = count, "no record describes this number"
        for name, count in records.foreign.items():
            undecoded[name] = count, "records of this type are unknown"
        return records.losses.health(
            len(self._data),
            len(records.place) + records.others,
            back_in_time=times.back_in_time,
            replaced_stamps=times.replaced,
            redefined=records.redefined,
            undecoded=MappingProxyType(undecoded),
        )

    @cached_property
    def information(self) -> Mapping[str, Value]:
        """Information (I records) by key (`sys_name`, `ver_hw`, `ver_sw_release` …); the last value of each."""
        return MappingProxyType({record.content.key: record.content.value for record in self._records.information})

    @property
    def facts(self) -> Mapping[str, str]:
        shown = {
            key: printable(value.hex() if isinstance(value, bytes) else str(value))
            for key, value in self.information.items()
            if len(str(value)) <= _LONGEST_FACT and not key.startswith(("perf_", "metadata_"))
        }
        return MappingProxyType(shown)

    def attachment(self, name: str) -> bytes | None:
        """First information of this name that spans several records, such as `boot_console_output`, joined."""
        parts: list[bytes] = []
        for continued, information in self._records.continued:
            if information.key != name:
                continue
            if parts and not continued:
                break
            value = information.value
            parts.append(value if isinstance(value, bytes) else str(value).encode())
        return b"".join(parts) if parts else None

    def _placed(self, records: Sequence[Placed]) -> tuple[Stamps, NDArray[np.int64]]:
        """Stamps of the rows before these records, and the offsets of the records."""
        rows = np.array([record.rows for record in records], np.int64)
        return self._times.before(rows), np.array([record.place for record in records], np.int64)

    def _parameters(self) -> MadeTable | None:
        records = self._records.parameters
        if not records:
            return None
        stamps, place = self._placed(records)
        names = [record.content.key for record in records]
        # The default of the airframe comes before that of the firmware.
        defaults: dict[str, float] = {}
        for kind in (SYSTEM_DEFAULT, AIRFRAME_DEFAULT):
            defaults |= {default.key: float(default.value) for bits, default in self._records.defaults if bits & kind}
        values: dict[str, NDArray[Any]] = {
            "name": np.array(names),
            "value": np.array([_double(record.content.value) for record in records]),
        }
        if defaults:
            # A default is only logged if the value differs from it.
            first = {record.content.key: _double(record.content.value) for record in reversed(records)}
            values["default"] = np.array([defaults.get(name, first[name]) for name in names])
        return MadeTable(PARAMETERS, stamps, place, values)

    def _texts(self) -> MadeTable | None:
        records = self._records.texts
        if not records:
            return None
        stamps, place = self._placed(records)
        # The texts' own stamps are accepted if they fit between the rows.
        own_ns = np.array([min(record.content.stamp_us, 1 << 53) for record in records]) * 1_000
        near = np.abs(own_ns - stamps) < 10_000_000_000
        tags = [record.content.tag for record in records]
        values: dict[str, NDArray[Any]] = {
            "level": np.array([record.content.level for record in records], np.uint8),
            "message": np.array([record.content.text for record in records]),
        }
        if any(tag is not None for tag in tags):
            values["tag"] = np.array([np.nan if tag is None else tag for tag in tags])
        return MadeTable(TEXTS, np.where(near, own_ns, stamps), place, values)

    def _dropouts(self) -> MadeTable | None:
        records = self._records.dropouts
        if not records:
            return None
        stamps, place = self._placed(records)
        duration = np.array([record.content for record in records], np.uint16)
        return MadeTable(DROPOUTS, stamps, place, {"duration": duration})

    def read(self, *, raw: bool = False) -> dict[str, dict[str, NDArray[Any]]]:
        """Every column of every message, by name of message and of column."""
        return {name: table.read(raw=raw) for name, table in self._topics.items()}

    def close(self) -> None:
        for name in ("tables", "_topics", "_rows_of", "_times"):
            self.__dict__.pop(name, None)
        self._data = np.empty(0, np.uint8)
        self._bytes.close()


def _double(value: Value) -> float:
    """Shortest decimal number that is stored as this single-precision number."""
    return float(str(np.float32(value))) if isinstance(value, float) else float(value)


_EARLY_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class RowTimes:
    """Times of the rows."""

    stamp_ns: Stamps
    """(N,) in the order of the file."""
    start_ns: int
    replaced: int = 0
    """Rows with an impossible time."""
    back_in_time: int = 0

    def before(self, rows: NDArray[np.int64]) -> Stamps:
        """Latest stamp of the first `rows` rows, at least the start of the log."""
        latest = np.concatenate(([self.start_ns], np.maximum.accumulate(np.maximum(self.stamp_ns, self.start_ns))))
        return latest[np.clip(rows, 0, len(self.stamp_ns))]


def row_times(stored_us: NDArray[np.uint64], kind: NDArray[np.int32], start_us: int) -> RowTimes:
    """Determine the times of all rows.

    stored_us: (N,) of each row, 0 if it has none. kind: (N,) its subscription. start_us: from the file's header.
    """
    stored = stamps_ns(stored_us, 1_000)
    previous = _previous(stored, kind)
    first = previous < 0
    steady = np.flatnonzero(~first & (stored > 0))
    if not len(steady):
        steady = np.flatnonzero(stored > 0)
    if not len(steady):
        return RowTimes(np.full(len(stored), start_us * 1_000), start_us * 1_000)
    wrong = np.zeros(len(stored), np.bool_)
    wrong[steady[implausible(stored[steady])]] = True
    good = np.zeros(len(stored), np.bool_)
    good[steady] = True
    good &= ~wrong
    if not good.any():
        good = stored > 0
    # Start of logging: the time in the file's header, if the first rows agree.
    start_ns, first_ns = start_us * 1_000, stored[good][:100]
    if abs(int(np.median(first_ns)) - start_ns) >= FAR_NS:
        start_ns = int(first_ns.min())
    level = np.maximum.accumulate(np.where(good, stored, start_ns))
    # The first rows of topics are accepted if they fit in.
    good |= first & (stored >= start_ns - _EARLY_NS) & (stored <= level + FAR_NS)
    damaged = wrong & ((stored > level) | (stored < previous))
    # Every other row gets the stamp of the latest good row before it.
    stamps = np.where(good, stored, np.maximum.accumulate(np.where(good, stored, start_ns)))
    back = int(np.count_nonzero(stamps < _previous(stamps, kind)))
    return RowTimes(stamps, min(start_ns, int(stamps.min())), int(damaged.sum()), back)


def _previous(stamps: Stamps, kind: NDArray[np.int32]) -> Stamps:
    """(N,) stamp of the previous row of the same subscription, -1 for its first."""
    order = np.argsort(kind.astype(np.uint16), kind="stable")  # 16 bits use radix sort
    sorted_kind, sorted_ns = kind[order], stamps[order]
    earlier = np.full(len(stamps), -1, np.int64)
    if len(stamps) > 1:
        earlier[1:] = np.where(sorted_kind[1:] == sorted_kind[:-1], sorted_ns[:-1], -1)
    previous = np.empty(len(stamps), np.int64)
    previous[order] = earlier
    return previous


INSTANCE = "multi_id"


@dataclass(frozen=True, slots=True)
class RowPart:
    """Rows of one layout."""

    layout: RowLayout
    place: Places
    """(n,) first bytes."""
    number: NDArray[np.int64]
    """(n,) indices of these rows among all rows of the log."""
    multi_id: NDArray[np.uint8]
    """(n,)"""


class UlogTable(Table):
    """Implements `Table`: the rows of all instances of a message.

    It has a column `multi_id` if there are several instances. The first layout defines the columns. A column that
    another layout lacks is NaN or empty there.
    """

    def __init__(self, name: str, data: Bytes, parts: Sequence[RowPart], stamps: Callable[[], Stamps]) -> None:
        self.name = name
        self._data, self._parts, self._stamps = data, parts, stamps
        ids = np.unique(np.concatenate([np.unique(part.multi_id) for part in parts]))
        self.instance = INSTANCE if len(ids) > 1 or ids.any() else None

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        columns = {INSTANCE: Column(INSTANCE)} if self.instance else {}
        for part in self._parts:
            for field in part.layout.fields:
                columns.setdefault(field.name, _column(self.name, field))
        return MappingProxyType(columns)

    def __len__(self) -> int:
        return sum(len(part.place) for part in self._parts)

    @cached_property
    def _order(self) -> NDArray[np.intp] | None:
        """Order of the concatenated rows of all parts; None if there is one part."""
        if len(self._parts) == 1:
            return None
        return np.argsort(np.concatenate([part.place for part in self._parts]), kind="stable")

    def _joined(self, parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
        return parts[0] if self._order is None else np.concatenate(parts)[self._order]

    @cached_property
    def file_offset(self) -> Places:
        return self._joined([part.place for part in self._parts])

    @cached_property
    def stamp_ns(self) -> Stamps:
        stamps: Stamps = self._stamps()[self._joined([part.number for part in self._parts])]
        stamps.flags.writeable = False
        return stamps

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        known = self.columns[column]
        if column == INSTANCE and self.instance:
            return self._joined([part.multi_id for part in self._parts])[rows]
        if self._order is None:
            return self._values(self._parts[0], self._parts[0].place[rows], known, raw=raw)
        parts = [self._values(part, part.place, known, raw=raw) for part in self._parts]
        return np.concatenate(parts)[self._order][rows]

    def _values(self, part: RowPart, place: Places, known: Column, *, raw: bool) -> NDArray[Any]:
        field = next((field for field in part.layout.fields if field.name == known.name), None)
        if field is None or (column := _column(self.name, field)).shape != known.shape or column.kind != known.kind:
            return _missing(known, len(place))
        items = field.dtype.itemsize * field.items
        stored = np.ndarray((max(len(self._data) - items + 1, 0),), f"V{items}", self._data, strides=(1,))
        return self._scaled(_finished(stored[place + ROW_HEAD_BYTES + field.at], field), field, raw=raw)

    def _scaled(self, values: NDArray[Any], field: RowField, *, raw: bool) -> NDArray[Any]:
        divisor = _measure(self.name, field).divisor
        return values if raw or divisor == 1.0 else np.asarray(values / divisor)

    def read(self, *, raw: bool = False) -> dict[str, NDArray[Any]]:
        """Read all columns row by row, which is faster than column by column."""
        read: dict[str, list[NDArray[Any]]] = {name: [] for name in self.columns}
        for part in self._parts:
            # All rows as a structured array, with their fields by name.
            layout = part.layout
            view = np.ndarray((len(self._data) - layout.shortest + 1,), f"V{layout.shortest}", self._data, strides=(1,))
            packed = {
                "names": [field.name for field in layout.fields],
                "formats": [(field.dtype, field.items) if field.items > 1 else field.dtype for field in layout.fields],
                "offsets": [field.at for field in layout.fields],
                "itemsize": layout.shortest,
            }
            stored: NDArray[np.void] = view[part.place + ROW_HEAD_BYTES].view(np.dtype(packed))  # type: ignore[call-overload]
            fields = {field.name: field for field in layout.fields}
            for name, known in self.columns.items():
                if name == INSTANCE and self.instance:
                    read[name].append(part.multi_id)
                elif name in fields and _column(self.name, fields[name]) == known:
                    values = _finished(np.ascontiguousarray(stored[name]), fields[name])
                    read[name].append(self._scaled(values, fields[name], raw=raw))
                else:
                    read[name].append(_missing(known, len(part.place)))
        return {name: self._joined(parts) for name, parts in read.items()}


def _measure(message: str, field: RowField) -> FieldUnit:
    return measure_of(message, field.name, whole=field.dtype.kind in "iu")


def _column(message: str, field: RowField) -> Column:
    if field.is_text:
        return Column(field.name, kind="text")
    measure = _measure(message, field)
    return Column(field.name, measure.unit, measure.raw_unit, shape=(field.items,) if field.array else ())


def _finished(stored: NDArray[Any], field: RowField) -> NDArray[Any]:
    """Values of stored bytes (n,), with the type and shape of the column."""
    count = len(stored)
    if field.is_text:
        return decode_text(np.ascontiguousarray(stored).view(f"S{field.items}").reshape(count))
    values = np.ascontiguousarray(stored).view(field.dtype)
    return values.reshape((count, field.items) if field.array else (count,))


def _missing(column: Column, count: int) -> NDArray[Any]:
    return np.full(count, "", "U1") if column.kind == "text" else np.full((count, *column.shape), np.nan)


class MadeTable(Table):
    """Implements `Table` with columns in memory. place: (n,) of the records in the file."""

    def __init__(self, name: str, stamp_ns: Stamps, place: Places, values: Mapping[str, NDArray[Any]]) -> None:
        self.name = name
        self._stamp_ns, self._place, self._values = stamp_ns, place, values

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        columns = {}
        for name, values in self._values.items():
            unit = measure_of(self.name, name).unit
            columns[name] = Column(name, kind="text") if values.dtype.kind == "U" else Column(name, unit, unit)
        return MappingProxyType(columns)

    def __len__(self) -> int:
        return len(self._place)

    @property
    def stamp_ns(self) -> Stamps:
        return self._stamp_ns

    @property
    def file_offset(self) -> Places:
        return self._place

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        return self._values[column][rows]
