"""Instants and spans as the sentences and tables of analyses give them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Grid, Value

_LONGEST_SINCE_ZERO_NS = 10 * 365 * 86_400 * 10**9
MOST_ROWS = 500


class Instants:
    """A log's stamps as seconds: since its own zero, or since its start where that zero is too long ago to read."""

    def __init__(self, log: Log) -> None:
        span = log.span_ns or (0, 0)
        own = log.base in ("boot", "simulation") and 0 <= span[0] < _LONGEST_SINCE_ZERO_NS
        self.start_ns, self.end_ns = span
        self.zero_ns = 0 if own else span[0]
        self.since_boot = own and log.base == "boot"

    def second(self, at_ns: int) -> float:
        return round((at_ns - self.zero_ns) * 1e-9, 3)

    def text(self, at_ns: int) -> str:
        """42.4 s"""
        return f"{self.second(at_ns):.1f} s"


def length_text(length_s: float) -> str:
    """0.35 s, 12.4 s, 312 s."""
    return f"{length_s:.2f} s" if length_s < 1.0 else f"{length_s:.1f} s" if length_s < 100.0 else f"{length_s:.0f} s"


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
