"""The rows of a DataFlash log by name of record: their columns and times.

One column is read by a strided view on the file. Many columns are read by whole rows, which are then split.

DataFlash has no checksum: a damaged time is not recognisable by itself, and one wrong bit can stretch a log to years.
In file order, time increases except for pauses and restarts; at these, it is far from the rows before or after. A row
that is far from both, on the same side, has an impossible time. So has the first or last row if it is very far. Such a
row is counted and gets the stamp of the previous row, as rows without a time do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.records import (
    HEAD_BYTES,
    NOTHING,
    TEXT,
    Bytes,
    ColumnUnit,
    Forget,
    Meaning,
    Places,
    RecordDefinition,
    RecordField,
    u64_at,
)
from xitl_cli.logs.model.table import ALL, Column, Kind, Rows, Table, steps_back

FAR_NS = 10_000_000_000
VERY_FAR_NS = 3_600_000_000_000
_AROUND = 16
"""Rows before and after a row with which it is compared."""
_BLOCK_ROWS = 1 << 16
"""Rows checked at a time: their part of the file stays in the processor's cache."""
_DOUBTFUL_ROWS = 1 << 16
_LATEST_NS = np.iinfo(np.int64).max

Stamps = NDArray[np.int64]
Block = tuple[Places, Bytes]
"""(n,) offsets, rising, and types of rows that have a time."""


@dataclass(frozen=True, slots=True)
class _Survey:
    span_ns: tuple[int, int] | None
    back_in_time: int
    jumps: bool


@dataclass(frozen=True, slots=True)
class _ReplacedStamps:
    """Rows with an impossible time, by offset, and the stamps that replace it."""

    place: Places
    stamp_ns: Stamps


class Times:
    """Times of a log.

    blocks: yields the rows that have a time, in the order of the file. stored_ns: returns the times of rows at offsets.
    """

    def __init__(self, blocks: Callable[[], Iterator[Block]], stored_ns: Callable[[Places], Stamps]) -> None:
        self._blocks = blocks
        self._told_ns = stored_ns

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self._whole[0].span_ns

    @property
    def back_in_time(self) -> int:
        """Number of rows with an earlier stamp than the previous row of their type."""
        return self._whole[0].back_in_time

    @property
    def replaced(self) -> int:
        """Number of rows with an implausible time."""
        return len(self._whole[1].place)

    def last_before(self, place: Places) -> Stamps:
        """Time of the last row with a time before each offset; 0 at the log's start."""
        found = np.zeros(len(place), np.int64)
        for places, _ in self._blocks():
            at = np.searchsorted(places, place) - 1
            behind = np.flatnonzero(at >= 0)
            before = places[at[behind]]
            found[behind] = self.with_replaced(before, self._told_ns(before))
        return found

    def with_replaced(self, place: Places, stored_ns: Stamps) -> Stamps:
        """Stamps of rows at these offsets, with implausible ones replaced."""
        return _with_replaced(self._whole[1], place, stored_ns)

    @cached_property
    def _whole(self) -> tuple[_Survey, _ReplacedStamps]:
        nothing = _ReplacedStamps(np.empty(0, np.int64), np.empty(0, np.int64))
        found = self._survey(nothing)
        if not found.jumps:
            return found, nothing
        places = [place for place, _ in self._blocks()]
        stamp_ns = np.concatenate([self._told_ns(place) for place in places])
        wrong = implausible(stamp_ns)
        if not 0 < len(wrong) < len(stamp_ns):  # if all are wrong, there is none to replace them
            return found, nothing
        right = np.ones(len(stamp_ns), np.bool_)
        right[wrong] = False
        trusted = np.flatnonzero(right)
        before = np.maximum(np.searchsorted(trusted, wrong) - 1, 0)
        mended = _ReplacedStamps(np.concatenate(places)[wrong], stamp_ns[trusted[before]])
        return self._survey(mended), mended

    def _survey(self, mended: _ReplacedStamps) -> _Survey:
        lowest, highest, back, jumps = [], [], 0, False
        last_of = np.full(256, -1)
        last: int | None = None
        for place, type_id in self._blocks():
            if not len(place):
                continue
            stamps = _with_replaced(mended, place, self._told_ns(place))
            lowest.append(int(stamps.min()))
            highest.append(int(stamps.max()))
            jumps |= last is not None and abs(int(stamps[0]) - last) > FAR_NS
            last = int(stamps[-1])
            if len(stamps) > 1:
                steps = np.diff(stamps)
                jumps |= int(steps.max()) > FAR_NS or int(steps.min()) < -FAR_NS
            back += _back_in_time(stamps, type_id, last_of)
        return _Survey((min(lowest), max(highest)) if lowest else None, back, jumps)


def times_in_heads(data: Bytes, place: Places, type_id: Bytes, timed: NDArray[np.bool_]) -> Times:
    """Times of a log in which all timed records begin with microseconds; nothing else is read.

    timed: (256,) whether records of a type do.
    """

    def blocks() -> Iterator[Block]:
        for at in range(0, len(place), _BLOCK_ROWS):
            some = type_id[at : at + _BLOCK_ROWS]
            rows = np.flatnonzero(timed[some])
            yield place[at : at + _BLOCK_ROWS][rows], some[rows]

    return Times(blocks, lambda places: stamps_ns(u64_at(data, places + HEAD_BYTES), 1_000))


def times_in_columns(tables: Sequence[DataFlashTable]) -> Times:
    """Times of any other log, from at most 256 tables."""
    place = np.concatenate([np.empty(0, np.int64), *(table.file_offset for table in tables)])
    order = np.argsort(place, kind="stable")
    place = place[order]
    stamp_ns = np.concatenate([np.empty(0, np.int64), *(table.stored_ns() for table in tables)])[order]
    number = np.repeat(np.arange(len(tables), dtype=np.uint8), [len(table.file_offset) for table in tables])[order]
    return Times(lambda: iter([(place, number)]), lambda places: stamp_ns[np.searchsorted(place, places)])


def _back_in_time(stamps: Stamps, type_id: Bytes, last_of: Stamps) -> int:
    """Number of rows earlier than the previous row of their type. last_of: (256,) stamp of the previous row, updated
    here."""
    if int(stamps[0]) >= int(last_of.max()) and not steps_back(stamps):
        last_of[type_id] = stamps  # of several rows of a type, the last
        return 0
    order = np.argsort(type_id, kind="stable")
    stamps, type_id = stamps[order], type_id[order]
    first = np.flatnonzero(np.concatenate(([True], type_id[1:] != type_id[:-1])))
    earlier = np.concatenate(([0], stamps[:-1]))
    earlier[first] = last_of[type_id[first]]
    final = np.concatenate((first[1:] - 1, [len(stamps) - 1]))
    last_of[type_id[final]] = stamps[final]
    return int(np.count_nonzero(stamps < earlier))


def stamps_ns(counted: NDArray[np.integer], unit_ns: int) -> Stamps:
    """Nanoseconds from counts of `unit_ns` since boot, clipped to [0, largest int64]."""
    return np.asarray(np.clip(counted, 0, _LATEST_NS // unit_ns).astype(np.int64) * unit_ns)


def implausible(stamp_ns: Stamps) -> NDArray[np.intp]:
    """Rows with an implausible time, in the order of the file. Stamps are not negative."""
    jumps = np.flatnonzero(np.abs(np.diff(stamp_ns)) > FAR_NS)
    doubtful = np.unique(np.concatenate((jumps, jumps + 1)))
    found = [np.empty(0, np.intp)]
    for at in range(0, len(doubtful), _DOUBTFUL_ROWS):
        rows = doubtful[at : at + _DOUBTFUL_ROWS]
        before, after = (_away(stamp_ns, rows, side) for side in (-1, 1))
        both = (np.minimum(before, after) > FAR_NS) | (np.maximum(before, after) < -FAR_NS)
        alone = np.abs(np.where(np.isnan(before), after, before)) > VERY_FAR_NS
        found.append(rows[np.where(np.isnan(before) | np.isnan(after), alone, both)])
    return np.concatenate(found)


def _away(stamp_ns: Stamps, rows: NDArray[np.intp], side: int) -> NDArray[np.float64]:
    """Distance of each row from the median of the rows on one side of it; NaN if there are none."""
    around = rows[:, None] + side * np.arange(1, _AROUND + 1)
    there = (around >= 0) & (around < len(stamp_ns))
    values = np.where(there, stamp_ns[np.where(there, around, 0)], _LATEST_NS)
    values.sort(axis=1)
    count = there.sum(axis=1)
    median = values[np.arange(len(rows)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, (stamp_ns[rows] - median).astype(np.float64), np.nan)


def _with_replaced(mended: _ReplacedStamps, place: Places, stored_ns: Stamps) -> Stamps:
    if not len(mended.place) or not len(place):
        return stored_ns
    at = np.minimum(np.searchsorted(mended.place, place), len(mended.place) - 1)
    return np.where(mended.place[at] == place, mended.stamp_ns[at], stored_ns)


_WINDOW = 4 << 20
"""Bytes of the file from which rows of all types are read before the next: they stay in the processor's cache."""
_ROWS_AT_ONCE = 8192
"""Rows read at a time."""
_TOUCHED_ROWS = 2048
"""Records of which every part that the processor loads fits in its second cache."""


@dataclass(frozen=True, slots=True)
class ColumnJob:
    """Rows at these offsets, each of `length` bytes."""

    place: Places
    length: int
    fields: Sequence[tuple[RecordField, float, float, NDArray[Any]]]
    """Field, divisor, multiplier and output. A field without conversion goes to an array of its own type, else to
    float64."""
    layout: np.dtype[np.void]
    """Of a record."""
    names: Sequence[str]
    """Of the fields in `layout`."""


def read_field(data: Bytes, place: Places, field: RecordField) -> NDArray[Any]:
    """(n,) or (n, items) values of a field as stored."""
    shape = (len(place), field.items) if field.items > 1 else (len(place),)
    width = field.dtype.itemsize * field.items
    if not len(place):
        return np.empty(shape, field.dtype)
    found: NDArray[Any] = _every(data, width)[place + field.at].view(field.dtype).reshape(shape)
    return found


def column_job(place: Places, length: int, fields: Sequence[tuple[RecordField, float, float]]) -> ColumnJob:
    """A job with an output array for each of these fields, with their divisors and multipliers."""
    count, listed = len(place), []
    names = [str(number) for number in range(len(fields))]
    for field, divisor, multiplier in fields:
        plain = divisor == multiplier == 1.0
        shape = (count, field.items) if field.items > 1 else (count,)
        listed.append((field, divisor, multiplier, np.empty(shape, field.dtype if plain else np.float64)))
    layout = np.dtype(
        {
            "names": names,
            "formats": [(field.dtype, field.items) if field.items > 1 else field.dtype for field, *_ in fields],
            "offsets": [field.at for field, *_ in fields],
            "itemsize": length,
        }
    )
    return ColumnJob(place, length, listed, layout, names)


def read_columns(data: Bytes, many: Sequence[ColumnJob], forget: Forget | None = None) -> None:
    """Fill the arrays of all jobs. forget: called with ranges that were read.

    One thread: the Python code between the copies would block a second one.
    """
    edges = np.arange(0, len(data) + _WINDOW, _WINDOW)
    if len(many) == 1:  # rows of one type are so far apart that a window does not help
        edges = np.array([0, len(data)])
    cuts = [np.searchsorted(job.place, edges).tolist() for job in many]

    everywhere = [_every(data, job.length) for job in many]
    for at in range(len(edges) - 1):
        for job, every, cut in zip(many, everywhere, cuts, strict=True):
            for start in range(cut[at], cut[at + 1], _ROWS_AT_ONCE):
                _fill_rows(data, every, job, start, min(start + _ROWS_AT_ONCE, cut[at + 1]))
        if forget is not None:
            forget(int(edges[at]), int(edges[at + 1]))


def _fill_rows(data: Bytes, every: NDArray[np.void], job: ColumnJob, start: int, stop: int) -> None:
    table = _records_at(data, every, job.place[start:stop]).view(job.layout)
    for name, (_, divisor, multiplier, out) in zip(job.names, job.fields, strict=True):
        if divisor != 1.0:
            np.divide(table[name], divisor, out=out[start:stop])
        elif multiplier != 1.0:
            np.multiply(table[name], multiplier, out=out[start:stop])
        else:
            out[start:stop] = table[name]


def _records_at(data: Bytes, every: NDArray[np.void], place: Places) -> NDArray[np.void]:
    """(n,) records at these offsets. every: as `_every` returns it.

    The first and the last byte of each are read before. In these loops, which do nothing else, the processor waits for
    many places of the memory at once. "wrap" is the mode with the shortest loop.
    """
    ends = data[every.itemsize - 1 :]
    if len(place) <= _TOUCHED_ROWS:
        data.take(place, mode="wrap")
        ends.take(place, mode="wrap")
        return every[place]
    records = np.empty(len(place), every.dtype)
    for at in range(0, len(place), _TOUCHED_ROWS):
        records[at : at + _TOUCHED_ROWS] = _records_at(data, every, place[at : at + _TOUCHED_ROWS])
    return records


def _every(data: Bytes, width: int) -> NDArray[np.void]:
    """A view of `width` bytes from every place of the file."""
    return np.ndarray((len(data) - width + 1,), f"V{width}", data, strides=(1,))


def decoded_column(values: NDArray[Any], column: Column) -> NDArray[Any]:
    """Text as str, bytes as objects, numbers unchanged."""
    if column.kind == "number":
        return values
    if column.kind == "text":
        return decode_text(values)
    width = values.dtype.itemsize
    stored = np.ascontiguousarray(values).tobytes()
    objects = np.empty(len(values), object)
    objects[:] = [stored[at : at + width] for at in range(0, len(stored), width)]
    return objects


def decode_text(values: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Text up to the first NUL, as UTF-8, else as ISO-8859-1."""
    count, width = len(values), values.dtype.itemsize
    if not count:
        return np.empty(0, "U1")
    characters = np.ascontiguousarray(values).view(np.uint8).reshape(count, width)
    ended = np.logical_or.accumulate(characters == 0, axis=1)
    foreign = np.flatnonzero((characters >= 0x80).any(axis=1))
    longest = max(int(width - ended.sum(axis=1).min()), 1)
    plain = np.where(ended | (characters >= 0x80), 0, characters)[:, :longest]
    texts = np.ascontiguousarray(plain, dtype=np.uint8).view(f"S{longest}").ravel().astype(f"U{longest}")
    for row in foreign.tolist():
        stored = characters[row].tobytes()
        try:
            text = stored.decode()
        except UnicodeDecodeError:
            text = stored.decode("latin-1")
        texts[row] = text.partition("\0")[0]
    return texts


class DefinitionRows:
    """Rows of one definition. Their offsets are searched on first use."""

    def __init__(self, definition: RecordDefinition, count: int, find: Callable[[], Places]) -> None:
        self.definition = definition
        self._count = count
        self._find = find

    def __len__(self) -> int:
        return self._count

    @cached_property
    def place(self) -> Places:
        return self._find()


_MOST_COPIED = 256 << 20
_GOOD_PART = 8
"""Share of the rows of a type, as a divisor, from which all of its records are copied."""


class RecordCopies:
    """Reads fields, from copies of the records of a type.

    Records of a type are far apart in the file: to read one field of them takes as long as to copy them, and fields of
    the copy take a fraction of that. Up to 256 MiB are kept; the type that was not read for longest goes first.
    """

    def __init__(self, data: Bytes) -> None:
        self._data = data
        self._copies: dict[DefinitionRows, NDArray[np.void]] = {}

    def read(self, part: DefinitionRows, field: RecordField, rows: Rows) -> NDArray[Any]:
        """(n,) or (n, items) values of a field as stored, of these rows."""
        records = self._records(part, rows)
        if records is None:
            return read_field(self._data, part.place[rows], field)
        shape, strides = [len(records)], list(records.strides)
        if field.items > 1:
            shape.append(field.items)
            strides.append(field.dtype.itemsize)
        every: NDArray[Any] = np.ndarray(shape, field.dtype, records, field.at, strides)
        return every[rows].copy() if isinstance(rows, slice) else every[rows]

    def fill(self, jobs: Sequence[ColumnJob]) -> None:
        """Fill the arrays of all jobs from the file."""
        read_columns(self._data, jobs)

    def clear(self) -> None:
        self._data = np.empty(0, np.uint8)
        self._copies.clear()

    def _records(self, part: DefinitionRows, rows: Rows) -> NDArray[np.void] | None:
        """All records of a type; None if few of them are wanted, or if they are too large."""
        records = self._copies.pop(part, None)
        if records is None:
            many = rows == ALL if isinstance(rows, slice) else _GOOD_PART * len(rows) >= len(part)
            if not many or not len(part) or len(part) * part.definition.length > _MOST_COPIED:
                return None
            records = _records_at(self._data, _every(self._data, part.definition.length), part.place)
        self._copies[part] = records
        while sum(copy.nbytes for copy in self._copies.values()) > _MOST_COPIED:
            del self._copies[next(iter(self._copies))]
        return records


@dataclass(frozen=True, slots=True)
class _TypedRows:
    """A part and its columns."""

    part: DefinitionRows
    columns: Mapping[str, tuple[RecordField, ColumnUnit, Column]]


class DataFlashTable(Table):
    """Implements `Table`. It has parts if a type was described again, or two types have one name.

    The first part defines the columns. A column that another part lacks, or has with another type, is NaN or empty
    there.
    """

    def __init__(
        self,
        name: str,
        parts: Sequence[DefinitionRows],
        meaning: Meaning,
        times: Callable[[], Times],
        copies: RecordCopies,
    ) -> None:
        self.name = name
        self._copies = copies
        self._parts = [_TypedRows(part, _columns(name, part.definition, meaning)) for part in parts]
        self._times = times
        measures = ((name, measure) for rows in self._parts for name, (_, measure, _) in rows.columns.items())
        self.instance = next((name for name, measure in measures if measure.instance), None)

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        found: dict[str, Column] = {}
        for rows in self._parts:
            for name, (_, _, column) in rows.columns.items():
                found.setdefault(name, column)
        return MappingProxyType(found)

    def __len__(self) -> int:
        return sum(len(rows.part) for rows in self._parts)

    @cached_property
    def _order(self) -> NDArray[np.intp] | None:
        """Order of the concatenated rows of all parts; None if there is one part."""
        if len(self._parts) == 1:
            return None
        return np.argsort(np.concatenate([rows.part.place for rows in self._parts]), kind="stable")

    @cached_property
    def file_offset(self) -> Places:
        return self._whole([rows.part.place for rows in self._parts])

    @cached_property
    def stamp_ns(self) -> NDArray[np.int64]:
        return self._whole([self._stamps(rows.part, ALL) for rows in self._parts])

    def stored_ns(self) -> NDArray[np.int64]:
        """(N,) stamps as stored, including implausible ones."""
        return self._whole([self._stored(rows.part, ALL) for rows in self._parts])

    @property
    def ends_ns(self) -> tuple[int, int] | None:
        """Stamps of the first and the last row, without reading the others; None if rows have no time."""
        if not self.timed:
            return None
        if len(self._parts) > 1:
            return int(self.stamp_ns[0]), int(self.stamp_ns[-1])
        first_ns, last_ns = self._stamps(self._parts[0].part, np.array([0, -1])).tolist()
        return first_ns, last_ns

    def _whole(self, parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
        found = parts[0] if self._order is None else np.concatenate(parts)[self._order]
        found.flags.writeable = False
        return found

    @property
    def timed(self) -> bool:
        """Whether all rows have their own time."""
        return all(rows.part.definition.time is not None for rows in self._parts)

    def _stamps(self, part: DefinitionRows, rows: Rows) -> NDArray[np.int64]:
        place = part.place[rows]
        if part.definition.time is None:
            return self._times().last_before(place)
        return self._times().with_replaced(place, self._stored(part, rows))

    def _stored(self, part: DefinitionRows, rows: Rows) -> NDArray[np.int64]:
        assert part.definition.time is not None
        field, unit_ns = part.definition.time
        return stamps_ns(self._copies.read(part, field, rows), unit_ns)

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        known = self.columns[column]
        if self._order is None:
            return self._values(self._parts[0], rows, known, raw=raw)
        whole = [self._values(typed, ALL, known, raw=raw) for typed in self._parts]
        return np.concatenate(whole)[self._order][rows]

    def _values(self, typed: _TypedRows, rows: Rows, known: Column, *, raw: bool) -> NDArray[Any]:
        field, measure, column = typed.columns.get(known.name, (None, NOTHING, known))
        if field is None or (column.kind, column.shape) != (known.kind, known.shape):
            return _missing(known, len(typed.part.place[rows]))
        values = self._copies.read(typed.part, field, rows)
        divisor, multiplier = field.conversion(measure, raw=raw)
        if divisor != 1.0:
            return np.asarray(np.divide(values, divisor, dtype=np.float64))
        if multiplier != 1.0:
            return np.asarray(np.multiply(values, multiplier, dtype=np.float64))
        return decoded_column(values, known)

    def read(self, *, raw: bool = False) -> dict[str, NDArray[Any]]:
        """Read all columns at once, which is faster than one by one."""
        jobs = self.jobs(raw=raw)
        self._copies.fill(jobs)
        return self.filled(jobs)

    def jobs(self, *, raw: bool = False) -> list[ColumnJob]:
        """Read jobs for all columns, one for each part; `filled` gives the columns."""
        return [
            column_job(
                rows.part.place,
                rows.part.definition.length,
                [(field, *field.conversion(measure, raw=raw)) for field, measure, _ in rows.columns.values()],
            )
            for rows in self._parts
        ]

    def filled(self, jobs: Sequence[ColumnJob]) -> dict[str, NDArray[Any]]:
        return {name: self._joined(known, jobs) for name, known in self.columns.items()}

    def _joined(self, known: Column, jobs: Sequence[ColumnJob]) -> NDArray[Any]:
        found = []
        for rows, job in zip(self._parts, jobs, strict=True):
            values = next((values for field, _, _, values in job.fields if field.name == known.name), None)
            column = rows.columns[known.name][2] if values is not None else known
            if values is None or (column.kind, column.shape) != (known.kind, known.shape):
                found.append(_missing(known, len(rows.part)))
            else:
                found.append(decoded_column(values, known))
        return found[0] if self._order is None else np.concatenate(found)[self._order]


def _columns(
    name: str, definition: RecordDefinition, meaning: Meaning
) -> dict[str, tuple[RecordField, ColumnUnit, Column]]:
    measures = meaning(definition)
    found = {}
    for field in definition.fields:
        measure = measures.get(field.name, NOTHING)
        kind: Kind = (
            "number" if field.letter not in TEXT else "bytes" if (name, field.letter) == ("FILE", "Z") else "text"
        )
        shape = (field.items,) if field.items > 1 else ()
        found[field.name] = field, measure, Column(field.name, measure.unit, measure.raw_unit, kind, shape)
    return found


def _missing(column: Column, count: int) -> NDArray[Any]:
    if column.kind == "number":
        return np.full((count, *column.shape), np.nan)
    if column.kind == "text":
        return np.full(count, "", "U1")
    found = np.empty(count, object)
    found[:] = b""
    return found
