"""Spans of time: runs of rows, rows inside spans, values that do not change, pauses of the whole log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.model.log import Log, once_per_log
from xitl_cli.logs.model.table import Flags, Floats, Stamps, distinct


def runs(flags: Flags) -> list[tuple[int, int]]:
    """First row of each run of true rows, and the row after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def join_runs(found: Sequence[tuple[int, int]], rows: int) -> list[tuple[int, int]]:
    """Join runs that are fewer than `rows` rows apart."""
    joined: list[tuple[int, int]] = []
    for begin, after in found:
        if joined and begin - joined[-1][1] < rows:
            joined[-1] = joined[-1][0], after
        else:
            joined.append((begin, after))
    return joined


def held_spans(stamp_ns: Stamps, flags: Flags) -> list[tuple[int, int]]:
    """Begin and end (ns) of each run of true rows; a row lasts until the next row."""
    last = len(stamp_ns) - 1
    return [(int(stamp_ns[begin]), int(stamp_ns[min(after, last)])) for begin, after in runs(flags)]


def spans_where(stamp_ns: Stamps, mask: Flags, join_s: float = 0.0) -> list[tuple[int, int]]:
    """Spans from the first to the last row of each run of rows with a true `mask`.

    Runs at most `join_s` apart are joined.
    """
    spans: list[tuple[int, int]] = []
    for first, after in runs(mask):
        begin, end = int(stamp_ns[first]), int(stamp_ns[after - 1])
        if end < begin:
            continue
        if spans and 0 <= begin - spans[-1][1] <= join_s * 1e9:
            spans[-1] = (spans[-1][0], max(end, spans[-1][1]))
        else:
            spans.append((begin, end))
    return spans


_BRIDGE_S = 2.0


def spells(stamp_ns: Stamps, flags: Flags, bridge_s: float = _BRIDGE_S, most: int = 8) -> list[tuple[int, int]]:
    """Episodes of flagged rows, from the first to the last flagged row (ns).

    Pauses of at most `bridge_s` are bridged. Longer pauses separate episodes, so that no episode covers a healthy time.
    Returns the `most` longest, in order of time.
    """
    order = np.argsort(stamp_ns, kind="stable")
    every = spans_where(stamp_ns[order], flags[order], bridge_s)
    return sorted(sorted(every, key=lambda span: span[0] - span[1])[:most])


def length_s(spans: Sequence[tuple[int, int]]) -> float:
    return sum((until - begin) * 1e-9 for begin, until in spans)


def inside(stamp_ns: Stamps, spans: Sequence[tuple[int, int]]) -> Flags:
    """Rows stamped within one of the spans, ends included."""
    if not spans:
        return np.zeros(len(stamp_ns), dtype=np.bool_)
    edges = np.array(sorted(spans), dtype=np.int64)
    begins, ends = edges[:, 0], np.maximum.accumulate(edges[:, 1])
    last = np.searchsorted(begins, stamp_ns, side="right") - 1
    rows: Flags = (last >= 0) & (stamp_ns <= ends[last])
    return rows


_LONGER_THAN_USUAL = 20.0  # geometric runs of mean 2 reach 20 times that once in 10^12
_FEWEST = 10


@dataclass(frozen=True, slots=True)
class HeldRows:
    """Rows `first` to `last`, both included, have the same values."""

    first: int
    last: int


@dataclass(frozen=True, slots=True)
class HoldStatistics:
    """Statistics of repeated rows."""

    repeated: float
    """Share of the rows that equal the previous row."""
    usual: float
    """Mean length in rows of the runs of equal rows, without the much longer runs in `holds`."""
    holds: tuple[HeldRows, ...]


def find_holds(values: Floats, period_s: float, shortest_s: float = 1.0, resolution: float = 0.0) -> HoldStatistics:
    """Find holds in rows (N,) or (N, k).

    A hold lasts at least `shortest_s`, ten rows, and twenty times the usual length in this record. resolution: greatest
    difference of equal values.
    """
    rows = values.reshape(len(values), -1)
    if len(rows) < 2:
        return HoldStatistics(0.0, 1.0, ())
    same = (rows[1:] == rows[:-1]).all(axis=1)
    if resolution > 0.0:
        same |= _within(rows, resolution)
    begins = np.flatnonzero(np.concatenate(([True], ~same)))
    lengths = np.diff(np.concatenate((begins, [len(rows)])))
    least = max(_FEWEST, math.ceil(shortest_s / period_s))
    others = lengths[lengths < least]
    usual = float(others.mean()) if len(others) else float(lengths.mean())
    long = np.flatnonzero(lengths >= max(least, math.ceil(_LONGER_THAN_USUAL * usual)))
    holds = tuple(HeldRows(int(begins[place]), int(begins[place] + lengths[place] - 1)) for place in long)
    return HoldStatistics(float(same.mean()), usual, holds)


def _within(rows: Floats, resolution: float) -> Flags:
    """(N - 1,) whether a row and the one before belong to a run of rows that all differ by `resolution` at most."""
    close: Flags = np.all(np.abs(np.diff(rows, axis=0)) <= resolution, axis=1)
    begins = np.flatnonzero(np.concatenate(([True], ~close)))
    spread = np.maximum.reduceat(rows, begins) - np.minimum.reduceat(rows, begins)
    of_run = np.cumsum(np.concatenate(([True], ~close))) - 1
    narrow: Flags = np.all(spread <= resolution, axis=1)
    found: Flags = np.logical_and(close, narrow[of_run[1:]])
    return found


_DENSE_HZ = 4.0
_SHORTEST_NS = 20_000_000
_MOST_TABLES = 12


@once_per_log
def log_pauses(log: Log) -> Stamps:
    """(N, 2) begin and end of every span without rows of any dense message.

    A span is longer than 20 ms and than three times the usual step. Dense messages are the twelve fullest tables with
    at least four rows per second. The result is empty with fewer than two such tables.
    """
    dense = _dense(log)
    if len(dense) < 2:
        return np.empty((0, 2), dtype=np.int64)
    merged = distinct(np.concatenate(dense))
    steps = np.diff(merged)
    wide = np.flatnonzero(steps > max(_SHORTEST_NS, 3.0 * float(np.percentile(steps, 90.0))))
    return np.stack([merged[wide], merged[wide + 1]], axis=1)


@once_per_log
def _dense(log: Log) -> list[Stamps]:
    dense = []
    for table in sorted(log.tables.values(), key=len, reverse=True)[:_MOST_TABLES]:
        stamps = table.stamp_ns
        if len(stamps) >= 10 and 0 < int(stamps[-1]) - int(stamps[0]) < len(stamps) / _DENSE_HZ * 1e9:
            dense.append(stamps)
    return dense


def dense_end_ns(log: Log) -> int | None:
    """End of the dense messages: the median of their last stamps. None if there are none.

    The log may continue with a few rows after it.
    """
    last = [int(stamps[-1]) for stamps in _dense(log)]
    return sorted(last)[len(last) // 2] if last else None


def covered_share(from_ns: Stamps, until_ns: Stamps, spans: Stamps) -> Floats:
    """(G,) share of each from..until that the longest of the spans (N, 2) in it covers.

    Spans are sorted and disjoint. Their sum is not used: while the rest of a log continues slowly, its steps are many
    short spans.
    """
    first = np.searchsorted(spans[:, 1], from_ns, side="right")
    beyond = np.searchsorted(spans[:, 0], until_ns, side="left")
    some = np.flatnonzero(beyond > first)
    share = np.zeros(len(from_ns))
    if not len(some):
        return share
    lengths = np.append(spans[:, 1] - spans[:, 0], 0)
    longest = np.maximum.reduceat(lengths, np.stack([first[some], beyond[some]], axis=1).reshape(-1))[::2]
    share[some] = np.minimum(longest / np.maximum(until_ns[some] - from_ns[some], 1), 1.0)
    return share
