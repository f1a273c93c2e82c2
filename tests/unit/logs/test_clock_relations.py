"""Lines, bends and windows of clocks with exact readings, against the values that made them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from xitl_cli.logs.clocks.fit import (
    ClockRelation,
    FitPiece,
    find_steps,
    fit_relation,
    lower_hull,
    lower_line,
    robust_line,
    robust_spread,
)
from xitl_cli.logs.clocks.readings import ClockReadings

SECOND = 1_000_000_000


def readings(first_s: Any, offset_s: Any, late: bool = False, resolution_s: float = 0.0) -> ClockReadings:
    first_ns = np.round(np.asarray(first_s) * SECOND).astype(np.int64)
    second_ns = first_ns + np.round(np.asarray(offset_s) * SECOND).astype(np.int64)
    return ClockReadings("k", "a", "b", first_ns, first_ns, second_ns, "M", "F", late=late, resolution_s=resolution_s)


def fitted(*of: Any, **more: Any) -> ClockRelation:
    relation = fit_relation(readings(*of, **more))
    assert relation is not None
    return relation


def test_the_robust_spread_is_that_of_the_median_deviation() -> None:
    values = np.array([1.0, 2.0, 4.0, 8.0, 100.0])
    assert robust_spread(values) == pytest.approx(stats.median_abs_deviation(values, scale="normal"), rel=1e-4)
    assert robust_spread(np.array([])) == 0.0


def test_a_line_without_outliers_is_that_of_least_squares() -> None:
    """Huber's weights are 1 for small errors."""
    x = np.arange(50.0)
    y = 3.0 - 0.2 * x + np.tile([0.01, -0.01], 25)
    expected = stats.linregress(x, y)
    slope, value = robust_line(x, y)
    assert slope == pytest.approx(expected.slope, rel=1e-12)
    assert value == pytest.approx(expected.intercept, rel=1e-12)


def test_hubers_line_solves_its_equations() -> None:
    """The sums of the clipped errors, and of their products with x, are zero (Huber 1964)."""
    rng = np.random.default_rng(3)
    x = np.sort(rng.uniform(0.0, 10.0, 300))
    y = 1.0 + 0.5 * x + rng.standard_t(2.0, 300)
    slope, value = robust_line(x, y)
    error = y - value - slope * x
    clipped = np.clip(error, -1.345 * robust_spread(error), 1.345 * robust_spread(error))
    assert abs(clipped.sum()) < 0.02
    assert abs((clipped * x).sum()) < 0.2


def test_the_lower_hull_has_the_points_below_all_others() -> None:
    x = np.array([2.0, 0.0, 1.0, 3.0, 1.0, 4.0, 2.0])
    y = np.array([0.0, 1.0, 9.0, 1.0, 0.5, 0.0, 5.0])
    hull_x, hull_y = lower_hull(x, y)
    # (1, 0.5) is on the line from (0, 1) to (2, 0), (3, 1) is above that from (2, 0) to (4, 0).
    assert hull_x.tolist() == [0.0, 2.0, 4.0]
    assert hull_y.tolist() == [1.0, 0.0, 0.0]
    assert lower_line(x, y) == (-0.5, 1.0)  # the mean of x is 13 / 7
    assert lower_line(np.array([2.0, 2.0]), np.array([5.0, 3.0])) == (0.0, 3.0)


@pytest.mark.parametrize("late", [False, True])
def test_an_exact_line_is_found_exactly(late: bool) -> None:
    first_s = 100.0 + np.arange(1200) * 0.1
    relation = fitted(first_s, 2.0 + 40e-6 * (first_s - 100.0), late)
    assert relation.steps == ()
    (piece,) = relation.pieces
    assert (piece.from_ns, piece.until_ns, piece.readings) == (100 * SECOND, round(219.9 * SECOND), 1200)
    assert piece.about_ns == 100 * SECOND + round(119.9 * SECOND) // 2
    assert piece.slope_ppm == pytest.approx(40.0, abs=1e-4)
    assert piece.offset_ns == pytest.approx(2 * SECOND + 40e-6 * 59.95 * SECOND, abs=2)
    assert piece.residual_s < 1e-9
    assert np.abs(relation.residual_s).max() < 2e-9
    # Twelve windows of a twelfth of 119.9 s
    assert relation.window_s == 10.0
    assert relation.window_ppm == pytest.approx(np.full(12, 40.0), abs=1e-3)
    expected_s = 100.0 + 4.95 + 10.0 * np.arange(12)
    assert relation.window_ns == pytest.approx(np.round(expected_s * SECOND), abs=2)


def test_windows_without_enough_readings_or_length_have_no_rate() -> None:
    first_s = np.concatenate((np.arange(0.0, 10.0, 0.1), np.arange(13.2, 20.0, 0.1), np.arange(20.0, 30.0, 1.5),
                              np.arange(33.0, 40.0, 1.0), np.arange(40.0, 120.0, 0.1)))  # fmt: skip
    relation = fitted(first_s, np.zeros(len(first_s)))
    centres_s = relation.window_ns / SECOND
    # 13.2 s to 20 s is less than 0.7 of 10 s; the next two have 7 readings each.
    assert len(relation.window_ppm) == 9
    assert centres_s[:2] == pytest.approx([4.95, 44.95])


@pytest.mark.parametrize(
    ("change_ppm", "noise_s", "bends"),
    [
        (4.5, 0.0, 0),
        (5.5, 0.0, 1),
        (-5.5, 0.0, 1),
        (0.0, 0.0, 0),
        (900.0, 1e-3, 1),
        (-900.0, 1e-3, 1),
        (1100.0, 1e-3, 0),
    ],
)
def test_a_bend_is_a_change_of_rate_that_a_clock_can_have(change_ppm: float, noise_s: float, bends: int) -> None:
    first_s = np.arange(240) * 0.5
    offset_s = 30e-6 * first_s + 1e-6 * change_ppm * np.maximum(first_s - 50.0, 0.0)
    offset_s += noise_s * np.random.default_rng(1).normal(size=240)
    steps = find_steps(readings(first_s, offset_s))
    assert len(steps) == bends
    for step in steps:
        assert step.index == pytest.approx(100, abs=6 if noise_s else 1)  # 1 ms of 0.9 ms a second
        assert step.size_s == 0.0
        assert step.first_ns == step.at_ns == step.index * SECOND // 2


def test_each_side_of_a_bend_has_its_rate() -> None:
    first_s = np.arange(240) * 0.5
    relation = fitted(first_s, 30e-6 * first_s - 80e-6 * np.maximum(first_s - 50.0, 0.0))
    before, after = relation.pieces
    assert before.slope_ppm == pytest.approx(30.0, abs=0.2)
    assert after.slope_ppm == pytest.approx(-50.0, abs=0.2)
    assert relation.longest is after


@pytest.mark.parametrize(("index", "bends"), [(12, 1), (228, 1)])
def test_a_bend_near_an_end_has_twelve_readings_beside_it(index: int, bends: int) -> None:
    first_s = np.arange(240) * 0.5
    offset_s = 60e-6 * np.maximum(first_s - index * 0.5, 0.0)
    assert len(find_steps(readings(first_s, offset_s))) == bends
    assert find_steps(readings(first_s[:23], 60e-6 * np.maximum(first_s[:23] - 6.0, 0.0))) == ()


def test_a_bend_within_the_grain_of_a_clock_is_none() -> None:
    first_s = np.arange(240) * 0.5
    offset_s = np.round(8e-6 * np.maximum(first_s - 60.0, 0.0), 3)  # half a millisecond at the end
    assert find_steps(readings(first_s, offset_s, resolution_s=1e-3)) == ()


@pytest.mark.parametrize("size_s", [0.25, -0.25])
@pytest.mark.parametrize("late", [False, True])
def test_an_exact_step_is_at_its_reading(size_s: float, late: bool) -> None:
    first_s = np.arange(600) * 0.1
    relation = fitted(first_s, 1.0 + 20e-6 * first_s + np.where(first_s >= 29.95, size_s, 0.0), late)
    (step,) = relation.steps
    assert step.index == 300
    assert step.first_ns == 30 * SECOND
    assert step.size_s == pytest.approx(size_s, abs=1e-6)
    before, after = relation.pieces
    assert (before.until_ns, after.from_ns) == (round(29.9 * SECOND), 30 * SECOND)
    assert before.slope_ppm == pytest.approx(20.0, abs=1e-3)
    assert after.slope_ppm == pytest.approx(20.0, abs=1e-3)


@pytest.mark.parametrize(("size_s", "steps"), [(0.9e-3, 0), (1.1e-3, 1)])
def test_a_step_is_a_millisecond(size_s: float, steps: int) -> None:
    first_s = np.arange(600) * 0.1
    relation = fitted(first_s, np.where(first_s >= 29.95, size_s, 0.0))
    assert len([step for step in relation.steps if step.size_s]) == steps


@pytest.mark.parametrize(("back_after_s", "steps"), [(59.0, 0), (61.0, 2)])
def test_a_delay_that_ends_within_a_minute_is_no_step(back_after_s: float, steps: int) -> None:
    first_s = np.arange(3000) * 0.1
    held = (first_s >= 100.0) & (first_s < 100.0 + back_after_s)
    relation = fitted(first_s, np.where(held, 0.5, 0.0), True)
    assert len([step for step in relation.steps if step.size_s]) == steps


def piece(from_s: float, until_s: float, offset_s: float, slope_ppm: float = 0.0) -> FitPiece:
    begin, end = round(from_s * SECOND), round(until_s * SECOND)
    return FitPiece(begin, end, begin, round(offset_s * SECOND), slope_ppm, None, 0.0, 0.0, 10)


def related(*pieces: FitPiece) -> ClockRelation:
    none = np.array([], dtype=np.int64)
    return ClockRelation(readings([0.0, 1.0], [0.0, 0.0]), pieces, (), np.zeros(2), 10.0, none, np.array([]))


def test_both_ways_through_a_step_ahead_and_one_back() -> None:
    relation = related(piece(0.0, 10.0, 5.0, 100.0), piece(11.0, 20.0, 7.0), piece(21.0, 30.0, 4.0))
    first_s = np.array([-1.0, 0.0, 10.0, 10.9, 11.0, 20.9, 21.0, 31.0])
    second_s = [4.0 - 1e-4, 5.0, 15.001, 15.9 + 1.09e-3, 18.0, 27.9, 25.0, 35.0]
    first_ns = np.round(first_s * SECOND).astype(np.int64)
    assert relation.to_second(first_ns) == pytest.approx(np.round(np.array(second_s) * SECOND), abs=1)
    # Ahead: from 16.0011 s to 18 s, the middle; back: from 28 s to 25 s, its end.
    assert relation.second_bounds_ns == (pytest.approx(17.00055 * SECOND, abs=2), 25 * SECOND)
    back_ns = relation.to_first(
        np.round(np.array([5.0, 15.001, 17.0, 17.1, 24.9, 25.0, 35.0]) * SECOND).astype(np.int64)
    )
    expected_s = [0.0, 10.0, 12.0 / 1.0001, 10.1, 17.9, 21.0, 31.0]
    assert back_ns == pytest.approx(np.round(np.array(expected_s) * SECOND), abs=2)
