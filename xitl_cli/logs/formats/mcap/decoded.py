"""What a decoder gives of one batch, and how batches make a column."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap.gather import Batch
from xitl_cli.logs.table import Column, Kind

MOST_ELEMENTS = 32
"""Elements of an array of messages or texts that get columns of their own."""

MOST_NUMBERS = 4096
"""Numbers of an array; longer ones are given as bytes, as stored. So are some very long ones of differing lengths
which padded would not fit into memory."""

MOST_LEAVES = 2000
_MOST_PADDED_BYTES = 1 << 30
_MOST_TEXT_BYTES = 64 << 20

Index = NDArray[np.intp]


class UndecodableError(Exception):
    """A topic cannot be read at all; the reason in words that end a sentence."""


class Leaf:
    """One field of all messages of a batch. lengths: the shortest and longest of an array; None: a single value."""

    kind: Kind = "number"
    unit: str = ""
    dtype: np.dtype[Any]
    lengths: tuple[int, int] | None = None

    def take(self, rows: Index) -> list[Any] | NDArray[Any]:
        """(n,) single values, in an array when they are numbers."""
        raise NotImplementedError

    def arrays(self, rows: Index, width: int) -> NDArray[Any]:
        """(n, width) numbers, padded with NaN when an array of this batch is shorter."""
        raise NotImplementedError

    def packed(self, rows: Index) -> list[bytes]:
        """The numbers of each array as bytes, as stored."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Part:
    """One decoded batch. good: (n,) the rows that could be decoded; leaves by the name of their column."""

    good: NDArray[np.bool_]
    leaves: Mapping[str, Leaf]


class Decoder(Protocol):
    """open_ended: fields may be there in some messages only; the others have NaN or empty text there."""

    open_ended: bool

    def decode(self, batch: Batch, wanted: str | None) -> Part:
        """`wanted`: the one column that is needed, None: all. Raises UndecodableError."""
        ...


@dataclass(slots=True)
class Shape:
    """What is known of a column from the leaves seen so far. seen: in how many batches."""

    kind: Kind
    unit: str
    dtype: np.dtype[Any]
    lengths: tuple[int, int] | None
    seen: int = 1

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
    """The columns of a topic, put together batch by batch."""

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
        """What every batch has, or any of them where messages are open-ended. rows: of the whole table.

        An array that is empty in all of them is no column.
        """
        return {
            name: _column(name, shape, rows)
            for name, shape in self._shapes.items()
            if (self._open_ended or shape.seen == self._batches) and shape.lengths != (0, 0)
        }

    def values(self, column: Column, parts: Iterable[tuple[Mapping[str, Leaf], Index]]) -> NDArray[Any]:
        """One column of all parts, each with the rows wanted of it."""
        shape = self._shapes[column.name]
        if column.kind == "number":
            return _numbers(column, shape, parts)
        values: list[Any] = []
        for leaves, rows in parts:
            values += _objects(column, shape, leaves.get(column.name), rows)
        return texts(values) if column.kind == "text" else objects(values)


def texts(values: Sequence[str]) -> NDArray[Any]:
    """Text of fixed width; of any width when one very long text would make all as wide."""
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


def _numbers(column: Column, shape: Shape, parts: Iterable[tuple[Mapping[str, Leaf], Index]]) -> NDArray[Any]:
    blocks: list[NDArray[Any]] = []
    width = () if shape.lengths is None else (shape.lengths[1],)
    for leaves, rows in parts:
        leaf = leaves.get(column.name)
        if leaf is None:
            blocks.append(np.full((len(rows), *width), np.nan))
        elif width:
            blocks.append(leaf.arrays(rows, width[0]))
        else:
            blocks.append(np.asarray(leaf.take(rows)))
    if blocks:
        return np.concatenate(blocks)
    return np.zeros((0, *width), dtype=np.float64 if column.shape == (-1,) else shape.dtype)


def _objects(column: Column, shape: Shape, leaf: Leaf | None, rows: Index) -> Sequence[Any]:
    if leaf is None:
        return [b"" if column.kind == "bytes" else ""] * len(rows)
    if column.kind == "bytes":
        return leaf.packed(rows) if shape.kind == "number" else list(leaf.take(rows))
    if leaf.lengths is not None:
        return [str(value) for value in leaf.arrays(rows, leaf.lengths[1]).tolist()]
    return list(leaf.take(rows)) if leaf.kind == "text" else [str(value) for value in leaf.take(rows)]
