"""When rows were written, over all types of a log: its span, rows that go back, the time of rows that tell none.

DataFlash has no checksum: a damaged time reads like any other, and one bit of it would stretch a run to years. In the
order of the file time only grows, but for pauses and restarts, which are far from what is before or from what is after
them. A row that is far from both, and on the same side, has a time that cannot be; so has the first or last row when it
is very far. It is stamped as the row before it, as rows are that tell no time, and counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.formats import HEAD_BYTES
from xitl_cli.logs.formats.dataflash.heads import Bytes, Places, u64_at
from xitl_cli.logs.table import steps_back

FAR_NS = 10_000_000_000
VERY_FAR_NS = 3_600_000_000_000
_AROUND = 16
"""Rows before and after a row against which it is held."""
_ROWS = 1 << 16
"""Rows whose time is looked at in one go: what they take of the file stays in the processor's cache."""
_DOUBTFUL_ROWS = 1 << 16
_LATEST_NS = np.iinfo(np.int64).max

Stamps = NDArray[np.int64]
Block = tuple[Places, Bytes]
"""(n,) places, rising, and types of rows that tell their time."""


class Timed(Protocol):
    """A table of which every row tells its time."""

    @property
    def place(self) -> Places: ...

    def told_ns(self) -> Stamps: ...


@dataclass(frozen=True, slots=True)
class _Survey:
    span_ns: tuple[int, int] | None
    back_in_time: int
    jumps: bool


@dataclass(frozen=True, slots=True)
class _Mended:
    """Rows with a time that cannot be, by place, and the stamp that they get."""

    place: Places
    stamp_ns: Stamps


class Times:
    """blocks: the rows that tell their time, in the order of the file. told_ns: what those at these places tell."""

    def __init__(self, blocks: Callable[[], Iterator[Block]], told_ns: Callable[[Places], Stamps]) -> None:
        self._blocks = blocks
        self._told_ns = told_ns

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self._whole[0].span_ns

    @property
    def back_in_time(self) -> int:
        """Rows stamped earlier than the one before of their type."""
        return self._whole[0].back_in_time

    @property
    def replaced(self) -> int:
        """Rows with a time that cannot be."""
        return len(self._whole[1].place)

    def last_before(self, place: Places) -> Stamps:
        """Of the last row before each place that tells its time; 0 at the log's start."""
        found = np.zeros(len(place), np.int64)
        for places, _ in self._blocks():
            at = np.searchsorted(places, place) - 1
            behind = np.flatnonzero(at >= 0)
            before = places[at[behind]]
            found[behind] = self.mended(before, self._told_ns(before))
        return found

    def mended(self, place: Places, told_ns: Stamps) -> Stamps:
        """What rows at these places tell, but for those that cannot be."""
        return _mended(self._whole[1], place, told_ns)

    @cached_property
    def _whole(self) -> tuple[_Survey, _Mended]:
        nothing = _Mended(np.empty(0, np.int64), np.empty(0, np.int64))
        found = self._survey(nothing)
        if not found.jumps:
            return found, nothing
        places = [place for place, _ in self._blocks()]
        stamp_ns = np.concatenate([self._told_ns(place) for place in places])
        wrong = implausible(stamp_ns)
        if not len(wrong):
            return found, nothing
        right = np.ones(len(stamp_ns), np.bool_)
        right[wrong] = False
        trusted = np.flatnonzero(right)
        before = np.maximum(np.searchsorted(trusted, wrong) - 1, 0)
        mended = _Mended(np.concatenate(places)[wrong], stamp_ns[trusted[before]])
        return self._survey(mended), mended

    def _survey(self, mended: _Mended) -> _Survey:
        lowest, highest, back, jumps = [], [], 0, False
        last_of = np.full(256, -1)
        last: int | None = None
        for place, type_id in self._blocks():
            if not len(place):
                continue
            stamps = _mended(mended, place, self._told_ns(place))
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
    """Of a log whose timed records all begin with their time in microseconds: nothing else of it is read.

    timed: (256,) whether records of a type do.
    """

    def blocks() -> Iterator[Block]:
        for at in range(0, len(place), _ROWS):
            some = type_id[at : at + _ROWS]
            rows = np.flatnonzero(timed[some])
            yield place[at : at + _ROWS][rows], some[rows]

    return Times(blocks, lambda places: stamps_ns(u64_at(data, places + HEAD_BYTES), 1_000))


def times_in_columns(tables: Sequence[Timed]) -> Times:
    """Of any other log. At most 256 tables."""
    place = np.concatenate([np.empty(0, np.int64), *(table.place for table in tables)])
    order = np.argsort(place, kind="stable")
    place = place[order]
    stamp_ns = np.concatenate([np.empty(0, np.int64), *(table.told_ns() for table in tables)])[order]
    number = np.repeat(np.arange(len(tables), dtype=np.uint8), [len(table.place) for table in tables])[order]
    return Times(lambda: iter([(place, number)]), lambda places: stamp_ns[np.searchsorted(place, places)])


def _back_in_time(stamps: Stamps, type_id: Bytes, last_of: Stamps) -> int:
    """Rows earlier than the one before of their type. last_of: (256,) by type the row before these; kept up."""
    if int(stamps[0]) >= int(last_of.max()) and not steps_back(stamps):
        last_of[type_id] = stamps  # of several of a type the last
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
    """From counts of a unit since boot; one that is too large, or negative, becomes the nearest that there can be."""
    return np.asarray(np.clip(counted, 0, _LATEST_NS // unit_ns).astype(np.int64) * unit_ns)


def implausible(stamp_ns: Stamps) -> NDArray[np.intp]:
    """Which of the rows, in the order of the file, have a time that cannot be. Stamps are not negative."""
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
    """How far each row is from the median of those on one side of it; NaN where there are none."""
    around = rows[:, None] + side * np.arange(1, _AROUND + 1)
    there = (around >= 0) & (around < len(stamp_ns))
    values = np.where(there, stamp_ns[np.where(there, around, 0)], _LATEST_NS)
    values.sort(axis=1)
    count = there.sum(axis=1)
    median = values[np.arange(len(rows)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, (stamp_ns[rows] - median).astype(np.float64), np.nan)


def _mended(mended: _Mended, place: Places, told_ns: Stamps) -> Stamps:
    if not len(mended.place) or not len(place):
        return told_ns
    at = np.minimum(np.searchsorted(mended.place, place), len(mended.place) - 1)
    return np.where(mended.place[at] == place, mended.stamp_ns[at], told_ns)
