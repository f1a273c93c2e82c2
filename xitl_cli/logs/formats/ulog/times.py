"""Times of the rows of a ULog.

A row has the publication time of its topic. The value of a topic at the start of logging can be much older, and some
topics have no time (0). Such a row gets the latest stamp of the rows before it in the file. So does a row with an
impossible time, which is counted as damage. The column `timestamp` keeps the stored value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.table import FAR_NS, implausible, stamps_ns
from xitl_cli.logs.model.table import Flags, Stamps

_EARLY_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class RowTimes:
    """Times of the rows."""

    stamp_ns: Stamps
    """(N,) in the order of the file."""
    start_ns: int
    replaced: int = 0
    """Rows with an impossible time."""
    back_in_time: int = 0

    def before(self, rows: NDArray[np.int64]) -> Stamps:
        """Latest stamp of the first `rows` rows, at least the start of the log."""
        latest = np.concatenate(([self.start_ns], np.maximum.accumulate(np.maximum(self.stamp_ns, self.start_ns))))
        return latest[np.clip(rows, 0, len(self.stamp_ns))]


def row_times(stored_us: NDArray[np.uint64], kind: NDArray[np.int32], start_us: int) -> RowTimes:
    """Determine the times of all rows.

    stored_us: (N,) of each row, 0 if it has none. kind: (N,) its subscription. start_us: from the file's header.
    """
    stored = stamps_ns(stored_us, 1_000)
    previous = _previous(stored, kind)
    first = previous < 0
    steady = np.flatnonzero(~first & (stored > 0))
    if not len(steady):
        steady = np.flatnonzero(stored > 0)
    if not len(steady):
        return RowTimes(np.full(len(stored), start_us * 1_000), start_us * 1_000)
    wrong = np.zeros(len(stored), np.bool_)
    wrong[steady[implausible(stored[steady])]] = True
    good = np.zeros(len(stored), np.bool_)
    good[steady] = True
    good &= ~wrong
    if not good.any():
        good = stored > 0
    start_ns = _start(start_us * 1_000, stored[good])
    level = np.maximum.accumulate(np.where(good, stored, start_ns))
    # The first rows of topics are accepted if they fit in.
    good |= first & (stored >= start_ns - _EARLY_NS) & (stored <= level + FAR_NS)
    damaged = wrong & ((stored > level) | (stored < previous))
    return _mended(stored, kind, good, start_ns, int(damaged.sum()))


def _mended(stored: Stamps, kind: NDArray[np.int32], good: Flags, start_ns: int, replaced: int) -> RowTimes:
    """Times in which every row that is not good has the stamp of the latest good row before it."""
    stamps = np.where(good, stored, np.maximum.accumulate(np.where(good, stored, start_ns)))
    back = int(np.count_nonzero(stamps < _previous(stamps, kind)))
    return RowTimes(stamps, min(start_ns, int(stamps.min())), replaced, back)


def _start(told_ns: int, stamps: Stamps) -> int:
    """Start of logging: the time in the file's header, if the first rows agree."""
    level = int(np.median(stamps[:100]))
    return told_ns if abs(level - told_ns) < FAR_NS else int(stamps[:100].min())


def _previous(stamps: Stamps, kind: NDArray[np.int32]) -> Stamps:
    """(N,) stamp of the previous row of the same subscription, -1 for its first."""
    order = np.argsort(kind.astype(np.uint16), kind="stable")  # 16 bits use radix sort
    sorted_kind, sorted_ns = kind[order], stamps[order]
    earlier = np.full(len(stamps), -1, np.int64)
    if len(stamps) > 1:
        earlier[1:] = np.where(sorted_kind[1:] == sorted_kind[:-1], sorted_ns[:-1], -1)
    found = np.empty(len(stamps), np.int64)
    found[order] = earlier
    return found
