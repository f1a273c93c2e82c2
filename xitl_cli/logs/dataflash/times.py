"""When rows were written, over all types of a log: its span, rows that go back, the time of rows that tell none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.dataflash.chain import u64_at
from xitl_cli.logs.dataflash.formats import HEAD_BYTES
from xitl_cli.logs.dataflash.heads import Bytes, Places
from xitl_cli.logs.dataflash.table import DataFlashTable, stamps_ns

_ROWS = 1 << 20
"""Rows whose time is looked at in one go."""

Stamps = NDArray[np.int64]


class Times(Protocol):
    def span_ns(self) -> tuple[int, int] | None: ...

    def back_in_time(self) -> int:
        """Rows stamped earlier than the one before of their type."""
        ...

    def last_before(self, place: Places) -> Stamps:
        """Of the last row before each place that tells its time; 0 at the log's start."""
        ...


class TimesInHeads:
    """Of a log whose timed records all begin with their time in microseconds: read in the order of the file.

    timed: (256,) whether records of a type do.
    """

    def __init__(self, data: Bytes, place: Places, type_id: Bytes, timed: NDArray[np.bool_]) -> None:
        self._data, self._place, self._type_id, self._timed = data, place, type_id, timed

    def _some(self, at: int) -> tuple[Stamps, Bytes]:
        """Stamps and types of the timed ones among so many rows."""
        type_id = self._type_id[at : at + _ROWS]
        timed = np.flatnonzero(self._timed[type_id])
        return self._stamps(self._place[at : at + _ROWS][timed]), type_id[timed]

    def _stamps(self, place: Places) -> Stamps:
        return stamps_ns(u64_at(self._data, place + HEAD_BYTES), 1_000)

    def span_ns(self) -> tuple[int, int] | None:
        lowest, highest = [], []
        for at in range(0, len(self._place), _ROWS):
            stamps, _ = self._some(at)
            if len(stamps):
                lowest.append(int(stamps.min()))
                highest.append(int(stamps.max()))
        return (min(lowest), max(highest)) if lowest else None

    def back_in_time(self) -> int:
        last = np.full(256, np.iinfo(np.int64).min)
        back = 0
        for at in range(0, len(self._place), _ROWS):
            stamps, type_id = self._some(at)
            if not len(stamps):
                continue
            order = np.argsort(type_id, kind="stable")
            stamps, type_id = stamps[order], type_id[order]
            first = np.flatnonzero(np.concatenate(([True], type_id[1:] != type_id[:-1])))
            earlier = np.concatenate(([0], stamps[:-1]))
            earlier[first] = last[type_id[first]]
            back += int(np.count_nonzero(stamps < earlier))
            final = np.concatenate((first[1:] - 1, [len(stamps) - 1]))
            last[type_id[final]] = stamps[final]
        return back

    def last_before(self, place: Places) -> Stamps:
        places = self._place[np.flatnonzero(self._timed[self._type_id])]
        at = np.searchsorted(places, place) - 1
        found = np.zeros(len(place), np.int64)
        known = at >= 0
        found[known] = self._stamps(places[at[known]])
        return found


class TimesInColumns:
    """Of any other log."""

    def __init__(self, tables: Sequence[DataFlashTable]) -> None:
        self._tables = [table for table in tables if table.timed]

    def span_ns(self) -> tuple[int, int] | None:
        if not self._tables:
            return None
        stamps = [table.stamp_ns for table in self._tables]
        return min(int(some.min()) for some in stamps), max(int(some.max()) for some in stamps)

    def back_in_time(self) -> int:
        return sum(int(np.count_nonzero(np.diff(table.stamp_ns) < 0)) for table in self._tables)

    def last_before(self, place: Places) -> Stamps:
        if not self._tables:
            return np.zeros(len(place), np.int64)
        places = np.concatenate([table.place for table in self._tables])
        order = np.argsort(places, kind="stable")
        stamps = np.concatenate([table.stamp_ns for table in self._tables])[order]
        at = np.searchsorted(places[order], place) - 1
        return np.where(at >= 0, stamps[np.maximum(at, 0)], 0)
