"""What numbers of many runs say: intervals, tests and estimates under their statisticians' names. No runs, no files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # type: ignore[import-untyped]
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Interval:
    """From low to high, both within."""

    low: float
    high: float

    @property
    def width(self) -> float:
        return self.high - self.low

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


def wilson_interval(passed: int, runs: int, confidence: float = 0.95) -> Interval:
    """Of a pass rate (Wilson 1927). The whole of [0, 1] without a run.

    Its coverage is near the nominal one at any rate and number of runs, and it says something of 20 out of 20. The
    exact one of Clopper and Pearson is never below the nominal coverage and therefore some 30 % wider at ten runs:
    a search would pay for that in runs (Brown, Cai and DasGupta 2001, Statistical Science 16).
    """
    if not runs:
        return Interval(0.0, 1.0)
    z = float(scipy.special.ndtri(0.5 + confidence / 2))
    rate, spread = passed / runs, z * z / runs
    middle = (rate + spread / 2) / (1 + spread)
    half = math.sqrt(rate * (1 - rate) * spread + spread * spread / 4) / (1 + spread)
    return Interval(0.0 if not passed else middle - half, 1.0 if passed == runs else middle + half)


@dataclass(frozen=True, slots=True)
class PassCounts:
    """Runs and how many of them passed at each point of an axis, in the order of the axis: (K,) each."""

    at: Floats
    runs: Counts
    passed: Counts

    @classmethod
    def counted(cls, at: Sequence[float], passed: Sequence[bool]) -> PassCounts:
        """From single runs, in any order."""
        points, of = np.unique(np.asarray(at, dtype=np.float64), return_inverse=True)
        runs = np.bincount(of, minlength=len(points))
        return cls(points, runs, np.bincount(of, weights=np.asarray(passed, dtype=np.float64)).astype(np.int64))

    @property
    def rates(self) -> Floats:
        return self.passed / self.runs

    def log_likelihood(self, rates: Floats) -> float:
        """Binomial, without the constant; rates (K,)."""
        failed = self.runs - self.passed
        return float((scipy.special.xlogy(self.passed, rates) + scipy.special.xlog1py(failed, -rates)).sum())


_DRAWS = 400


def monotone_rates(counts: PassCounts, rising: bool) -> Floats:
    """(K,): the rates of greatest likelihood among those that never turn (pool adjacent violators, Ayer 1955)."""
    return np.asarray(
        scipy.optimize.isotonic_regression(counts.rates, weights=counts.runs, increasing=rising).x, dtype=np.float64
    )


def monotony_p_value(counts: PassCounts, rising: bool) -> float:
    """How often counts as far from a monotone curve as these come from one, by likelihood ratio.

    The distribution is drawn from the monotone fit, with a generator of its own, so that it is the same twice.
    """
    if len(counts.at) < 3:
        return 1.0
    fit = monotone_rates(counts, rising)
    found = _departure(counts, rising, fit)
    if found < 1e-9:
        return 1.0
    rng = np.random.default_rng(0)
    passed = rng.binomial(counts.runs, fit, size=(_DRAWS, len(fit)))
    steps = np.diff(passed / counts.runs, axis=1)
    turns = (steps < 0.0 if rising else steps > 0.0).any(axis=1)
    drawn = (PassCounts(counts.at, counts.runs, one) for one in passed[turns])  # the others depart by nothing
    as_far = sum(_departure(one, rising, monotone_rates(one, rising)) >= found for one in drawn)
    return (as_far + 1) / (_DRAWS + 1)


def _departure(counts: PassCounts, rising: bool, fit: Floats) -> float:
    return counts.log_likelihood(counts.rates) - counts.log_likelihood(fit)


@dataclass(frozen=True, slots=True)
class BoundaryEstimate:
    """Where the pass rate crosses the one that is asked for: likeliest at `value`, with the confidence in `interval`.

    An infinite end of the interval: it may lie beyond that end of the axis.
    """

    value: float
    interval: Interval


def monotone_boundary(counts: PassCounts, rate: float, rising: bool, confidence: float = 0.95) -> BoundaryEstimate:
    """Where a monotone pass rate crosses `rate`, by likelihood ratio. counts: from the low to the high end of the axis.

    A place is in the interval when the best monotone curve that crosses there is not significantly less likely than
    the best of all (Banerjee and Wellner 2001, Annals of Statistics 29). Only monotony is supposed: a logistic curve
    needs half the runs where the truth is logistic, and misses it where the truth has another shape or a few per cent
    of the runs fail for reasons of their own. The likelihood is that of chi² with one degree of freedom, which holds
    for many runs at a point and is cautious for many points.
    """
    sign = 1 if rising else -1
    best = counts.log_likelihood(monotone_rates(counts, rising))
    limit = float(scipy.stats.chi2.ppf(confidence, 1)) / 2
    # The boundary lies before the first point, between two, or behind the last.
    likelihoods = np.array([_crossing_likelihood(counts, place, rate, sign) for place in range(len(counts.at) + 1)])
    ends = np.concatenate(([-np.inf], counts.at, [np.inf]))
    likely = np.flatnonzero(likelihoods >= best - limit)
    most = np.flatnonzero(likelihoods >= likelihoods.max() - 1e-9)
    low, high = np.clip((ends[most[0]], ends[most[-1] + 1]), counts.at[0], counts.at[-1])
    return BoundaryEstimate(float(low + high) / 2, Interval(float(ends[likely[0]]), float(ends[likely[-1] + 1])))


def _crossing_likelihood(counts: PassCounts, place: int, rate: float, sign: int) -> float:
    """Of the best monotone curve that crosses `rate` between the points place - 1 and place."""
    rates, runs = sign * counts.rates, counts.runs
    level = sign * rate
    fit = np.empty(len(rates))
    if place:
        fit[:place] = np.minimum(scipy.optimize.isotonic_regression(rates[:place], weights=runs[:place]).x, level)
    if place < len(rates):
        fit[place:] = np.maximum(scipy.optimize.isotonic_regression(rates[place:], weights=runs[place:]).x, level)
    return counts.log_likelihood(np.clip(sign * fit, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """Of b - a over pairs, by the paired t test.

    interval: of the mean, excludes zero just where p_value is below 1 - confidence. effect: Cohen's d_z, the mean
    over the standard deviation of the differences. wilcoxon_p_value: of the signed rank test, for one who doubts that
    the mean of so many differences is normal. None where there are too few pairs; where all differences are alike there
    is no deviation to go by, and p_value is that of the sign test.
    """

    pairs: int
    mean_a: float
    mean_b: float
    mean: float
    interval: Interval | None
    p_value: float | None
    effect: float | None
    wilcoxon_p_value: float | None


def paired_difference(a: Floats, b: Floats, confidence: float = 0.95) -> PairedDifference:
    """a, b: (N,), the same pair in the same row.

    The t test and not a bootstrap: with five to thirty pairs the percentile bootstrap's interval is too narrow (it
    covers some 90 % at ten pairs where 95 % are due), and the t interval errs less under skewness, as differences of
    pairs are less skewed than what they are of.
    """
    differences = np.asarray(b, dtype=np.float64) - np.asarray(a, dtype=np.float64)
    pairs = len(differences)
    mean = float(differences.mean()) if pairs else math.nan
    ends = (float(np.mean(a)) if pairs else math.nan, float(np.mean(b)) if pairs else math.nan)
    if pairs < 2:
        return PairedDifference(pairs, *ends, mean, None, None, None, None)
    deviation = float(differences.std(ddof=1))
    if deviation <= 1e-12 * max(1.0, abs(mean)):
        p_value = 1.0 if mean == 0.0 else 2.0 ** (1 - pairs)
        return PairedDifference(pairs, *ends, mean, Interval(mean, mean), p_value, None, None)
    error = deviation / math.sqrt(pairs)
    half = float(scipy.stats.t.ppf(0.5 + confidence / 2, pairs - 1)) * error
    p_value = 2.0 * float(scipy.stats.t.sf(abs(mean) / error, pairs - 1))
    signed_rank = float(scipy.stats.wilcoxon(differences).pvalue)
    interval = Interval(mean - half, mean + half)
    return PairedDifference(pairs, *ends, mean, interval, p_value, mean / deviation, signed_rank)


@dataclass(frozen=True, slots=True)
class PairedRates:
    """Pass rates of pairs. only_a, only_b: pairs of which only that one passed. interval: of rate b - rate a."""

    pairs: int
    passed_a: int
    passed_b: int
    only_a: int
    only_b: int
    interval: Interval
    p_value: float

    @property
    def difference(self) -> float:
        return (self.only_b - self.only_a) / self.pairs if self.pairs else 0.0


def paired_rates(a: Sequence[bool], b: Sequence[bool], confidence: float = 0.95) -> PairedRates:
    """McNemar's exact test (binomial over the pairs that differ); interval of Agresti and Min 2005, Stat. Med. 24."""
    pairs = len(a)
    only_a = sum(one and not other for one, other in zip(a, b, strict=True))
    only_b = sum(other and not one for one, other in zip(a, b, strict=True))
    differing = only_a + only_b
    p_value = float(scipy.stats.binomtest(only_b, differing).pvalue) if differing else 1.0
    z = float(scipy.special.ndtri(0.5 + confidence / 2))
    middle = (only_b - only_a) / (pairs + 2)
    half = z * math.sqrt(differing + 1 - (only_b - only_a) ** 2 / (pairs + 2)) / (pairs + 2)
    interval = Interval(max(-1.0, middle - half), min(1.0, middle + half))
    return PairedRates(pairs, sum(a), sum(b), only_a, only_b, interval, p_value)


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjusted for that many tests (Holm 1979): reject those below the level that was meant for one."""
    order = np.argsort(p_values, kind="stable")
    adjusted = [0.0] * len(p_values)
    highest = 0.0
    for rank, place in enumerate(order):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[place]))
        adjusted[int(place)] = highest
    return adjusted


@dataclass(frozen=True, slots=True)
class FigureSpread:
    """Of a figure over runs: quartiles and the 5th and 95th percentile, interpolated between runs."""

    runs: int
    least: float
    p5: float
    q1: float
    median: float
    q3: float
    p95: float
    most: float


def spread(values: Floats) -> FigureSpread:
    """values: (N,), at least one."""
    return FigureSpread(len(values), *(float(value) for value in np.percentile(values, (0, 5, 25, 50, 75, 95, 100))))


def mean_interval(values: Floats, confidence: float = 0.95) -> Interval | None:
    """Student's t; None of fewer than two."""
    if len(values) < 2:
        return None
    half = float(scipy.stats.t.ppf(0.5 + confidence / 2, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values)))
    middle = float(values.mean())
    return Interval(middle - half, middle + half)


_PRIOR_DEVIATION = 10.0  # of a coefficient in logits a unit of share: hardly a limit, but what keeps a step finite


@dataclass(frozen=True, slots=True)
class LogisticSurface:
    """Pass rate over several axes: logit of a polynomial of second order in shares of each axis' range (0 to 1).

    For pictures and for orientation: what it says of one place is borrowed from all others.
    """

    axes: int
    coefficients: Floats
    covariance: Floats

    @classmethod
    def fitted(cls, shares: Floats, passed: Sequence[bool]) -> LogisticSurface:
        """shares (N, D), one row a run. Ridge by a wide normal prior, Newton's method."""
        terms = _quadratic_terms(shares)
        outcome = np.asarray(passed, dtype=np.float64)
        prior = np.full(terms.shape[1], _PRIOR_DEVIATION**-2)
        prior[0] = 1e-6

        def loss(beta: Floats) -> tuple[float, Floats]:
            logits = terms @ beta
            value = (np.logaddexp(0.0, logits) - outcome * logits).sum() + 0.5 * (prior * beta**2).sum()
            return float(value), terms.T @ (scipy.special.expit(logits) - outcome) + prior * beta

        beta = scipy.optimize.minimize(loss, np.zeros(terms.shape[1]), jac=True, method="BFGS").x
        rates = scipy.special.expit(terms @ beta)
        information = (terms * (rates * (1 - rates))[:, None]).T @ terms + np.diag(prior)
        return cls(shares.shape[1], beta, np.linalg.inv(information))

    def rates(self, shares: Floats) -> tuple[Floats, Floats, Floats]:
        """Pass rate at shares (N, D), and the ends of its 95 % interval by the delta method: (N,) each."""
        terms = _quadratic_terms(shares)
        logits = terms @ self.coefficients
        deviation = np.sqrt(np.einsum("ni,ij,nj->n", terms, self.covariance, terms))
        half = float(scipy.special.ndtri(0.975)) * deviation
        return scipy.special.expit(logits), scipy.special.expit(logits - half), scipy.special.expit(logits + half)


def _quadratic_terms(shares: Floats) -> Floats:
    axes = shares.shape[1]
    products = [shares[:, i] * shares[:, j] for i in range(axes) for j in range(i, axes)]
    return np.column_stack([np.ones(len(shares)), shares, *products])
