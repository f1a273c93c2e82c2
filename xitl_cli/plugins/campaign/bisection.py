"""Bisection of one axis with random pass or fail: find the value at which the pass rate crosses a given rate.

A search is a generator. It yields batches of places, receives their results, and returns its finding. The caller may
run a batch in any order and on any number of machines; places and findings stay the same.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from enum import StrEnum

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.plugins.campaign.statistics import (
    BoundaryEstimate,
    PassCounts,
    monotone_boundary,
    monotone_rates,
    monotony_p_value,
)

NOT_MONOTONE_BELOW = 0.01
"""One false alarm in a hundred searches. The test runs twice, after the first points and at the end."""


class Outcome(StrEnum):
    """Outcome of a search over an axis."""

    FOUND = "found"
    PASSES = "passes throughout"
    FAILS = "fails throughout"
    NOT_MONOTONE = "not monotone"
    UNDECIDED = "undecided"
    WITHOUT_VERDICT = "without a verdict"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bisection:
    """Settings of a bisection on an axis from low to high."""

    low: float
    high: float
    rate: float
    confidence: float
    width: float
    """Largest width of the boundary's interval, in the unit of the axis."""
    runs_per_point: int
    points: int
    """Number of evenly spaced initial points, ends included."""
    most_runs: int
    """Limit of runs."""
    logarithmic: bool = False

    def between(self, low: float, high: float, share: float) -> float:
        """Return the place at a share of the interval, on the scale of the axis (linear or logarithmic)."""
        if share in (0.0, 1.0):
            return high if share else low
        if self.logarithmic:
            return math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
        return low + share * (high - low)


@dataclass(frozen=True, slots=True)
class BoundaryFinding:
    """Result of a bisection."""

    outcome: Outcome
    rising: bool
    """True if it passes at the high end."""
    estimate: BoundaryEstimate | None
    """None without any verdict."""
    counts: PassCounts
    silent: int
    """Runs without a verdict, which do not count."""
    monotony_p_value: float


def bisect(search: Bisection) -> Generator[list[float], Sequence[bool | None], BoundaryFinding]:
    """Yield places, `runs_per_point` times each. Receive True or False for each run, None for a run without a verdict.

    Every run needs a different seed. With equal seeds at each place, their common random part would shift the boundary,
    and the interval would not include this error.
    """
    at: list[float] = []
    passed: list[bool] = []
    silent = 0
    places = [search.between(search.low, search.high, share) for share in np.linspace(0.0, 1.0, search.points)]
    first = True
    while True:
        batch = [place for place in places for _ in range(search.runs_per_point)]
        answers = yield batch
        judged = [(place, answer) for place, answer in zip(batch, answers, strict=True) if answer is not None]
        silent += len(batch) - len(judged)
        at += [place for place, _ in judged]
        passed += [answer for _, answer in judged]
        if not judged:
            return BoundaryFinding(Outcome.WITHOUT_VERDICT, False, None, PassCounts.counted(at, passed), silent, 1.0)
        counts = PassCounts.counted(at, passed)
        rising = is_rising(counts)
        estimate = monotone_boundary(counts, search.rate, rising, search.confidence)
        interval = estimate.interval
        outcome = None
        if interval.low >= search.high:
            outcome = Outcome.FAILS if rising else Outcome.PASSES
        elif interval.high <= search.low:
            outcome = Outcome.PASSES if rising else Outcome.FAILS
        elif interval.width <= search.width:
            outcome = Outcome.FOUND
        spent = len(at) + silent >= search.most_runs
        p_value = monotony_p_value(counts, rising) if first or outcome or spent else 1.0
        if p_value < NOT_MONOTONE_BELOW:
            outcome = Outcome.NOT_MONOTONE
        if outcome or spent:
            return BoundaryFinding(outcome or Outcome.UNDECIDED, rising, estimate, counts, silent, p_value)
        first = False
        # Next places: the middle of the interval, both quarters if the middle exists already, and each uncertain end.
        low, high = max(interval.low, search.low), min(interval.high, search.high)
        places = [
            end for end, open_ in ((low, interval.low < search.low), (high, interval.high > search.high)) if open_
        ]
        if low < high:
            shares = (0.25, 0.75) if any(low < place < high for place in counts.at) else (0.5,)
            places = sorted({*(search.between(low, high, share) for share in shares), *places})


def is_rising(counts: PassCounts) -> bool:
    """Return True if a rising curve is more likely than a falling one."""
    rising, falling = (counts.log_likelihood(monotone_rates(counts, way)) for way in (True, False))
    return rising > falling + 1e-9
