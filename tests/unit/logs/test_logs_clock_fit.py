"""Clocks with known offset, skew, steps and jitter: what is said of them is what they are."""

from __future__ import annotations

import numpy as np
import pytest

from xitl_cli.logs.clocks.fit import fit_relation, lower_line, robust_line
from xitl_cli.logs.clocks.readings import ClockReadings

UTC_NS = 1_790_000_000_000_000_000  # stamps of this size do not fit a float
SKEW_PPM, OFFSET_S, STEP_S = 80.0, 3.0, 0.5
JITTER_S, FLOOR_S = 5e-3, 2e-3


def readings(
    kind: str,
    seed: int,
    skew_ppm: float = SKEW_PPM,
    step_s: float = STEP_S,
    step_at_s: float = 100.0,
    bend_ppm: float = 0.0,
    burst: bool = False,
    samples: int = 3000,
) -> ClockReadings:
    """At 10 Hz: delays of 2 ms and an exponential of 5 ms (`late`), both ways (`exchange`), or normal errors."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(samples) * 0.1 + rng.uniform(0.0, 0.01, samples)
    true_s = OFFSET_S + 1e-6 * skew_ppm * t_s + np.where(t_s >= step_at_s, step_s, 0.0)
    true_s += 1e-6 * bend_ppm * np.maximum(t_s - 120.0, 0.0)
    first_ns = UTC_NS + np.round(t_s * 1e9).astype(np.int64)

    def after(extra_s: np.ndarray) -> np.ndarray:
        return first_ns + np.round((true_s + extra_s) * 1e9).astype(np.int64)

    if kind == "together":
        return ClockReadings("k", "a", "b", first_ns, first_ns, after(rng.normal(0.0, JITTER_S, samples)), "M", "F")
    there_s = FLOOR_S + rng.exponential(JITTER_S, samples)
    if burst:
        there_s[(t_s > 150.0) & (t_s < 155.0)] += 0.8
    if kind == "late":
        return ClockReadings("k", "a", "b", first_ns, first_ns, after(there_s), "M", "F", late=True)
    back_s = FLOOR_S + rng.exponential(JITTER_S, samples)
    floor_ns = after(-back_s) - first_ns
    return ClockReadings("k", "a", "b", first_ns, first_ns, after(there_s), "M", "F", late=True, floor_ns=floor_ns)


@pytest.mark.medium
@pytest.mark.parametrize("kind", ["late", "exchange", "together"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_step_is_found_and_each_side_has_the_skew(kind: str, seed: int) -> None:
    relation = fit_relation(readings(kind, seed))
    assert relation is not None
    (step,) = relation.steps
    assert step.first_ns - UTC_NS == pytest.approx(100e9, abs=0.3e9)  # three samples
    # Normal errors of 5 ms: the lines left and right of it are known to 5 ms / sqrt(1000) and their lean.
    assert step.size_s == pytest.approx(STEP_S, abs=2e-3 if kind == "together" else 3e-4)
    for piece in relation.pieces:
        assert piece.slope_error_ppm is not None
        # White errors over 100 s: 5 ms sqrt(12) / (100 s sqrt(1000)) = 5.5 ppm; edges of delays do far better.
        assert piece.slope_error_ppm < (20.0 if kind == "together" else 2.0)
        assert abs(piece.slope_ppm - SKEW_PPM) < max(4.0 * piece.slope_error_ppm, 0.5)
    first = relation.pieces[0]
    middle_s = (first.about_ns - UTC_NS) * 1e-9
    constant_s = FLOOR_S if kind == "late" else 0.0  # which nothing can see in one direction
    assert first.offset_ns * 1e-9 == pytest.approx(OFFSET_S + constant_s + 1e-6 * SKEW_PPM * middle_s, abs=1e-3)


@pytest.mark.medium
@pytest.mark.parametrize("kind", ["late", "exchange", "together"])
def test_an_even_clock_has_neither_step_nor_drift(kind: str) -> None:
    relation = fit_relation(readings(kind, 3, skew_ppm=0.0, step_s=0.0))
    assert relation is not None
    assert relation.steps == ()
    (piece,) = relation.pieces
    assert abs(piece.slope_ppm) < max(4.0 * (piece.slope_error_ppm or 0.0), 0.2)
    assert len(relation.window_ppm) == 12


@pytest.mark.medium
@pytest.mark.parametrize("kind", ["late", "exchange"])
def test_a_burst_of_delays_is_no_step_of_the_clock(kind: str) -> None:
    relation = fit_relation(readings(kind, 4, step_s=0.0, burst=True))
    assert relation is not None
    assert [step for step in relation.steps if step.size_s] == []
    assert relation.longest.slope_ppm == pytest.approx(SKEW_PPM, abs=1.0)


def test_a_queue_that_fills_at_once_and_drains_slowly_is_no_step() -> None:
    rng = np.random.default_rng(14)
    t_s = np.arange(4000) * 0.005
    delay_s = (
        2e-4 + rng.exponential(3e-4, len(t_s)) + np.where(t_s > 8.0, np.maximum(0.04 - 0.05 * (t_s - 8.0), 0.0), 0.0)
    )
    first_ns = np.round(t_s * 1e9).astype(np.int64)
    second_ns = first_ns + np.round(delay_s * 1e9).astype(np.int64)
    relation = fit_relation(ClockReadings("k", "a", "b", first_ns, first_ns, second_ns, "M", "F", late=True))
    assert relation is not None
    assert [step for step in relation.steps if step.size_s] == []


@pytest.mark.medium
@pytest.mark.parametrize("kind", ["late", "exchange"])
def test_a_change_of_rate_bends_the_line(kind: str) -> None:
    relation = fit_relation(readings(kind, 5, step_s=0.0, bend_ppm=80.0))
    assert relation is not None
    (bend,) = relation.steps
    assert bend.size_s == 0.0
    assert (bend.first_ns - UTC_NS) * 1e-9 == pytest.approx(120.0, abs=15.0)  # 15 s are 1.2 ms of 5 ms of jitter
    before, after = relation.pieces
    assert before.slope_ppm == pytest.approx(80.0, abs=5.0)
    assert after.slope_ppm == pytest.approx(160.0, abs=5.0)


def test_there_and_back_again() -> None:
    relation = fit_relation(readings("late", 6))
    assert relation is not None
    first_ns = UTC_NS + np.array([0, 50, 99, 101, 200, 299], dtype=np.int64) * 1_000_000_000
    again_ns = relation.to_first(relation.to_second(first_ns))
    assert np.abs(again_ns - first_ns).max() <= 2  # whole nanoseconds are rounded twice


@pytest.mark.parametrize("samples", [0, 1, 2, 3, 5, 30])
def test_few_readings_are_no_error(samples: int) -> None:
    relation = fit_relation(readings("late", 7, samples=samples))
    assert (relation is None) == (samples < 3)


def test_a_clock_that_goes_back_or_stands_still_is_no_error() -> None:
    still = np.full(50, 7, dtype=np.int64)
    back = np.concatenate((np.arange(30), np.arange(30))) * 1_000_000_000
    assert fit_relation(ClockReadings("k", "a", "b", still, still, still, "M", "F")) is None
    relation = fit_relation(ClockReadings("k", "a", "b", back, back, back + 5, "M", "F"))
    assert relation is not None
    assert len(relation.readings) == 30


def test_the_line_below_touches_and_never_crosses() -> None:
    rng = np.random.default_rng(8)
    x = np.sort(rng.uniform(0.0, 100.0, 500))
    y = 3.0 + 0.01 * x + rng.exponential(1.0, 500)
    slope, value = lower_line(x, y)
    above = y - value - slope * x
    assert above.min() == pytest.approx(0.0, abs=1e-12)
    # Of all lines below every point it has the least sum of distances: any other slope, moved up till it touches, more.
    for other in np.linspace(slope - 0.05, slope + 0.05, 41):
        shifted = y - other * x
        assert np.sum(shifted - shifted.min()) >= np.sum(above) - 1e-9


def test_outliers_do_not_turn_the_robust_line() -> None:
    rng = np.random.default_rng(9)
    x = np.arange(400.0)
    y = 2.0 + 0.5 * x + rng.normal(0.0, 0.1, 400)
    y[::10] += 50.0
    slope, value = robust_line(x, y)
    assert slope == pytest.approx(0.5, abs=1e-3)  # sigma of the slope: 0.1 / (sqrt(400) 115) = 4e-5, outliers pull some
    assert value == pytest.approx(2.0, abs=0.1)


def test_a_clock_that_was_held_up_in_stages_has_a_step_and_no_drift() -> None:
    """A host that stood still twice within 0.7 s, and was late in between: what came of it is one step."""
    first_s = np.arange(0.0, 150.0, 0.1)
    offset_s = 1e-4 * np.random.default_rng(3).gamma(2.0, 1.0, len(first_s))
    offset_s += np.interp(first_s, [0.0, 36.15, 36.2, 36.75, 36.8, 150.0], [0.0, 0.0, 0.25, 0.3, 0.6, 0.6])
    first_ns = np.round(first_s * 1e9).astype(np.int64)
    second_ns = np.round((first_s + offset_s) * 1e9).astype(np.int64)
    relation = fit_relation(
        ClockReadings("k", "simulation", "host", first_ns, first_ns, second_ns, "M", "f", late=True)
    )
    assert relation is not None
    (step,) = relation.steps
    assert step.at_ns * 1e-9 == pytest.approx(36.5, abs=0.5)
    assert step.size_s == pytest.approx(0.6, abs=2e-3)
    assert abs(relation.longest.slope_ppm) < 5.0
    # What the second clock leapt over belongs to the nearer side.
    assert relation.to_first(second_ns[[0, -1]]) == pytest.approx(first_ns[[0, -1]], abs=2e6)
