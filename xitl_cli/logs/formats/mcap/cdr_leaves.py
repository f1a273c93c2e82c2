"""Fields of CDR messages, read when they are asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap.decoded import Index, Leaf
from xitl_cli.logs.formats.mcap.gather import Batch
from xitl_cli.logs.table import Kind

Place = int | NDArray[np.int64]
"""In a message, from its begin: one for all messages, or (n,)."""

_KNOWN_TEXTS = 10_000


def gathered(
    data: bytes, start: NDArray[np.int64], stride: int | None, place: Place, dtype: np.dtype[Any], count: int | None
) -> NDArray[Any]:
    """(n,) or (n, count) values at `place` in messages beginning at `start`; all must be inside of `data`.

    stride: from message to message, None when it differs.
    """
    inner, strides = ((), ()) if count is None else ((count,), (dtype.itemsize,))
    if not len(start) or count == 0:
        return np.zeros((len(start), *inner), dtype=dtype)
    if stride is not None and isinstance(place, int):
        offset = int(start[0]) + place
        return np.ndarray((len(start), *inner), dtype, data, offset, (stride, *strides)).copy()
    span = dtype.itemsize * (1 if count is None else count)
    view = np.ndarray((len(data) - span + 1, *inner), dtype, data, 0, (1, *strides))
    return view[start + place]  # type: ignore[no-any-return]


def of_rows(place: Place, rows: Index) -> Place:
    return place if isinstance(place, int) else place[rows]


def even(start: NDArray[np.int64]) -> int | None:
    """The distance from message to message when it is always the same."""
    if len(start) < 2:
        return 0 if len(start) else None
    steps = np.diff(start)
    return int(steps[0]) if (steps == steps[0]).all() else None


class Field(Leaf):
    """What begins at `place` in each message of a batch."""

    def __init__(self, batch: Batch, place: Place) -> None:
        self.batch = batch
        self.place = place

    def read(self, rows: Index, dtype: np.dtype[Any], count: int | None = None) -> NDArray[Any]:
        start = self.batch.start[rows]
        values = gathered(self.batch.data, start, even(start), of_rows(self.place, rows), dtype, count)
        return values.astype(dtype.newbyteorder("="), copy=False)

    def slices(self, rows: Index, count: Place, size: int) -> list[bytes]:
        """`count` times `size` bytes of each message."""
        begin = self.batch.start[rows] + of_rows(self.place, rows)
        end = begin + np.asarray(of_rows(count, rows)) * size
        data = self.batch.data
        return [data[first:last] for first, last in zip(begin.tolist(), end.tolist(), strict=True)]


class Scalar(Field):
    """A number."""

    def __init__(self, batch: Batch, place: Place, stored: np.dtype[Any]) -> None:
        super().__init__(batch, place)
        self.stored = stored
        self.dtype = stored.newbyteorder("=")

    def take(self, rows: Index) -> NDArray[Any]:
        return self.read(rows, self.stored)


class Instant(Field):
    """Seconds and nanoseconds as nanoseconds."""

    unit = "ns"
    dtype = np.dtype(np.int64)

    def __init__(self, batch: Batch, place: Place, order: str) -> None:
        super().__init__(batch, place)
        self.stored = np.dtype([("sec", order + "i4"), ("nanosec", order + "u4")])

    def take(self, rows: Index) -> NDArray[Any]:
        values = self.read(rows, self.stored)
        stamp_ns: NDArray[np.int64] = values["sec"].astype(np.int64) * 1_000_000_000 + values["nanosec"]
        return stamp_ns


class Count(Leaf):
    """How many elements an array has."""

    dtype = np.dtype(np.int64)

    def __init__(self, count: Place) -> None:
        self._count = count

    def take(self, rows: Index) -> NDArray[Any]:
        return np.broadcast_to(np.asarray(of_rows(self._count, rows), dtype=np.int64), (len(rows),)).copy()


class Numbers(Field):
    """An array of `count` numbers. good: the messages that count for its extent, once all have been read."""

    def __init__(
        self, batch: Batch, place: Place, count: Place, stored: np.dtype[Any], good: NDArray[np.bool_]
    ) -> None:
        super().__init__(batch, place)
        self._count = count
        self._good = good
        self.stored = stored
        self.dtype = stored.newbyteorder("=")

    @property
    def lengths(self) -> tuple[int, int] | None:  # type: ignore[override]
        count = self._count
        if isinstance(count, int):
            return count, count
        return int(count[self._good].min()), int(count[self._good].max())

    def take(self, rows: Index) -> list[Any]:
        return list(self.packed(rows))

    def arrays(self, rows: Index, width: int) -> NDArray[Any]:
        counts = np.broadcast_to(np.asarray(of_rows(self._count, rows)), (len(rows),))
        if (counts == width).all():
            return self.read(rows, self.stored, width)
        padded = np.full((len(rows), width), np.nan)
        for count in np.unique(counts).tolist():
            mine = np.flatnonzero(counts == count)
            padded[mine, :count] = self.read(rows[mine], self.stored, count)
        return padded

    def packed(self, rows: Index) -> list[bytes]:
        return self.slices(rows, self._count, self.stored.itemsize)


class Blob(Field):
    """A sequence of `count` octets."""

    kind: Kind = "bytes"
    dtype = np.dtype(object)

    def __init__(self, batch: Batch, place: Place, count: Place) -> None:
        super().__init__(batch, place)
        self._count = count

    def take(self, rows: Index) -> list[Any]:
        return list(self.slices(rows, self._count, 1))


class String(Field):
    """`count` bytes with a NUL at their end, or characters of `wide` bytes each, in this order of bytes, without."""

    kind: Kind = "text"
    dtype = np.dtype(np.str_)

    def __init__(self, batch: Batch, place: Place, count: Place, wide: int, order: str) -> None:
        super().__init__(batch, place)
        self._count = count
        self._wide = wide
        self._order = order

    def take(self, rows: Index) -> list[Any]:
        known: dict[bytes, str] = {}
        texts = []
        for stored in self.slices(rows, self._count, self._wide or 1):
            text = known.get(stored)
            if text is None:
                text = self._decoded(stored)
                if len(known) < _KNOWN_TEXTS:
                    known[stored] = text
            texts.append(text)
        return texts

    def _decoded(self, stored: bytes) -> str:
        if not self._wide:
            return stored[:-1].decode("utf-8", "replace")
        units = np.frombuffer(stored, dtype=f"{self._order}u{self._wide}").astype("<u2")
        return units.tobytes().decode("utf-16-le", "replace")
