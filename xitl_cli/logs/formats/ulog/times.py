"""When the rows of a ULog were written.

A row tells when its topic was published. What a topic held when logging began can be much older, and some topics
never say when (0). Such a row gets the latest stamp of the rows before it in the file. So does one with an impossible
time, which is counted as damage. The column `timestamp` keeps what is stored.
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
    """stamp_ns: (N,) of the rows in the order of the file. replaced: rows with an impossible time."""

    stamp_ns: Stamps
    start_ns: int
    replaced: int = 0
    back_in_time: int = 0

    def before(self, rows: NDArray[np.int64]) -> Stamps:
        """Latest stamp of the first `rows` rows, at least the start of the log."""
        latest = np.concatenate(([self.start_ns], np.maximum.accumulate(np.maximum(self.stamp_ns, self.start_ns))))
        return latest[np.clip(rows, 0, len(self.stamp_ns))]


def row_times(stored_us: NDArray[np.uint64], kind: NDArray[np.int32], start_us: int) -> RowTimes:
    """stored_us: (N,) of each row, 0 where it has none. kind: (N,) its subscription. start_us: of the file's head."""
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
    # Of the first rows of topics those are believed that fit in.
    good |= first & (stored >= start_ns - _EARLY_NS) & (stored <= level + FAR_NS)
    damaged = wrong & ((stored > level) | (stored < previous))
    return _mended(stored, kind, good, start_ns, int(damaged.sum()))


def _mended(stored: Stamps, kind: NDArray[np.int32], good: Flags, start_ns: int, replaced: int) -> RowTimes:
    """With every row that is not good stamped as the latest good one before it."""
    stamps = np.where(good, stored, np.maximum.accumulate(np.where(good, stored, start_ns)))
    back = int(np.count_nonzero(stamps < _previous(stamps, kind)))
    return RowTimes(stamps, min(start_ns, int(stamps.min())), replaced, back)


def _start(told_ns: int, stamps: Stamps) -> int:
    """When logging began: as the head of the file says, where the first rows agree."""
    level = int(np.median(stamps[:100]))
    return told_ns if abs(level - told_ns) < FAR_NS else int(stamps[:100].min())


def _previous(stamps: Stamps, kind: NDArray[np.int32]) -> Stamps:
    """(N,) the stamp of the row before of the same subscription, -1 for its first."""
    order = np.argsort(kind.astype(np.uint16), kind="stable")  # of 16 bits: sorted by radix
    sorted_kind, sorted_ns = kind[order], stamps[order]
    earlier = np.full(len(stamps), -1, np.int64)
    if len(stamps) > 1:
        earlier[1:] = np.where(sorted_kind[1:] == sorted_kind[:-1], sorted_ns[:-1], -1)
    found = np.empty(len(stamps), np.int64)
    found[order] = earlier
    return found
