"""A log without the rows whose stamp cannot be: one flipped bit of a time would stretch a run to years.

DataFlash has no checksum, so such a row is read like any other. In the order of the file time only grows, but for
pauses and restarts; a row that is outside what the rows around it say, by more than SLACK_NS, is left out and counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Base, Format, Health, Log
from xitl_cli.logs.table import Selection, Table

SLACK_NS = 10_000_000_000
_AROUND = 16
_TIMES = {"TimeUS", "TimeMS"}
_LEAST_ROWS = 8


class PlausibleLog:
    """The log with its tables less `left_out` rows."""

    def __init__(self, log: Log, kept: Mapping[str, NDArray[np.bool_]]) -> None:
        self._log = log
        self.left_out = sum(int((~rows).sum()) for rows in kept.values())
        self._tables: dict[str, Table] = {
            name: Selection(table, kept[name]) if name in kept else table
            for name, table in log.tables.items()
            if name not in kept or kept[name].any()
        }

    @property
    def path(self) -> Path:
        return self._log.path

    @property
    def format(self) -> Format:
        return self._log.format

    @property
    def base(self) -> Base:
        return self._log.base

    @property
    def tables(self) -> Mapping[str, Table]:
        return self._tables

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Of the tables with a time of their own; FMT and its like have that of what stands before them."""
        timed = [table for table in self._tables.values() if self.format == "tlog" or _TIMES & set(table.columns)]
        stamps = [table.stamp_ns for table in timed]
        return (int(min(each.min() for each in stamps)), int(max(each.max() for each in stamps))) if stamps else None

    @property
    def health(self) -> Health:
        return self._log.health

    @property
    def facts(self) -> Mapping[str, str]:
        return self._log.facts

    def close(self) -> None:
        self._log.close()

    def __enter__(self) -> PlausibleLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def plausible(log: Log) -> tuple[Log, int]:
    """The log itself where all stamps can be, else one without the others; and how many rows that leaves out."""
    if log.format == "mcap" or not log.tables:  # its chunks have a checksum
        return log, 0
    densest = max(log.tables.values(), key=len)
    if len(densest) < _LEAST_ROWS:
        return log, 0
    good = _steady(densest.stamp_ns)
    places, stamps = densest.place[good], densest.stamp_ns[good]
    kept: dict[str, NDArray[np.bool_]] = {}
    if not good.all():
        kept[densest.name] = good
    low, high = int(stamps.min()) - SLACK_NS, int(stamps.max()) + SLACK_NS
    for name, table in log.tables.items():
        if name == densest.name or not len(table) or _ordered_within(table.stamp_ns, low, high):
            continue
        rows = _between(table, places, stamps)
        if not rows.all():
            kept[name] = rows
    if not kept:
        return log, 0
    found = PlausibleLog(log, kept)
    return found, found.left_out


def _ordered_within(stamp_ns: NDArray[np.int64], low: int, high: int) -> bool:
    return bool(stamp_ns[0] >= low and stamp_ns[-1] <= high and (stamp_ns[1:] >= stamp_ns[:-1]).all())


def _steady(stamp_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Not far on the same side of what is before and of what is after: a pause or a restart is far from one only."""
    good = np.ones(len(stamp_ns), dtype=np.bool_)
    seconds = stamp_ns.astype(np.float64)
    jumps = np.flatnonzero(np.abs(np.diff(seconds)) > SLACK_NS)
    for row in np.unique(np.concatenate((jumps, jumps + 1))).tolist():
        around = (seconds[max(0, row - _AROUND) : row], seconds[row + 1 : row + 1 + _AROUND])
        away = [seconds[row] - np.median(part) for part in around if len(part)]
        good[row] = not (all(each > SLACK_NS for each in away) or all(each < -SLACK_NS for each in away))
    return good if good.any() else ~good


def _between(table: Table, places: NDArray[np.int64], stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Within what the densest table says before and after each row; open where it has not begun or has ended."""
    after = np.searchsorted(places, table.place)
    before_ns, after_ns = stamps[np.maximum(after - 1, 0)], stamps[np.minimum(after, len(stamps) - 1)]
    late = table.stamp_ns > np.maximum(before_ns, after_ns) + SLACK_NS
    early = table.stamp_ns < np.minimum(before_ns, after_ns) - SLACK_NS
    found: NDArray[np.bool_] = ~((late & (after < len(stamps))) | (early & (after > 0)))
    return found
