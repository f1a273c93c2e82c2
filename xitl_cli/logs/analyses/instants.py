"""Instants and spans as the sentences and tables of analyses give them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.query.times import zero_ns
from xitl_cli.logs.sections import Grid, Value
from xitl_cli.logs.text import clock_text
from xitl_cli.logs.timeline.line import LaidLog, TimeLine

MOST_ROWS = 500


class Instants:
    """A log's stamps on the time line of the report, else in seconds since its own zero (selecting.times.zero_ns)."""

    def __init__(self, log: Log) -> None:
        self.start_ns, self.end_ns = log.span_ns or (0, 0)
        self._line = log.time_line if isinstance(log, LaidLog) else TimeLine(zero_ns(log))

    def second(self, at_ns: int) -> float:
        """For tables and facts, to a millisecond."""
        return round(self._line.second(at_ns), 3)

    def text(self, at_ns: int) -> str:
        """For sentences: 1:46.5."""
        return clock_text(self._line.second(at_ns))


def number(value: float | np.floating | None, digits: int = 3) -> float | None:
    """Rounded, None for what is no number: for facts and tables."""
    if value is None or not np.isfinite(value):
        return None
    return round(float(value), digits)


def spans_where(stamp_ns: NDArray[np.int64], mask: NDArray[np.bool_], join_s: float = 0.0) -> list[tuple[int, int]]:
    """From the first to the last row of each run of rows where `mask` is true; runs closer than `join_s` are one."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    spans: list[tuple[int, int]] = []
    for first, after in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin, end = int(stamp_ns[first]), int(stamp_ns[after - 1])
        if end < begin:
            continue
        if spans and 0 <= begin - spans[-1][1] <= join_s * 1e9:
            spans[-1] = (spans[-1][0], max(end, spans[-1][1]))
        else:
            spans.append((begin, end))
    return spans


def length_s(spans: Sequence[tuple[int, int]]) -> float:
    return sum((until - begin) * 1e-9 for begin, until in spans)


def inside(stamp_ns: NDArray[np.int64], spans: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Rows stamped within one of the spans, ends included."""
    if not spans:
        return np.zeros(len(stamp_ns), dtype=np.bool_)
    edges = np.array(sorted(spans), dtype=np.int64)
    begins, ends = edges[:, 0], np.maximum.accumulate(edges[:, 1])
    last = np.searchsorted(begins, stamp_ns, side="right") - 1
    found: NDArray[np.bool_] = (last >= 0) & (stamp_ns <= ends[last])
    return found


def grid(key: str, title: str, columns: tuple[str, ...], rows: Sequence[tuple[Value, ...]]) -> Grid:
    """A table of at most 500 rows, which says so in its title when there were more."""
    if len(rows) > MOST_ROWS:
        title = f"{title} (the first {MOST_ROWS} of {len(rows)})"
    return Grid(key, title, columns, tuple(rows[:MOST_ROWS]))
