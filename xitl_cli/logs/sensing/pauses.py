"""When the log itself stood still: what every message lacks then is no sensor's fault."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log

_DENSE_HZ = 4.0
_SHORTEST_NS = 20_000_000
_MOST_TABLES = 12


def pauses(log: Log) -> NDArray[np.int64]:
    """(N, 2) from and until of every span over 20 ms, and three times the usual, in which no dense message came.

    Of the twelve fullest tables with at least four rows a second; none with fewer than two such tables.
    """
    dense = _dense(log)
    if len(dense) < 2:
        return np.empty((0, 2), dtype=np.int64)
    merged = np.unique(np.concatenate(dense))
    steps = np.diff(merged)
    wide = np.flatnonzero(steps > max(_SHORTEST_NS, 3.0 * float(np.percentile(steps, 90.0))))
    return np.stack([merged[wide], merged[wide + 1]], axis=1)


def _dense(log: Log) -> list[NDArray[np.int64]]:
    dense = []
    for table in sorted(log.tables.values(), key=len, reverse=True)[:_MOST_TABLES]:
        stamps = table.stamp_ns
        if len(stamps) >= 10 and 0 < int(stamps[-1]) - int(stamps[0]) < len(stamps) / _DENSE_HZ * 1e9:
            dense.append(stamps)
    return dense


def ends_ns(log: Log) -> int | None:
    """When the dense messages end, by the median of their last stamps; None without any.

    The log may go on with a few rows after that.
    """
    last = [int(stamps[-1]) for stamps in _dense(log)]
    return sorted(last)[len(last) // 2] if last else None


def covered(from_ns: NDArray[np.int64], until_ns: NDArray[np.int64], spans: NDArray[np.int64]) -> NDArray[np.float64]:
    """(G,) share of each from..until that the longest of these spans (N, 2) in it covers; they are in order and apart
    from each other.

    Of one, not of all: where the rest of a log goes on slowly, its steps are many short spans.
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
