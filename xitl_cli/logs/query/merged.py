"""Rows of several messages in the order of the file, a handful at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.query.conditions import Condition
from xitl_cli.logs.table import Table

_FIRST, _MOST = 256, 16_384
_SEQUENTIAL_BYTES = 64 << 20


@dataclass(frozen=True, slots=True)
class Batch:
    """One stretch of the file. rows: of each table, ascending; order: (n,) which table's next row comes when."""

    rows: tuple[NDArray[np.intp], ...]
    order: NDArray[np.intp]

    def first(self, count: int | None) -> Batch:
        """No more rows than `count`, if that is a number."""
        if count is None or count >= len(self.order):
            return self
        order = self.order[:count]
        return Batch(tuple(rows[: np.count_nonzero(order == own)] for own, rows in enumerate(self.rows)), order)


def merged(
    tables: Sequence[Table],
    from_ns: int | None,
    until_ns: int | None,
    condition: Condition | None,
    zero_ns: int,
    at_once: int = _MOST,
    *,
    raw: bool = False,
) -> Iterator[Batch]:
    """Whatever is not asked for is not read: the first batches are small, and each is chosen when it is its turn."""
    if condition is not None:
        for table in tables:
            condition.holds(table, slice(0, 1), zero_ns, raw=raw)  # its names are wrong now, not after a thousand rows
    chosen = [inside(table, from_ns, until_ns) for table in tables]
    owner = np.concatenate([np.full(len(rows), number, np.intp) for number, rows in enumerate(chosen)])
    rows = np.concatenate(chosen)
    if len(tables) > 1:
        place = np.concatenate([table.place[rows] for table, rows in zip(tables, chosen, strict=True)])
        order = np.argsort(place, kind="stable")
        owner, rows = owner[order], rows[order]
    begin, size = 0, _FIRST
    while begin < len(rows):
        batch = _batch(tables, owner[begin : begin + size], rows[begin : begin + size], condition, zero_ns, raw)
        if len(batch.order):
            yield batch
        begin, size = begin + size, min(size * 2, at_once)


def rows_at_once(log: Log, tables: Sequence[Table]) -> int:
    """As many as memory has room for where a log is read from its beginning for any of its rows, else a handful."""
    if log.format != "mcap":
        return _MOST
    widest = max(sum(math.prod(map(abs, column.shape)) for column in table.columns.values()) for table in tables)
    return max(_MOST, _SEQUENTIAL_BYTES // (8 * max(widest, 1)))


def inside(table: Table, from_ns: int | None, until_ns: int | None) -> NDArray[np.intp]:
    """Rows stamped from `from_ns` to `until_ns`, both included; None: no limit."""
    if from_ns is None and until_ns is None:
        return np.arange(len(table), dtype=np.intp)
    stamps = table.stamp_ns
    inside = np.ones(len(stamps), dtype=np.bool_)
    if from_ns is not None:
        inside &= stamps >= from_ns
    if until_ns is not None:
        inside &= stamps <= until_ns
    return np.flatnonzero(inside)


def _batch(
    tables: Sequence[Table],
    owner: NDArray[np.intp],
    rows: NDArray[np.intp],
    condition: Condition | None,
    zero_ns: int,
    raw: bool,
) -> Batch:
    kept = np.ones(len(rows), dtype=np.bool_)
    if condition is not None:
        for number, table in enumerate(tables):
            own = np.flatnonzero(owner == number)
            if len(own):
                kept[own] = condition.holds(table, rows[own], zero_ns, raw=raw)
    owner, rows = owner[kept], rows[kept]
    return Batch(tuple(rows[owner == number] for number in range(len(tables))), owner)
