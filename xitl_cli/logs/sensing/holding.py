"""Values that do not change: a sensor that is stuck, and one at the end of its range."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_LONGER_THAN_USUAL = 20.0  # geometric runs of mean 2 reach 20 times that once in 10^12
_FEWEST = 10


@dataclass(frozen=True, slots=True)
class Hold:
    """Rows first to last, both included, show the same values."""

    first: int
    last: int


@dataclass(frozen=True, slots=True)
class Holding:
    """repeated: share of the rows that equal the one before. usual: mean length in rows of the runs of equal rows,
    without those in `holds`, which are far longer than it.
    """

    repeated: float
    usual: float
    holds: tuple[Hold, ...]


def holding(values: NDArray[np.float64], period_s: float, shortest_s: float = 1.0) -> Holding:
    """Of rows (N,) or (N, k): a hold lasts `shortest_s`, ten rows and twenty times what is usual for this record."""
    rows = values.reshape(len(values), -1)
    if len(rows) < 2:
        return Holding(0.0, 1.0, ())
    same = (rows[1:] == rows[:-1]).all(axis=1)
    begins = np.flatnonzero(np.concatenate(([True], ~same)))
    lengths = np.diff(np.concatenate((begins, [len(rows)])))
    least = max(_FEWEST, math.ceil(shortest_s / period_s))
    others = lengths[lengths < least]
    usual = float(others.mean()) if len(others) else float(lengths.mean())
    long = np.flatnonzero(lengths >= max(least, math.ceil(_LONGER_THAN_USUAL * usual)))
    holds = tuple(Hold(int(begins[place]), int(begins[place] + lengths[place] - 1)) for place in long)
    return Holding(float(same.mean()), usual, holds)


@dataclass(frozen=True, slots=True)
class Saturation:
    """limit: the value that is not exceeded. rows: how many show it; first, last: the longest stretch of them."""

    limit: float
    rows: int
    first: int
    last: int


def saturation(values: NDArray[np.float64], least: float) -> Saturation | None:
    """A signal (N,) that stops at one largest magnitude, again and again: three rows in a row, while others differ.

    `least`: magnitudes below are no end of a range.
    """
    magnitude = np.abs(values)
    if not len(magnitude) or not np.isfinite(magnitude).any():
        return None
    limit = float(np.nanmax(magnitude))
    if limit < least:
        return None
    # A range that is not the same on both sides by a step of the converter is still one range.
    at_limit = magnitude >= limit * (1.0 - 1e-4)
    count = int(np.count_nonzero(at_limit))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], at_limit, [False])).astype(np.int8)))
    begins, ends = edges[0::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    if ends[longest] - begins[longest] < 3 or count > 0.9 * len(magnitude):
        return None
    return Saturation(limit, count, int(begins[longest]), int(ends[longest]) - 1)
