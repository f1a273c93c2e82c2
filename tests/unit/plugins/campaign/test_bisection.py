"""Searches along an axis against pass rates whose boundary is known."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from math import exp
from typing import Any

import numpy as np
import pytest

pytest.importorskip("scipy")

from xitl_cli.plugins.campaign.bisection import Bisection, BoundaryFinding, Outcome, bisect

PassRate = Callable[[Any], float]
SEARCH = Bisection(low=0.0, high=10.0, rate=0.5, confidence=0.95, width=1.0, runs_per_point=10, points=5, most_runs=400)


def driven(search: Generator[list[Any], Any, Any], rate: PassRate, rng: np.random.Generator) -> Any:
    """What a search finds in a world with this pass rate."""
    try:
        batch = next(search)
        while True:
            batch = search.send([bool(rng.random() < rate(place)) for place in batch])
    except StopIteration as end:
        return end.value


def found(search: Bisection, rate: PassRate, seed: int = 1) -> BoundaryFinding:
    result: BoundaryFinding = driven(bisect(search), rate, np.random.default_rng(seed))
    return result


@pytest.mark.parametrize("rising", [False, True])
def test_a_sharp_boundary_is_halved_down_to_the_wanted_width(rising: bool) -> None:
    told = found(SEARCH, lambda x: float((x < 4.3) != rising))
    assert (told.outcome, told.rising) == (Outcome.FOUND, rising)
    assert told.estimate is not None
    assert 4.3 in told.estimate.interval
    assert told.estimate.interval.width <= 1.0
    assert told.counts.at.tolist() == [0.0, 2.5, 3.75, 4.375, 5.0, 7.5, 10.0]
    assert told.counts.runs.tolist() == [10] * 7


def test_a_logarithmic_axis_is_halved_in_its_logarithm() -> None:
    search = replace(SEARCH, low=0.01, high=100.0, width=5.0, logarithmic=True, points=3)
    told = found(search, lambda x: float(x < 4.3))
    assert told.counts.at == pytest.approx([0.01, 1.0, 10**0.5, 10**0.75, 10.0, 100.0])


def test_what_passes_or_fails_throughout_is_said() -> None:
    assert found(SEARCH, lambda _: 0.97).outcome == Outcome.PASSES
    assert found(SEARCH, lambda _: 0.03).outcome == Outcome.FAILS
    assert found(SEARCH, lambda x: float(x > 20)).outcome == Outcome.FAILS


def test_a_gap_is_said_and_not_taken_for_a_boundary() -> None:
    told = found(SEARCH, lambda x: 0.05 if 4 < x < 7 else 0.95)
    assert told.outcome == Outcome.NOT_MONOTONE
    assert told.monotony_p_value < 0.01
    assert told.counts.runs.sum() == 50


def test_a_rate_that_hangs_on_nothing_stays_undecided() -> None:
    told = found(replace(SEARCH, most_runs=100), lambda _: 0.5)
    assert told.outcome == Outcome.UNDECIDED
    assert told.counts.runs.sum() >= 100


def test_runs_without_a_verdict_count_neither_way() -> None:
    search = bisect(SEARCH)
    batch = next(search)
    batch = search.send([None if number % 2 else place < 4.3 for number, place in enumerate(batch)])
    assert batch == [3.75] * 10
    with pytest.raises(StopIteration) as end:
        search.send([None] * 10)
    assert (end.value.value.outcome, end.value.value.silent) == (Outcome.WITHOUT_VERDICT, 35)


SHAPES: dict[str, tuple[PassRate, float]] = {
    "logistic": (lambda x: 1 / (1 + exp((x - 4.3) / 0.5)), 4.3),
    "step": (lambda x: float(x < 4.3), 4.3),
    "step, and 3 % for reasons of their own": (lambda x: 0.97 if x < 4.3 else 0.03, 4.3),
    "Gompertz": (lambda x: exp(-exp((x - 4.5) / 0.4)), 4.5 + 0.4 * np.log(np.log(2))),
    "straight": (lambda x: min(1.0, max(0.0, 1 - (x - 3) / 2)), 4.0),
}


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_the_interval_holds_the_boundary_as_often_as_it_says(shape: str) -> None:
    """200 searches. At a true coverage of 95 %, fewer than 182 come once in a hundred times (binomial)."""
    rate, boundary = SHAPES[shape]
    search = replace(SEARCH, width=0.6, most_runs=1000)
    told = [found(search, rate, seed) for seed in range(200)]
    covered = sum(one.estimate is not None and boundary in one.estimate.interval for one in told)
    ended = sum(one.outcome == Outcome.FOUND for one in told)
    print(
        f"{shape}: {covered} of 200 hold it, {ended} found, {np.median([one.counts.runs.sum() for one in told])} runs"
    )
    assert covered >= 182
    assert ended >= 190
