"""What is drawn of many points: nothing that stands out is lost."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xitl_cli.logs.model.sections import Trace
from xitl_cli.logs.report.plots import MOST_POINTS, thin


def noise(many: int) -> Trace:
    rng = np.random.default_rng(7)
    return Trace("noise", np.arange(many, dtype=np.int64) * 2_500_000, rng.normal(size=many))


def test_a_short_trace_is_kept_as_it_is() -> None:
    trace = noise(MOST_POINTS)
    drawn = thin(trace, over_time=True)
    assert np.array_equal(drawn.x, trace.x)
    assert np.array_equal(drawn.y, trace.y)
    assert drawn.of == MOST_POINTS


@pytest.mark.medium
@given(st.integers(0, 99_999), st.sampled_from([1e3, -1e3]))
@settings(max_examples=25, deadline=None)
def test_one_outlier_in_a_hundred_thousand_is_drawn(where: int, value: float) -> None:
    trace = noise(100_000)
    trace.y[where] = value
    drawn = thin(trace, over_time=True)
    assert len(drawn.x) <= MOST_POINTS
    assert drawn.of == 100_000
    assert drawn.y[np.searchsorted(drawn.x, trace.x[where])] == value


def test_every_interval_keeps_its_extremes() -> None:
    trace = noise(50_000)
    drawn = thin(trace, over_time=True)
    edges = np.linspace(0, trace.x[-1], MOST_POINTS // 4 + 1)
    least = [trace.y[(trace.x >= low) & (trace.x < high)].min() for low, high in pairwise(edges[10:41])]
    assert set(least) <= set(drawn.y.tolist())
    assert (np.diff(drawn.x) > 0).all()


def test_a_burst_does_not_take_the_points_of_the_rest() -> None:
    slow = np.arange(3000, dtype=np.int64) * 1_000_000_000
    burst = slow[1500] + np.arange(1, 500_000, dtype=np.int64) * 1000
    stamps = np.sort(np.concatenate((slow, burst)))
    drawn = thin(Trace("y", stamps, np.zeros(len(stamps)), "steps"), over_time=True)
    assert np.isin(drawn.x, slow).sum() > 1000


def test_a_pause_breaks_the_line() -> None:
    stamps = np.concatenate((np.arange(100), np.arange(200, 300))).astype(np.int64) * 100_000_000
    line = thin(Trace("y", stamps, np.ones(200)), over_time=True)
    held = thin(Trace("y", stamps, np.ones(200), "steps"), over_time=True)
    assert np.isnan(line.y).sum() == 1
    assert stamps[99] < line.x[np.isnan(line.y)][0] < stamps[100]
    assert not np.isnan(held.y).any()  # what holds until the next value has no pauses


def test_a_break_outlives_the_thinning() -> None:
    trace = noise(40_000)
    trace.y[20_001] = np.nan
    assert np.isnan(thin(trace, over_time=True).y).sum() == 1


def test_time_that_goes_back_is_put_in_order() -> None:
    stamps = np.array([3, 1, 2], dtype=np.int64)
    drawn = thin(Trace("y", stamps, np.array([30.0, 10.0, 20.0]), "points"), over_time=True)
    assert drawn.x.tolist() == [1, 2, 3]
    assert drawn.y.tolist() == [10.0, 20.0, 30.0]


@pytest.mark.parametrize("many", [0, 1, 2])
def test_few_points_or_none_are_fine(many: int) -> None:
    assert len(thin(noise(many), over_time=True).x) == many


def test_a_way_keeps_its_order_and_its_end() -> None:
    angle = np.linspace(0, 20, 30_001)
    drawn = thin(Trace("way", np.cos(angle), np.sin(angle)), over_time=False)
    assert len(drawn.x) <= MOST_POINTS + 1
    assert (drawn.x[-1], drawn.y[-1]) == (np.cos(angle[-1]), np.sin(angle[-1]))
    assert drawn.x[1] == np.cos(angle[8])


def test_stamps_of_one_instant_are_thinned_too() -> None:
    drawn = thin(Trace("y", np.zeros(10_000, dtype=np.int64), np.arange(10_000.0), "points"), over_time=True)
    assert sorted(drawn.y.tolist()) == [0.0, 9999.0]
