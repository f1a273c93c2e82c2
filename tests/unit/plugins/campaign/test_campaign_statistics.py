"""Intervals and tests against published tables, R's documentation and scipy."""

from __future__ import annotations

import numpy as np
import pytest

scipy = pytest.importorskip("scipy")

from xitl_cli.plugins.campaign.statistics import (  # noqa: E402
    Interval,
    LogisticSurface,
    PassCounts,
    clustered_rate_interval,
    holm,
    mean_interval,
    monotone_boundary,
    monotone_rates,
    monotony_p_value,
    paired_difference,
    paired_rates,
    spread,
    wilson_interval,
)

NEWCOMBE = [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0000, 0.1611), (1, 29, 0.0061, 0.1718)]
"""Newcombe 1998, Statistics in Medicine 17, table I, method 3."""
SLEEP = ([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0], [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])
"""Student 1908; R's documentation of `sleep` and t.test has what is to come out."""


@pytest.mark.parametrize(("passed", "runs", "low", "high"), NEWCOMBE)
def test_wilsons_interval(passed: int, runs: int, low: float, high: float) -> None:
    assert wilson_interval(passed, runs).low == pytest.approx(low, abs=5e-5)
    assert wilson_interval(passed, runs).high == pytest.approx(high, abs=5e-5)
    assert wilson_interval(runs - passed, runs).low == pytest.approx(1 - high, abs=5e-5)
    for confidence in (0.8, 0.99):
        theirs = scipy.stats.binomtest(passed, runs).proportion_ci(confidence, method="wilson")
        ours = wilson_interval(passed, runs, confidence)
        assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=1e-12)


def test_no_run_says_nothing() -> None:
    assert wilson_interval(0, 0) == Interval(0.0, 1.0)


@pytest.mark.medium
def test_students_sleep() -> None:
    told = paired_difference(*map(np.array, SLEEP))
    assert (told.pairs, told.mean) == (10, pytest.approx(1.58))
    assert told.interval is not None
    assert (told.interval.low, told.interval.high) == pytest.approx((0.7001142, 2.4598858), abs=1e-7)
    assert told.p_value == pytest.approx(0.002833, abs=1e-6)
    assert told.effect == pytest.approx(1.58 / 1.229995, abs=1e-5)
    assert told.wilcoxon_p_value == pytest.approx(scipy.stats.wilcoxon(*SLEEP).pvalue)


def test_differences_that_are_alike_or_too_few() -> None:
    same = paired_difference(np.array([1.0, 2.0]), np.array([1.0, 2.0]))
    assert (same.mean, same.p_value, same.interval, same.effect) == (0.0, 1.0, Interval(0.0, 0.0), None)
    shifted = paired_difference(np.array([1.0, 2.0]), np.array([2.0, 3.0]))
    assert (shifted.mean, shifted.p_value, shifted.interval) == (1.0, 0.5, Interval(1.0, 1.0))
    one = paired_difference(np.array([1.0]), np.array([3.0]))
    assert (one.pairs, one.mean, one.interval, one.p_value) == (1, 2.0, None, None)
    assert paired_difference(np.array([]), np.array([])).pairs == 0


def test_mcnemar_of_approval_ratings() -> None:
    """Agresti 2002, table 10.1: 794 approved twice, 150 then not, 86 then, 570 never; -0.04, -0.06 to -0.02."""
    first = [True] * 944 + [False] * 656
    second = [True] * 794 + [False] * 150 + [True] * 86 + [False] * 570
    told = paired_rates(first, second)
    assert (told.pairs, told.passed_a, told.passed_b, told.only_a, told.only_b) == (1600, 944, 880, 150, 86)
    assert told.difference == pytest.approx(-0.04)
    assert (told.interval.low, told.interval.high) == pytest.approx((-0.0587, -0.0213), abs=2e-4)
    assert told.p_value == pytest.approx(scipy.stats.binomtest(86, 236).pvalue)


def test_mcnemar_by_hand() -> None:
    """Five pairs differ, all one way: 2 / 2⁵."""
    told = paired_rates([False] * 5 + [True] * 15, [True] * 20)
    assert told.p_value == pytest.approx(0.0625)
    assert paired_rates([True] * 3, [True] * 3).p_value == 1.0


def test_the_interval_of_rates_is_walds_with_half_a_pair_more_in_each_cell() -> None:
    """Agresti and Min 2005: of 10 pairs 3 pass twice, 1 then not, 5 then, 1 never."""
    told = paired_rates([True] * 4 + [False] * 6, [True] * 3 + [False] + [True] * 5 + [False])
    shares = (np.array([3, 1, 5, 1]) + 0.5) / 12
    difference = shares[2] - shares[1]
    half = 1.959964 * np.sqrt((shares[1] + shares[2] - difference**2) / 12)
    assert (told.interval.low, told.interval.high) == pytest.approx((difference - half, difference + half))


def test_clusters_of_one_size_are_tested_by_their_means() -> None:
    rng = np.random.default_rng(3)
    seeds = np.repeat(np.arange(8), 5)
    differences = rng.normal(0.5, 1.0, 8)[seeds] + rng.normal(0.0, 0.3, 40)
    theirs = scipy.stats.ttest_1samp(differences.reshape(8, 5).mean(axis=1), 0.0)
    told = paired_difference(np.zeros(40), differences, clusters=seeds.tolist())
    bounds = theirs.confidence_interval(0.95)
    assert told.interval is not None
    assert (told.pairs, told.clusters, told.p_value) == (40, 8, pytest.approx(theirs.pvalue))
    assert (told.interval.low, told.interval.high) == pytest.approx((bounds.low, bounds.high))
    assert told.effect == pytest.approx(differences.mean() / differences.std(ddof=1))


def test_clusters_of_several_sizes_by_hand() -> None:
    told = paired_difference(np.zeros(3), np.array([1.0, 3.0, 5.0]), clusters=["a", "a", "b"])
    # Residuals -2, 0 | 2 about the mean 3: cluster sums -2 and 2; variance 2 / 1 * 8 / 9.
    half = scipy.stats.t.ppf(0.975, 1) * 4 / 3
    assert told.interval is not None
    assert (told.interval.low, told.interval.high) == pytest.approx((3 - half, 3 + half))
    with pytest.raises(ValueError, match="clusters has 2 labels for 3 values"):
        paired_difference(np.zeros(3), np.ones(3), clusters=["a", "b"])


@pytest.mark.medium
def test_clusters_of_one_value_change_nothing() -> None:
    first, second = [True] * 4 + [False] * 6, [True] * 3 + [False] + [True] * 5 + [False]
    assert paired_rates(first, second, clusters=range(10)) == paired_rates(first, second)
    assert paired_difference(*map(np.array, SLEEP), clusters=range(10)) == paired_difference(*map(np.array, SLEEP))
    assert clustered_rate_interval(first, range(10)) == wilson_interval(4, 10)


def test_runs_that_copy_each_other_within_a_cluster_count_once() -> None:
    values, copies = [True] * 7 + [False] * 5, 6
    clusters = list(range(12)) * copies
    for passed in (values, [True] * 12):
        copied = clustered_rate_interval(passed * copies, clusters)
        assert copied.width > wilson_interval(sum(passed), 12).width  # by the t quantile of 11 degrees of freedom
        assert copied.width < 1.2 * wilson_interval(sum(passed), 12).width
    p_values = [
        paired_rates(values, [True] * 12).p_value,
        paired_rates(values * copies, [True] * 12 * copies, clusters=clusters).p_value,
    ]
    assert p_values == pytest.approx([2 / 2**5] * 2)


@pytest.mark.nightly
@pytest.mark.slow
def test_campaigns_with_correlated_pairs_are_covered_as_often_as_stated() -> None:
    """1000 campaigns of 10 seeds at 6 values of an axis, with an effect of the seed on all its runs."""
    rng = np.random.default_rng(2024)
    seeds, at, campaigns = 10, 6, 1000
    clusters = np.repeat(np.arange(seeds), at).tolist()
    covered = np.zeros((3, 2))  # difference of a figure, difference of pass rates, pass rate; clustered, independent
    easy, hard = 1.2, 0.6
    rate_a = scipy.stats.norm.cdf(easy / np.sqrt(2.0))
    rate_b = scipy.stats.norm.cdf(hard / np.sqrt(3.0))
    for _ in range(campaigns):
        common, of_b = rng.normal(size=(2, seeds, 1))
        difference = (0.3 + of_b + rng.normal(0.0, 0.5, (seeds, at))).ravel()
        runs_a = (easy + common + rng.normal(size=(seeds, at)) > 0.0).ravel().tolist()
        runs_b = (hard + common + of_b + rng.normal(size=(seeds, at)) > 0.0).ravel().tolist()
        for way, labels in enumerate((clusters, None)):
            figure = paired_difference(np.zeros(seeds * at), difference, clusters=labels)
            rates = paired_rates(runs_a, runs_b, clusters=labels)
            rate = clustered_rate_interval(runs_a, labels or range(seeds * at))
            assert figure.interval is not None
            covered[:, way] += (0.3 in figure.interval, rate_b - rate_a in rates.interval, rate_a in rate)
    shares = covered / campaigns
    assert (shares[:, 0] > 0.93).all()  # three deviations of 1000 draws below 95 %
    assert (shares[:, 0] < 0.985).all()
    assert shares[0, 1] < 0.65
    assert (shares[1:, 1] < 0.88).all()


def test_holm_as_r_does() -> None:
    assert holm([0.01, 0.02, 0.03, 0.04, 0.05]) == pytest.approx([0.05, 0.08, 0.09, 0.09, 0.09])
    assert holm([0.04, 0.001, 0.9]) == pytest.approx([0.08, 0.003, 0.9])
    assert holm([]) == []


def test_spread_and_mean() -> None:
    values = np.arange(21.0)
    assert (spread(values).median, spread(values).p95, spread(values).q1) == (10.0, 19.0, 5.0)
    ours, theirs = mean_interval(values), scipy.stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert ours is not None
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high))
    assert mean_interval(values[:1]) is None


def counts(*rows: tuple[float, int, int]) -> PassCounts:
    at, runs, passed = (np.array(column) for column in zip(*rows, strict=True))
    return PassCounts(at.astype(float), runs, passed)


def test_counting() -> None:
    told = PassCounts.counted([2.0, 1.0, 2.0], [True, False, False])
    assert (told.at.tolist(), told.runs.tolist(), told.passed.tolist()) == ([1.0, 2.0], [1, 2], [0, 1])


def test_adjacent_violators_are_pooled() -> None:
    told = monotone_rates(counts((0, 10, 9), (1, 10, 4), (2, 30, 18), (3, 10, 0)), rising=False)
    assert told.tolist() == pytest.approx([0.9, 22 / 40, 22 / 40, 0.0])


def test_a_boundary_between_what_passes_and_what_fails() -> None:
    told = monotone_boundary(counts((0, 10, 10), (1, 10, 10), (2, 10, 0), (3, 10, 0)), 0.5, rising=False)
    assert (told.value, told.interval) == (1.5, Interval(1.0, 2.0))
    told = monotone_boundary(counts((0, 10, 0), (1, 10, 10)), 0.5, rising=True)
    assert (told.value, told.interval) == (0.5, Interval(0.0, 1.0))


def test_the_interval_by_hand() -> None:
    """9 of 10 and 6 of 10 against a rate of one half, by the likelihood that the boundary lies before the second.

    The second point's rate then is at most 1/2: 2 (6 ln 0.6 + 4 ln 0.4 - 10 ln 0.5) = 0.40 < 3.84: it may. The first
    one's too: 2 (15 ln 0.75 + 5 ln 0.25 - 20 ln 0.5) + what pooling costs is above 3.84 already: it may not.
    """
    told = monotone_boundary(counts((0, 10, 9), (1, 10, 6), (2, 10, 1)), 0.5, rising=False)
    assert told.interval == Interval(0.0, 2.0)
    assert 2 * (9 * np.log(0.9) + np.log(0.1) - 10 * np.log(0.5)) > 3.84


def test_what_passes_everywhere_has_its_boundary_beyond() -> None:
    told = monotone_boundary(counts((0, 10, 10), (1, 10, 10)), 0.5, rising=False)
    assert told.interval == Interval(1.0, np.inf)
    told = monotone_boundary(counts((0, 10, 0), (1, 10, 0)), 0.5, rising=False)
    assert told.interval == Interval(-np.inf, 0.0)


def test_a_gap_in_what_passes_is_not_monotone() -> None:
    assert monotony_p_value(counts((0, 10, 10), (1, 10, 1), (2, 10, 9)), rising=False) < 0.01
    assert monotony_p_value(counts((0, 10, 10), (1, 10, 6), (2, 10, 7), (3, 10, 1)), rising=False) > 0.2
    assert monotony_p_value(counts((0, 10, 10), (1, 10, 0)), rising=False) == 1.0


def test_a_p_value_from_random_draws_is_never_zero() -> None:
    """The observed counts are one of the possible draws (Davison and Hinkley 1997, eq. 4.11)."""
    impossible = counts((0, 1000, 1000), (1, 1000, 0), (2, 1000, 1000))
    assert 0.0 < monotony_p_value(impossible, rising=False) < 0.01


def test_a_surface_finds_the_plane_it_was_drawn_from() -> None:
    """logit p = 6 - 10 x: half at x = 0.6, whatever y."""
    rng = np.random.default_rng(3)
    shares = rng.random((2000, 2))
    passed = rng.random(2000) < 1 / (1 + np.exp(-(6 - 10 * shares[:, 0])))
    rates, low, high = LogisticSurface.fitted(shares, passed.tolist()).rates(
        np.array([[0.6, 0.2], [0.6, 0.8], [0.3, 0.5]])
    )
    assert rates == pytest.approx([0.5, 0.5, 1 / (1 + np.exp(-3))], abs=0.1)
    assert ((low < [0.5, 0.5, 0.9526]) & (high > [0.5, 0.5, 0.9526])).all()


def test_without_pairs_or_runs_nothing_is_known() -> None:
    told = paired_rates([], [])
    assert (told.pairs, told.passed_a, told.passed_b, told.only_a, told.only_b) == (0, 0, 0, 0, 0)
    assert (told.interval, told.p_value, told.clusters, told.difference) == (Interval(-1.0, 1.0), 1.0, 0, 0.0)
    assert clustered_rate_interval([], []) == Interval(0.0, 1.0)
