"""Fewer points for a screen: nothing that stands out is lost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.sections import Trace

MOST_POINTS = 4000
Numbers = NDArray[Any]  # of int64 or float64

_LEAST_GAP_NS = 1_000_000_000
_GAP_IN_INTERVALS = 10


@dataclass(frozen=True, slots=True)
class ThinTrace(Trace):
    """of: how many points there were. In the order of x where it is time; a NaN stands where a line has to break."""

    of: int = 0


def thin(trace: Trace, *, over_time: bool, most: int = MOST_POINTS) -> ThinTrace:
    """At most about `most` points. Over time: the first, least, greatest and last of each interval, in their order.

    Other traces keep every n-th point and the last one, as their order is their shape.
    """
    if isinstance(trace, ThinTrace):
        return trace
    x: Numbers = np.asarray(trace.x)
    y: NDArray[np.float64] = np.asarray(trace.y, dtype=np.float64)
    many = min(len(x), len(y))
    x, y = x[:many], y[:many]
    if over_time:
        if many and (np.diff(x) < 0).any():
            order = np.argsort(x, kind="stable")
            x, y = x[order], y[order]
        if trace.style == "line":
            x, y = _broken_at_gaps(x, y)
        kept = _envelope(x, y, most)
    else:
        kept = _every_nth(len(x), most)
    return ThinTrace(trace.name, x[kept].copy(), y[kept].copy(), trace.style, many)


def _every_nth(many: int, most: int) -> NDArray[np.intp]:
    if many <= most:
        return np.arange(many, dtype=np.intp)
    kept = np.arange(0, many, -(-many // most), dtype=np.intp)
    return kept if kept[-1] == many - 1 else np.append(kept, many - 1)


def _envelope(x: Numbers, y: NDArray[np.float64], most: int) -> NDArray[np.intp]:
    """Of equal intervals of x; the first NaN of one is kept, so that a break is seen."""
    many = len(x)
    if many <= most:
        return np.arange(many, dtype=np.intp)
    # Intervals of x and not of the count: a burst must not take the points of the rest.
    where = x.astype(np.float64) - float(x[0])
    intervals = max(most // 4, 1)
    scale = intervals / where[-1] if where[-1] > 0.0 else 0.0
    numbered = np.minimum((where * scale).astype(np.int64), intervals - 1)
    first = np.flatnonzero(np.concatenate(([True], numbered[1:] != numbered[:-1])))
    last = np.append(first[1:], many) - 1
    of = np.repeat(np.arange(len(first)), last - first + 1)
    numbers = np.isfinite(y)
    least = np.minimum.reduceat(np.where(numbers, y, np.inf), first)
    greatest = np.maximum.reduceat(np.where(numbers, y, -np.inf), first)
    extremes = [_one_each(np.flatnonzero(numbers & (y == bound[of])), of) for bound in (least, greatest)]
    extremes.append(_one_each(np.flatnonzero(~numbers), of))
    return np.unique(np.concatenate((first, last, *extremes)))


def _one_each(rows: NDArray[np.intp], of: NDArray[np.intp]) -> NDArray[np.intp]:
    """The first of these rows in each interval."""
    return rows[np.unique(of[rows], return_index=True)[1]]


def _broken_at_gaps(x: Numbers, y: NDArray[np.float64]) -> tuple[Numbers, NDArray[np.float64]]:
    """With a NaN inside every interval without data: a straight line across would claim some."""
    if len(x) < 3:
        return x, y
    steps = np.diff(x)
    limit = max(_LEAST_GAP_NS, _GAP_IN_INTERVALS * float(np.median(steps)))
    gaps = np.flatnonzero(steps > limit)
    if not len(gaps) or len(gaps) > len(x) // 10:
        return x, y
    middles = x[gaps] + steps[gaps] // 2
    return np.insert(x, gaps + 1, middles), np.insert(y, gaps + 1, np.nan)
