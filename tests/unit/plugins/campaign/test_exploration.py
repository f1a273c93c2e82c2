"""Searches over two axes against a boundary whose nearest point to nominal is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from test_bisection import driven

pytest.importorskip("optuna")

from xitl_cli.plugins.campaign.bisection import Outcome
from xitl_cli.plugins.campaign.exploration import Exploration, ExplorationFinding, Place, explore

pytestmark = pytest.mark.medium  # Optuna takes its time to load
SEARCH = Exploration(
    nominal=(0.0, 0.0),
    rate=0.5,
    confidence=0.95,
    runs_per_point=2,
    points=64,
    batch=8,
    seed=4,
    width=0.05,
    most_runs=1000,
)


def line(place: Place) -> float:
    """Fails beyond x + y = 1.2, which is 0.849 from the origin."""
    return 1.0 if sum(place) < 1.2 else 0.0


def test_the_nearest_failing_point() -> None:
    told: ExplorationFinding = driven(explore(SEARCH), line, np.random.default_rng(1))
    assert told.outcome == Outcome.FOUND
    assert told.nearest is not None
    assert told.along is not None
    assert sum(told.nearest) == pytest.approx(1.2, abs=0.05)
    assert math.dist(told.nearest, SEARCH.nominal) == pytest.approx(0.849, rel=0.06)  # straight on, or a little aside
    assert told.points[0].place == SEARCH.nominal


def test_a_search_asks_for_the_same_places_twice() -> None:
    first, second = (driven(explore(SEARCH), line, np.random.default_rng(1)) for _ in range(2))
    assert repr(first) == repr(second)


@pytest.mark.parametrize(("rate", "outcome"), [(1.0, Outcome.PASSES), (0.0, Outcome.FAILS)])
def test_nothing_is_guessed_where_there_is_no_boundary(rate: float, outcome: Outcome) -> None:
    told = driven(explore(SEARCH), lambda _: rate, np.random.default_rng(1))
    assert (told.outcome, told.nearest) == (outcome, None)


def test_failures_by_chance_are_no_boundary() -> None:
    """A quarter fails anywhere: single places of two runs look failing, none is when it is tried again."""
    told = driven(explore(SEARCH), lambda _: 0.75, np.random.default_rng(5))
    assert any(point.passed == 0 for point in told.points if point.runs == 2)
    assert told.outcome in (Outcome.UNDECIDED, Outcome.PASSES)
    assert told.nearest is None


def asked(search: Exploration, fails: Callable[[Place], bool | None]) -> tuple[ExplorationFinding, list[list[Place]]]:
    """The finding of a search and its batches of places, in a world without chance."""
    batches: list[list[Place]] = []
    steps = explore(search)
    try:
        batch = next(steps)
        while True:
            batches.append(batch)
            answers = [fails(place) for place in batch]
            batch = steps.send([None if answer is None else not answer for answer in answers])
    except StopIteration as end:
        return end.value, batches


def test_the_first_runs_are_at_the_nominal_point() -> None:
    for runs_per_point, first in ((2, 10), (5, 10), (6, 12)):
        _, batches = asked(replace(SEARCH, runs_per_point=runs_per_point, points=8), lambda _: False)
        assert batches[0] == [SEARCH.nominal] * first
        assert [len(batch) for batch in batches[1:]] == [8 * runs_per_point]
        assert batches[1][:runs_per_point] == [batches[1][0]] * runs_per_point
    silent, batches = asked(SEARCH, lambda _: None)
    assert (silent.outcome, silent.silent, len(batches)) == (Outcome.WITHOUT_VERDICT, 10, 1)


@pytest.mark.parametrize(("most_runs", "batches"), [(57, 2), (58, 3), (73, 3), (74, 4)])
def test_a_batch_that_exceeds_the_limit_of_runs_is_not_begun(most_runs: int, batches: int) -> None:
    """Ten runs at the nominal point, then batches of sixteen."""
    found, places = asked(replace(SEARCH, most_runs=most_runs), lambda _: False)
    assert len(places) == 1 + batches
    assert sum(point.runs for point in found.points) == 10 + 16 * batches <= most_runs
    assert found.outcome == Outcome.PASSES


def test_the_last_batch_has_what_is_left_of_the_points() -> None:
    _, batches = asked(replace(SEARCH, points=20), lambda _: False)
    assert [len(batch) for batch in batches[1:]] == [16, 16, 8]


def test_failing_points_draw_the_search_near() -> None:
    """Beyond x + y = 1.2 it fails. Later places lie nearer to this line than the first, which are random."""
    _, batches = asked(replace(SEARCH, points=96), lambda place: sum(place) > 1.2)
    off = [np.mean([abs(sum(place) - 1.2) for place in set(batch)]) for batch in batches[1:13]]
    assert np.mean(off[6:]) < 0.6 * np.mean(off[:3])


def test_a_line_beyond_a_failing_place_stays_within_the_axes() -> None:
    """Only a corner fails, so that a place beyond it would be outside: the way there ends at the corner's sides."""
    found, batches = asked(replace(SEARCH, points=96), lambda place: min(place) > 0.85)
    assert found.outcome == Outcome.FOUND
    assert all(0.0 <= value <= 1.0 for batch in batches for place in batch for value in place)
    assert found.nearest is not None
    assert max(found.nearest) <= 1.0
    assert min(found.nearest) == pytest.approx(0.85, abs=0.05)
