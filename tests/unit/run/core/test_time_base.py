"""Time bases against curves whose slope is known."""

from __future__ import annotations

import random
import statistics

import pytest

from xitl_cli.run.core.statistics import DriftWindows, Slope, Spread, TimeBase

S = 1_000_000_000


def test_the_spread_is_that_of_the_standard_library() -> None:
    rng = random.Random(1)
    values = [rng.gauss(1e6, 3.0) for _ in range(1000)]
    spread = Spread()
    for value in values:
        spread.add(value)
    assert spread.mean == pytest.approx(statistics.fmean(values), rel=1e-12)
    assert spread.deviation == pytest.approx(statistics.stdev(values), rel=1e-9)


def test_too_little_says_nothing() -> None:
    base, spread = TimeBase(), Spread()
    assert base.slope == Slope()
    base.add(1, 100)
    spread.add(1.0)
    assert base.slope == Slope()
    assert spread.deviation is None
    assert DriftWindows().deviation_ppm is None


def test_the_clock_of_an_agent_that_was_started_anew_is_no_part_of_the_curve() -> None:
    base = TimeBase()
    for sample in range(50):
        base.add(sample, sample * S // 10)
    before = base.slope
    base.add(51, S // 5)
    assert base.slope == before


def test_slope_and_its_variation_with_samples_missing() -> None:
    """A clock 80 ppm fast, sampled every 0.1 s with 1 ms of noise.

    The steps differ by the noise of two samples: their deviation is sqrt(2) ms. The chord over 6000 samples has the
    noise of its ends: sqrt(2) ms / 6000 = 0.24 us, bounded by 5 times that.
    """
    rng = random.Random(2)
    base = TimeBase()
    for sample in range(6000):
        if sample % 50:
            base.add(sample, round(sample * 0.1 * (1 + 80e-6) * S + rng.gauss(0.0, 1e6)))
    slope = base.slope
    assert slope.mean_s == pytest.approx(0.1 * (1 + 80e-6), abs=1.2e-6)
    assert slope.deviation_s == pytest.approx(1.414e-3, rel=0.06)


def test_a_number_that_comes_again_is_passed_over() -> None:
    base = TimeBase()
    for sample in (1, 2, 2, 1, 3):
        base.add(sample, sample * S)
    assert base.slope == Slope(1.0, 0.0)


def exchanges(drift_ppm: list[float], window_s: float = 10.0, jitter_ns: float = 50e3, seed: int = 3):
    """A clock whose drift changes from window to window; exponential delays above a floor of 100 us."""
    rng = random.Random(seed)
    local_ns, remote_ns, last_ns = 0.0, 5e9, 0.0
    for drift in drift_ppm:
        for _ in range(round(window_s * 10)):
            there_ns, back_ns = (100e3 + rng.expovariate(1 / jitter_ns) for _ in range(2))
            remote_ns += (local_ns - last_ns) * (1 + drift * 1e-6)
            last_ns = local_ns
            arrived_ns = remote_ns + there_ns
            yield round(local_ns), round(arrived_ns), round(arrived_ns), round(local_ns + there_ns + back_ns)
            local_ns += 1e8


@pytest.mark.medium
def test_the_variation_of_the_drift() -> None:
    """Drifts of known spread; a window of 100 exchanges finds its own to some 0.1 ppm with 50 us of jitter."""
    drifts = [10.0, 14.0, 6.0, 12.0, 8.0, 10.0, 15.0, 5.0]
    windows = DriftWindows()
    for exchange in exchanges([*drifts, 0.0]):
        windows.add(*exchange)
    assert windows.deviation_ppm == pytest.approx(statistics.stdev(drifts), abs=0.5)


def test_a_steady_clock_does_not_vary() -> None:
    windows = DriftWindows()
    for exchange in exchanges([80.0] * 8):
        windows.add(*exchange)
    assert windows.deviation_ppm == pytest.approx(0.0, abs=0.6)


def test_a_window_with_a_step_is_left_out() -> None:
    windows = DriftWindows()
    for t1, t2, t3, t4 in exchanges([20.0] * 8):
        step_ns = S // 2 if t1 > 35 * S else 0
        windows.add(t1, t2 + step_ns, t3 + step_ns, t4)
    assert windows.deviation_ppm == pytest.approx(0.0, abs=0.6)
