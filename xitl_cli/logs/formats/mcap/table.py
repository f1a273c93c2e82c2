"""Table of one topic: joins the decoded batches of payloads to columns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap.container import PayloadBatch
from xitl_cli.logs.model.table import ALL, Column, Kind, Rows, Table, steps_back

MOST_ELEMENTS = 32
"""Largest number of elements of an array of messages or texts that get their own columns."""

MOST_NUMBERS = 4096
"""Largest number of numbers in an array with numeric values. Longer arrays are bytes, as stored, and so are very long
arrays of differing lengths that would exceed the memory when padded."""

MOST_LEAVES = 2000
_MOST_PADDED_BYTES = 1 << 30
_MOST_TEXT_BYTES = 64 << 20

RowNumbers = NDArray[np.intp]


class UndecodableError(Exception):
    """A topic cannot be decoded at all. The message is the reason, as a clause."""


class Leaf:
    """One field of all messages of a batch."""

    kind: Kind = "number"
    unit: str = ""
    dtype: np.dtype[Any]
    lengths: tuple[int, int] | None = None
    """Shortest and longest of an array; None: a single value."""

    def values(self, rows: RowNumbers) -> list[Any] | NDArray[Any]:
        """(n,) single values; an array if they are numbers."""
        raise NotImplementedError

    def arrays(self, rows: RowNumbers, width: int) -> NDArray[Any]:
        """(n, width) numbers, padded with NaN if an array of this batch is shorter."""
        raise NotImplementedError

    def packed(self, rows: RowNumbers) -> list[bytes]:
        """Numbers of each array as bytes, as stored."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class DecodedBatch:
    """One decoded batch."""

    good: NDArray[np.bool_]
    """(n,) the rows that could be decoded."""
    leaves: Mapping[str, Leaf]
    """By name of their column."""


class Decoder(Protocol):
    """Decoder of payloads. open_ended: messages may lack fields, which are then NaN or empty text."""

    open_ended: bool

    def decode(self, batch: PayloadBatch, wanted: str | None) -> DecodedBatch:
        """Decode a batch. wanted: the only column that is needed; None: all. Raises UndecodableError."""
        ...


@dataclass(slots=True)
class Shape:
    """Properties of a column, from the leaves seen so far."""

    kind: Kind
    unit: str
    dtype: np.dtype[Any]
    lengths: tuple[int, int] | None
    seen: int = 1
    """Number of batches that have it."""

    def join(self, leaf: Leaf) -> None:
        self.seen += 1
        if leaf.kind != self.kind or (leaf.lengths is None) != (self.lengths is None):
            self.kind, self.lengths = "text", None
            return
        if self.kind == "number":
            self.dtype = np.promote_types(self.dtype, leaf.dtype)
        if self.lengths is not None and leaf.lengths is not None:
            self.lengths = min(self.lengths[0], leaf.lengths[0]), max(self.lengths[1], leaf.lengths[1])


class Shapes:
    """Columns of a topic, collected batch by batch."""

    def __init__(self, open_ended: bool) -> None:
        self._open_ended = open_ended
        self._shapes: dict[str, Shape] = {}
        self._batches = 0

    def add(self, leaves: Mapping[str, Leaf]) -> None:
        self._batches += 1
        for name, leaf in leaves.items():
            known = self._shapes.get(name)
            if known is not None:
                known.join(leaf)
            elif (self._open_ended or self._batches == 1) and len(self._shapes) < MOST_LEAVES:
                self._shapes[name] = Shape(leaf.kind, leaf.unit, leaf.dtype, leaf.lengths)

    def columns(self, rows: int) -> dict[str, Column]:
        """Columns in every batch, or in any batch if messages are open-ended. rows: of the whole table.

        An array that is always empty is not a column.
        """
        return {
            name: _column(name, shape, rows)
            for name, shape in self._shapes.items()
            if (self._open_ended or shape.seen == self._batches) and shape.lengths != (0, 0)
        }

    def values(self, column: Column, parts: Iterable[tuple[Mapping[str, Leaf], RowNumbers]]) -> NDArray[Any]:
        """One column of all parts, each with its wanted rows."""
        shape = self._shapes[column.name]
        if column.kind == "number":
            blocks: list[NDArray[Any]] = []
            width = () if shape.lengths is None else (shape.lengths[1],)
            for leaves, rows in parts:
                leaf = leaves.get(column.name)
                if leaf is None:
                    blocks.append(np.full((len(rows), *width), np.nan))
                elif width:
                    blocks.append(leaf.arrays(rows, width[0]))
                else:
                    blocks.append(np.asarray(leaf.values(rows)))
            if blocks:
                return np.concatenate(blocks)
            return np.zeros((0, *width), dtype=np.float64 if column.shape == (-1,) else shape.dtype)
        values: list[Any] = []
        for leaves, rows in parts:
            values += _objects(column, shape, leaves.get(column.name), rows)
        return texts(values) if column.kind == "text" else objects(values)


def texts(values: Sequence[str]) -> NDArray[Any]:
    """Text of fixed width, or of object type if one very long text would widen all."""
    widest = max((len(value) for value in values), default=0)
    if 4 * widest * len(values) > _MOST_TEXT_BYTES:
        return objects(values)
    return np.array(values, dtype=np.str_) if values else np.zeros(0, dtype="U1")


def objects(values: Sequence[Any]) -> NDArray[Any]:
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array


def _column(name: str, shape: Shape, rows: int) -> Column:
    if shape.lengths is None or shape.kind != "number":
        return Column(name, shape.unit, shape.unit, shape.kind)
    shortest, longest = shape.lengths
    if longest > MOST_NUMBERS or (shortest < longest and 8 * longest * rows > _MOST_PADDED_BYTES):
        return Column(name, kind="bytes")
    return Column(name, shape.unit, shape.unit, shape=(longest if shortest == longest else -1,))


def _objects(column: Column, shape: Shape, leaf: Leaf | None, rows: RowNumbers) -> Sequence[Any]:
    if leaf is None:
        return [b"" if column.kind == "bytes" else ""] * len(rows)
    if column.kind == "bytes":
        return leaf.packed(rows) if shape.kind == "number" else list(leaf.values(rows))
    if leaf.lengths is not None:
        return [str(value) for value in leaf.arrays(rows, leaf.lengths[1]).tolist()]
    return list(leaf.values(rows)) if leaf.kind == "text" else [str(value) for value in leaf.values(rows)]


_LARGEST = 2**63


class NumberList(Leaf):
    """One number per message; whole numbers stay whole as long as none is missing (None)."""

    def __init__(self, values: Sequence[Any], unit: str = "", dtype: np.dtype[Any] | None = None) -> None:
        self.unit = unit
        self._values = numbers(values, dtype)
        self.dtype = self._values.dtype

    def values(self, rows: RowNumbers) -> NDArray[Any]:
        return self._values[rows]


class ArrayList(Leaf):
    """An array of numbers per message."""

    def __init__(self, values: Sequence[Sequence[Any]], dtype: np.dtype[Any] | None = None) -> None:
        self._values = [numbers(value, dtype) for value in values]
        counts = [len(value) for value in values]
        self.lengths = (min(counts, default=0), max(counts, default=0))
        self.dtype = dtype or np.result_type(np.int64, *{value.dtype for value in self._values if len(value)})

    def values(self, rows: RowNumbers) -> list[Any]:
        return [self._values[row].tolist() for row in rows.tolist()]

    def arrays(self, rows: RowNumbers, width: int) -> NDArray[Any]:
        if self.lengths == (width, width):
            stacked = [self._values[row] for row in rows.tolist()]
            return np.array(stacked, dtype=self.dtype).reshape(len(rows), width)
        padded = np.full((len(rows), width), np.nan)
        for number, row in enumerate(rows.tolist()):
            padded[number, : len(self._values[row])] = self._values[row]
        return padded

    def packed(self, rows: RowNumbers) -> list[bytes]:
        return [self._values[row].astype(self.dtype).tobytes() for row in rows.tolist()]


class ObjectList(Leaf):
    """Texts or bytes."""

    def __init__(self, values: Sequence[Any], kind: Kind) -> None:
        self.kind = kind
        self.dtype = np.dtype(np.str_ if kind == "text" else object)
        self._values = values

    def values(self, rows: RowNumbers) -> list[Any]:
        return [self._values[row] for row in rows.tolist()]


def numbers(values: Sequence[Any], dtype: np.dtype[Any] | None) -> NDArray[Any]:
    """Array of numbers: None becomes NaN; whole numbers beyond 64 bits become the nearest float."""
    if dtype is not None and None not in values:
        return np.array(values, dtype=dtype)
    if dtype is None and all(isinstance(value, int) and -_LARGEST <= value < _LARGEST for value in values):
        return np.array(values, dtype=np.int64)
    return np.array([_as_float(value) for value in values], dtype=np.float64)


def _as_float(value: Any) -> float:
    if value is None:
        return float("nan")
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


_KEPT_BYTES = 64 << 20
_PLAIN_BYTES = 96 << 20


class MemoryBudget:
    """Bytes of payloads that all topics together may keep in memory."""

    def __init__(self, size: int = 192 << 20) -> None:
        self._left = size

    def reserve(self, size: int) -> bool:
        """Reserve `size` bytes. False if they do not fit."""
        if size > min(self._left, _KEPT_BYTES):
            return False
        self._left -= size
        return True


@dataclass(frozen=True, slots=True)
class TopicSurvey:
    """Result of one pass over a topic's messages."""

    stamp_ns: NDArray[np.int64]
    place: NDArray[np.int64]
    columns: Mapping[str, Column]
    shapes: Shapes
    good: tuple[NDArray[np.bool_], ...]
    """For each batch, the rows that could be decoded."""
    kept: tuple[DecodedBatch, ...] | None
    """The decoded batches, if they are small enough."""
    undecoded: int
    why: str
    back_in_time: int


class TopicTable(Table):
    """Messages of one topic in the order of the file. Stamps are log times.

    All messages are read once, at the first use of length, stamps, offsets, columns or values. Messages that cannot be
    decoded are omitted and counted in `LogHealth.undecoded`. An offset is the position in the uncompressed file.

    distrust: called if the number of messages is not `count`. It returns whether to read again, without the message
    indexes.
    """

    def __init__(
        self,
        name: str,
        count: int,
        batches: Callable[[], Iterator[PayloadBatch]],
        decoder: Callable[[], Decoder],
        unit: Callable[[str], str],
        budget: MemoryBudget,
        distrust: Callable[[str], bool],
    ) -> None:
        self.name = name
        self._count = count
        self._batches = batches
        self._make_decoder = decoder
        self._unit = unit
        self._budget = budget
        self._distrust = distrust
        self._decoder: Decoder | None = None
        self._seen: TopicSurvey | None = None
        self._why = ""
        self._plains: dict[str, NDArray[Any]] | None = None

    @property
    def columns(self) -> Mapping[str, Column]:
        return self.survey().columns

    def __len__(self) -> int:
        return len(self.survey().stamp_ns)

    @property
    def indexed_rows(self) -> int:
        return self._count if self._seen is None else len(self._seen.stamp_ns)

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        return self.survey().stamp_ns

    @property
    def file_offset(self) -> NDArray[np.int64]:
        return self.survey().place

    @property
    def surveyed(self) -> TopicSurvey | None:
        """The survey; None before the messages were read."""
        return self._seen

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        """See Table; raw has no effect."""
        seen = self.survey()
        described = seen.columns[column]
        wanted = np.arange(len(seen.stamp_ns), dtype=np.intp)[rows]
        order = None
        if len(wanted) > 1 and not (np.diff(wanted) > 0).all():
            wanted, order = np.unique(wanted, return_inverse=True)
        # A column of one number per row, if messages are not kept: all such columns are read at once, and
        # cached.
        if seen.kept is not None:
            values = None
        else:
            if self._plains is None:
                names = [name for name, one in seen.columns.items() if one.kind == "number" and one.shape == ()]
                names = names[: _PLAIN_BYTES // (8 * max(len(seen.stamp_ns), 1))]
                blocks: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
                every = np.arange(len(seen.stamp_ns), dtype=np.intp)
                if column in names:
                    for leaves, rows in self._parts(seen, None, every):
                        for name, block in blocks.items():
                            block.append(seen.shapes.values(seen.columns[name], [(leaves, rows)]))
                    self._plains = {name: np.concatenate(block) for name, block in blocks.items()}
            values = None if self._plains is None else self._plains.get(column)
        if values is not None:
            return values[wanted if order is None else wanted[order]]
        values = seen.shapes.values(described, self._parts(seen, column, wanted))
        return values if order is None else values[order]

    def payloads(self) -> Iterator[bytes]:
        """Every message as stored, including those that cannot be decoded."""
        for batch in self._batches():
            for row in range(len(batch)):
                yield batch.payload(row)

    def survey(self) -> TopicSurvey:
        """Read all messages once."""
        if self._seen is None:
            why = self.why_undecodable()
            try:
                self._seen = self._survey(self._decoder, why)
            except UndecodableError as reason:
                self._decoder = None
                self._seen = self._survey(None, str(reason))
        return self._seen

    def why_undecodable(self) -> str:
        """Reason why none of its messages can be decoded, from the schema; "" if they can."""
        if self._decoder is None and not self._why:
            try:
                self._decoder = self._make_decoder()
            except UndecodableError as reason:
                self._why = str(reason)
        return self._why

    def _survey(self, decoder: Decoder | None, why: str) -> TopicSurvey:
        shapes = Shapes(decoder is not None and decoder.open_ended)
        stamps, places = list[NDArray[np.int64]](), list[NDArray[np.int64]]()
        goods, parts, held = list[NDArray[np.bool_]](), list[DecodedBatch](), 0
        for batch in self._batches():
            good = np.ones(len(batch), dtype=np.bool_)
            if decoder is not None:
                part = decoder.decode(batch, None)
                good = part.good
                if good.any():
                    shapes.add(part.leaves)
                held += len(batch.data)
                parts = [*parts, part] if held <= _KEPT_BYTES else []
            goods.append(good)
            stamps.append(batch.stamp_ns)
            places.append(batch.place)
        good = _joined(goods, np.bool_)
        if len(good) != self._count and self._distrust(f"{self.name} has {len(good)} messages, not {self._count}"):
            self._count = len(good)
            return self._survey(decoder, why)
        stamp_ns, place = _joined(stamps, np.int64)[good], _joined(places, np.int64)[good]
        stamp_ns.flags.writeable = place.flags.writeable = False
        columns = {
            name: replace(column, unit=unit, raw_unit=unit) if (unit := column.unit or self._unit(name)) else column
            for name, column in shapes.columns(len(stamp_ns)).items()
        }
        return TopicSurvey(
            stamp_ns=stamp_ns,
            place=place,
            columns=columns,
            shapes=shapes,
            good=tuple(goods),
            kept=tuple(parts) if decoder is not None and self._budget.reserve(held) else None,
            undecoded=int((~good).sum()) if decoder is not None else len(good),
            why=why or "its messages are shorter than their definition says",
            back_in_time=steps_back(stamp_ns),
        )

    def _parts(
        self, seen: TopicSurvey, column: str | None, wanted: NDArray[np.intp]
    ) -> Iterator[tuple[Mapping[str, Leaf], RowNumbers]]:
        """Batches that have wanted rows (ascending), and these rows in each."""
        assert self._decoder is not None
        first = 0
        batches: Iterator[Any] = repeat(None) if seen.kept is not None else self._batches()
        for number, (good, batch) in enumerate(zip(seen.good, batches, strict=False)):
            rows = np.flatnonzero(good)
            begin, end = np.searchsorted(wanted, (first, first + len(rows)))
            chosen = rows[wanted[begin:end] - first]
            first += len(rows)
            if len(chosen):
                part = seen.kept[number] if seen.kept is not None else self._decoder.decode(batch, column)
                yield part.leaves, chosen
            if end == len(wanted):
                return


def _joined(arrays: list[NDArray[Any]], dtype: type[Any]) -> NDArray[Any]:
    return np.concatenate(arrays) if arrays else np.zeros(0, dtype=dtype)


def doubtful_rows(tables: Mapping[str, TopicTable]) -> tuple[int, dict[str, tuple[int, str]]]:
    """Known number of rows that go back in time, and by topic the undecodable rows with the reason."""
    back, undecoded = 0, dict[str, tuple[int, str]]()
    for name, table in tables.items():
        seen, why = table.surveyed, table.why_undecodable()
        back += seen.back_in_time if seen is not None else 0
        if seen is not None and seen.undecoded:
            undecoded[name] = seen.undecoded, seen.why
        elif why:
            undecoded[name] = table.indexed_rows, why
    return back, undecoded
