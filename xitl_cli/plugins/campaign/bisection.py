"""Bisection of one axis with runs that pass or fail by chance: where the pass rate crosses a wanted one.

A search is a generator: it yields batches of places, is sent what came of them, and returns what it found. Who drives
it may run a batch in any order and on any number of machines; places and findings stay the same.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from xitl_cli.plugins.campaign.statistics import (
    BoundaryEstimate,
    Interval,
    PassCounts,
    monotone_boundary,
    monotone_rates,
    monotony_p_value,
)

NOT_MONOTONE_BELOW = 0.01
"""A false alarm in a hundred searches: they look twice, after the first points and at the end."""


class Outcome(StrEnum):
    """How a search over an axis ended."""

    FOUND = "found"
    PASSES = "passes throughout"
    FAILS = "fails throughout"
    NOT_MONOTONE = "not monotone"
    UNDECIDED = "undecided"
    WITHOUT_VERDICT = "without a verdict"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bisection:
    """What is looked for on an axis from low to high. points: evenly spaced ones to begin with, the ends among them.

    width: of the boundary's interval, at most, in the unit of the axis. most_runs: where it gives up.
    """

    low: float
    high: float
    rate: float
    confidence: float
    width: float
    runs_per_point: int
    points: int
    most_runs: int
    logarithmic: bool = False

    def between(self, low: float, high: float, share: float) -> float:
        """The place at `share` of the way, even on the axis' own scale."""
        if share in (0.0, 1.0):
            return high if share else low
        if self.logarithmic:
            return math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
        return low + share * (high - low)


@dataclass(frozen=True, slots=True)
class BoundaryFinding:
    """What a bisection says. rising: it passes at the high end. estimate: None where there is no verdict at all.

    silent: runs without a verdict, which count neither way.
    """

    outcome: Outcome
    rising: bool
    estimate: BoundaryEstimate | None
    counts: PassCounts
    silent: int
    monotony_p_value: float


def bisect(search: Bisection) -> Generator[list[float], Sequence[bool | None], BoundaryFinding]:
    """Yields places, `runs_per_point` times each; is sent whether each run passed, None for one without a verdict.

    Every run needs a seed of its own: with the same ones at each place, what they have in common would move the
    boundary and the interval would not know.
    """
    at: list[float] = []
    passed: list[bool] = []
    silent = 0
    places = [search.between(search.low, search.high, share) for share in np.linspace(0.0, 1.0, search.points)]
    first = True
    while True:
        batch = [place for place in places for _ in range(search.runs_per_point)]
        answers = yield batch
        told = [(place, answer) for place, answer in zip(batch, answers, strict=True) if answer is not None]
        silent += len(batch) - len(told)
        at += [place for place, _ in told]
        passed += [answer for _, answer in told]
        if not told:
            return BoundaryFinding(Outcome.WITHOUT_VERDICT, False, None, PassCounts.counted(at, passed), silent, 1.0)
        counts = PassCounts.counted(at, passed)
        rising = is_rising(counts)
        estimate = monotone_boundary(counts, search.rate, rising, search.confidence)
        outcome = _outcome(search, estimate.interval, rising)
        spent = len(at) + silent >= search.most_runs
        p_value = monotony_p_value(counts, rising) if first or outcome or spent else 1.0
        if p_value < NOT_MONOTONE_BELOW:
            outcome = Outcome.NOT_MONOTONE
        if outcome or spent:
            return BoundaryFinding(outcome or Outcome.UNDECIDED, rising, estimate, counts, silent, p_value)
        places = _next_places(search, estimate.interval, counts)
        first = False


def is_rising(counts: PassCounts) -> bool:
    """Whether a rising curve is likelier than a falling one."""
    rising, falling = (counts.log_likelihood(monotone_rates(counts, way)) for way in (True, False))
    return rising > falling + 1e-9


def _outcome(search: Bisection, interval: Interval, rising: bool) -> Outcome | None:
    if interval.low >= search.high:
        return Outcome.FAILS if rising else Outcome.PASSES
    if interval.high <= search.low:
        return Outcome.PASSES if rising else Outcome.FAILS
    return Outcome.FOUND if interval.width <= search.width else None


def _next_places(search: Bisection, interval: Interval, counts: PassCounts) -> list[float]:
    """The middle of the interval; where there is one already, both its quarters; an end that is in doubt itself."""
    low, high = max(interval.low, search.low), min(interval.high, search.high)
    ends = [end for end, open_ in ((low, interval.low < search.low), (high, interval.high > search.high)) if open_]
    if low >= high:
        return ends
    if not any(low < place < high for place in counts.at):
        return sorted({search.between(low, high, 0.5), *ends})
    return sorted({*(search.between(low, high, share) for share in (0.25, 0.75)), *ends})
