"""Searches over two axes against a boundary whose nearest point to nominal is known."""

from __future__ import annotations

import math

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
