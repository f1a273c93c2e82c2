"""Allan deviation against the estimator written out term by term, and against the closed forms of IEEE Std 952."""

import math

import numpy as np
import pytest

from xitl_cli.logs.signals.allan import (
    FLAT,
    AllanCurve,
    bias_instability,
    overlapping,
    random_walk,
    white_noise_density,
)

RATE_HZ = 100.0
PERIOD_S = 1.0 / RATE_HZ


def naive(values: np.ndarray, size: int) -> float:
    """Half the mean square of the differences of neighbouring averages, for every place where both fit."""
    squares = []
    for start in range(len(values) - 2 * size + 1):
        first = sum(values[start : start + size]) / size
        second = sum(values[start + size : start + 2 * size]) / size
        squares.append((second - first) ** 2)
    return math.sqrt(0.5 * sum(squares) / len(squares))


def test_it_is_the_estimator_written_out():
    values = np.random.default_rng(1).standard_normal(400) + 7.0
    curve = overlapping(values, PERIOD_S)
    sizes = np.rint(curve.tau_s / PERIOD_S).astype(int)
    assert sizes[0] == 1
    assert sizes[-1] == 400 // 9
    # Running sums of 400 values of order 10 are exact to 1e-12.
    np.testing.assert_allclose(curve.deviation, [naive(values, size) for size in sizes], rtol=1e-9)


def test_long_clusters_that_begin_less_often_lose_nothing_that_shows():
    values = np.cumsum(np.random.default_rng(2).standard_normal(20_000))
    curve = overlapping(values, 1.0)
    sums = np.concatenate(([0.0], np.cumsum(values)))
    for tau_s, deviation in zip(curve.tau_s, curve.deviation, strict=True):
        size = round(tau_s)
        if size > 128:
            second = sums[2 * size :] - 2.0 * sums[size:-size] + sums[: -2 * size]
            every = math.sqrt(float(np.mean(second**2)) / 2.0) / size
            # Starts 1/64 of a length apart are correlated by more than 0.95: what lies between adds next to nothing.
            assert deviation == pytest.approx(every, rel=0.01)


def test_white_noise_falls_with_the_root_of_time():
    density = 2e-3
    values = density * math.sqrt(RATE_HZ) * np.random.default_rng(3).standard_normal(60_000)
    curve = overlapping(values, PERIOD_S)
    errors = (curve.deviation * np.sqrt(curve.tau_s) / density - 1.0) / curve.relative_error
    assert np.abs(errors).max() < 4.0
    found = white_noise_density(curve)
    assert found is not None
    # The short times, of thousands of clusters, weigh most: 1 % is three deviations of the mean of 60 000 squares.
    assert found.value == pytest.approx(density, rel=0.01)
    assert found.from_tau_s == pytest.approx(PERIOD_S)
    assert random_walk(curve) is None
    flat = bias_instability(curve)
    assert flat is not None
    assert flat.bound, "it falls to its end: the bias instability may be smaller"


def test_a_random_walk_rises_with_the_root_of_time():
    k = 3e-4
    steps = k * math.sqrt(PERIOD_S) * np.random.default_rng(4).standard_normal(200_000)
    curve = overlapping(np.cumsum(steps), PERIOD_S)
    found = random_walk(curve)
    assert found is not None
    assert found.value == pytest.approx(k, rel=0.03)
    assert white_noise_density(curve) is None
    assert bias_instability(curve) is None, "a curve that only rises has no floor"


def test_quantisation_has_slope_minus_one_and_is_no_white_noise():
    # A rate whose integral is read in whole steps: each reading errs by up to half a step, differences by two of them.
    step = 1e-3
    angle = np.random.default_rng(5).uniform(-0.5, 0.5, 50_001) * step
    curve = overlapping(np.diff(angle) / PERIOD_S, PERIOD_S)
    # sqrt(3) Q / tau with Q = step / sqrt(12); at tau >= one sample, every term has three independent readings 1 2 1.
    np.testing.assert_allclose(
        curve.deviation[:15] * curve.tau_s[:15], math.sqrt(3.0) * step / math.sqrt(12.0), rtol=0.03
    )
    assert white_noise_density(curve) is None


def test_read_offs_of_a_curve_that_has_all_three():
    n, b, k = 1e-3, 2e-4, 1e-5
    tau_s = np.geomspace(0.01, 10_000.0, 61)
    curve = AllanCurve(tau_s, np.sqrt(n**2 / tau_s + (FLAT * b) ** 2 + k**2 * tau_s / 3.0), np.full(len(tau_s), 0.01))
    white, flat, walk = white_noise_density(curve), bias_instability(curve), random_walk(curve)
    assert white is not None
    assert flat is not None
    assert walk is not None
    # At a slope of 0.35 the process is 70 % of the square, its level read 1.2 times too high; on average over the part
    # that is read, up to half of that.
    assert white.value == pytest.approx(n, rel=0.1)
    assert walk.value == pytest.approx(k, rel=0.1)
    # At the floor the white noise and the walk add n k / sqrt(3) * 2 to the square.
    assert flat.value == pytest.approx(math.sqrt(b**2 + 2.0 * n * k / math.sqrt(3.0) / FLAT**2), rel=1e-3)
    assert not flat.bound


@pytest.mark.parametrize("count", [0, 1, 17])
def test_too_short_a_record_has_no_curve(count):
    curve = overlapping(np.zeros(count), 0.1)
    assert len(curve.tau_s) == 0
    assert white_noise_density(curve) is None
    assert bias_instability(curve) is None
    assert random_walk(curve) is None


def test_what_does_not_vary_has_nothing_to_read():
    curve = overlapping(np.full(1000, 3.0), 0.1)
    assert (curve.deviation == 0.0).all()
    assert white_noise_density(curve) is None
    assert bias_instability(curve) is None


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="finite"):
        overlapping(np.array([1.0, np.nan] * 20), 0.1)
    with pytest.raises(ValueError, match="positive"):
        overlapping(np.zeros(40), 0.0)
    with pytest.raises(ValueError, match="positive"):
        overlapping(np.zeros(40), -0.1)


def curve_of(tau_s, deviation, error=1e-3):
    return AllanCurve(np.asarray(tau_s, dtype=float), np.asarray(deviation, dtype=float), np.full(len(tau_s), error))


def test_a_coarse_curve_is_read_by_its_neighbours():
    """No other point is within a quarter of a decade."""
    tau_s = np.array([1.0, 4.0, 16.0, 64.0])
    white, walk = (
        white_noise_density(curve_of(tau_s, 2.0 * tau_s**-0.5)),
        random_walk(curve_of(tau_s, 2.0 * tau_s**0.5)),
    )
    assert white is not None
    assert walk is not None
    assert (white.value, white.from_tau_s, white.relative_error) == (pytest.approx(2.0), 1.0, pytest.approx(1e-3))
    assert walk.value == pytest.approx(2.0 * math.sqrt(3.0))
    assert white_noise_density(curve_of(tau_s[:3], tau_s[:3] ** -0.5)) is None


def test_the_widest_part_with_a_slope_is_read():
    tau_s = np.geomspace(1.0, 1e5, 51)
    flat = np.where(
        tau_s < 10.0, tau_s**-0.5, np.where(tau_s < 100.0, 10.0**-0.5, 10.0**-0.5 * (tau_s / 100.0) ** -0.5)
    )
    found = white_noise_density(curve_of(tau_s, flat))
    assert found is not None
    assert found.from_tau_s == pytest.approx(100.0, rel=0.3)
    assert found.value == pytest.approx(10.0**0.5, rel=0.02)


@pytest.mark.parametrize(("decades", "read"), [(0.55, True), (0.45, False)])
def test_a_slope_must_hold_over_half_a_decade(decades, read):
    tau_s = np.geomspace(1.0, 10.0**decades, 8)
    assert (white_noise_density(curve_of(tau_s, tau_s**-0.5)) is not None) is read


@pytest.mark.parametrize(
    ("slope", "read"), [(-0.5, True), (-0.64, True), (-0.36, True), (-0.66, False), (-0.34, False)]
)
def test_a_slope_may_be_off_by_a_small_part(slope, read):
    tau_s = np.geomspace(1.0, 100.0, 21)
    assert (white_noise_density(curve_of(tau_s, tau_s**slope)) is not None) is read


def test_the_floor_is_the_lowest_point_with_its_bound():
    deviation = [8.0, 4.0, 2.0, 2.1, 2.5, 2.6]
    tau_s = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0]
    found = bias_instability(curve_of(tau_s, deviation, 0.1))
    assert found is not None
    assert (found.value, found.relative_error, found.from_tau_s, found.bound) == (
        pytest.approx(2.0 / FLAT),
        0.1,
        4.0,
        False,
    )
    wide = bias_instability(curve_of(tau_s, deviation, 0.26))  # one point beyond 2.52 alone
    assert wide is not None
    assert wide.bound
    assert bias_instability(curve_of(tau_s[:2], deviation[:2])) is None
    assert bias_instability(curve_of(tau_s, sorted(deviation))) is None
    zeros = bias_instability(curve_of(tau_s, [0.0, 4.0, 2.0, 2.5, 2.6, 0.0]))
    assert zeros is not None
    assert zeros.from_tau_s == 4.0
