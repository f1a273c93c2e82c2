"""Statistics of many runs: intervals, tests and estimates under their standard names. No runs, no files."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence

import numpy as np
import scipy  # type: ignore[import-untyped]
from numpy.typing import NDArray

from sim_core.dataclass import dataclass

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Interval:
    """Closed interval."""

    low: float
    high: float

    @property
    def width(self) -> float:
        return self.high - self.low

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


def wilson_interval(passed: float, runs: float, confidence: float = 0.95) -> Interval:
    """Return the interval of a pass rate (Wilson 1927), [0, 1] without runs. Counts are integers or effective numbers
    of runs.

    Its coverage is near the nominal one at any rate and number of runs, and it is informative for 20 out of 20. The
    exact interval of Clopper and Pearson never covers less than nominal. It is therefore about 30 % wider at ten runs,
    and a search would need more runs (Brown, Cai and DasGupta 2001, Statistical Science 16).
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
    """Number of runs and passed runs at each point of an axis, in the order of the axis: (K,) each."""

    at: Floats
    runs: Counts
    passed: Counts

    @classmethod
    def counted(cls, at: Sequence[float], passed: Sequence[bool]) -> PassCounts:
        """Count single runs, in any order."""
        points, of = np.unique(np.asarray(at, dtype=np.float64), return_inverse=True)
        runs = np.bincount(of, minlength=len(points))
        return cls(points, runs, np.bincount(of, weights=np.asarray(passed, dtype=np.float64)).astype(np.int64))

    @property
    def rates(self) -> Floats:
        return self.passed / self.runs

    def log_likelihood(self, rates: Floats) -> float:
        """Return the binomial log-likelihood, without the constant; rates (K,)."""
        failed = self.runs - self.passed
        return float((scipy.special.xlogy(self.passed, rates) + scipy.special.xlog1py(failed, -rates)).sum())


_DRAWS = 400


def monotone_rates(counts: PassCounts, rising: bool) -> Floats:
    """Return the (K,) monotone rates of maximum likelihood (pool adjacent violators, Ayer 1955)."""
    return np.asarray(
        scipy.optimize.isotonic_regression(counts.rates, weights=counts.runs, increasing=rising).x, dtype=np.float64
    )


def monotony_p_value(counts: PassCounts, rising: bool) -> float:
    """Return the probability that a monotone curve gives counts as far from monotone as these, by likelihood ratio.

    The distribution is drawn from the monotone fit with a fixed generator, so that the result is reproducible.
    """
    if len(counts.at) < 3:
        return 1.0
    fit = monotone_rates(counts, rising)
    observed = _departure(counts, rising, fit)
    if observed < 1e-9:
        return 1.0
    rng = np.random.default_rng(0)
    passed = rng.binomial(counts.runs, fit, size=(_DRAWS, len(fit)))
    steps = np.diff(passed / counts.runs, axis=1)
    turns = (steps < 0.0 if rising else steps > 0.0).any(axis=1)
    drawn = (PassCounts(counts.at, counts.runs, row) for row in passed[turns])  # the others have no departure
    as_far = sum(_departure(draw, rising, monotone_rates(draw, rising)) >= observed for draw in drawn)
    return (as_far + 1) / (_DRAWS + 1)


def _departure(counts: PassCounts, rising: bool, fit: Floats) -> float:
    return counts.log_likelihood(counts.rates) - counts.log_likelihood(fit)


@dataclass(frozen=True, slots=True)
class BoundaryEstimate:
    """Crossing of the pass rate and the required rate. An infinite end of the interval may lie beyond that end of the
    axis.
    """

    value: float
    """Maximum likelihood estimate."""
    interval: Interval
    """Confidence interval."""


def monotone_boundary(counts: PassCounts, rate: float, rising: bool, confidence: float = 0.95) -> BoundaryEstimate:
    """Return the crossing of a monotone pass rate and `rate`, by likelihood ratio. counts: from the low to the high
    end.

    A place is in the interval if the best monotone curve that crosses there is not significantly less likely than the
    best of all (Banerjee and Wellner 2001, Annals of Statistics 29). The method assumes only monotony. A logistic curve
    needs half the runs if the truth is logistic. It fails for other shapes, or if a few per cent of the runs fail for
    unrelated reasons. The likelihood ratio has the distribution chi² with one degree of freedom. This is valid for many
    runs at a point and conservative for many points.
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
    """Return the likelihood of the best monotone curve that crosses `rate` between the points place - 1 and place."""
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
    """Difference b - a over pairs, by a t test over clusters. A cluster is the pairs of one seed.

    If all clusters are equal, there is no deviation. p_value is then that of the sign test.
    """

    pairs: int
    mean_a: float
    mean_b: float
    mean: float
    interval: Interval | None
    """Interval of the mean. It excludes zero exactly if p_value is below 1 - confidence. None for too few clusters."""
    p_value: float | None
    effect: float | None
    """Cohen's d_z, the mean over the standard deviation of the differences."""
    wilcoxon_p_value: float | None
    """P-value of the signed rank test over the clusters' means, which does not assume a normal mean. None for too few
    clusters.
    """
    clusters: int
    """Number of clusters; the t distribution has one degree of freedom less."""


def paired_difference(
    a: Floats, b: Floats, confidence: float = 0.95, clusters: Sequence[Hashable] | None = None
) -> PairedDifference:
    """Test the difference of pairs. a, b: (N,), a pair per row. clusters: (N,) labels of dependent pairs.

    Without clusters, each pair is a cluster. The variance of the mean is the cluster-robust one (Liang and Zeger 1986)
    with the factor G / (G - 1) for G clusters. For clusters of equal size it is that of the t test over the clusters'
    means. Without clusters it is that of the paired t test.

    The method is a t test and not a bootstrap. With five to thirty pairs, the percentile bootstrap's interval is too
    narrow: it covers about 90 % at ten pairs instead of 95 %. The t interval has a smaller error under skewness,
    because differences of pairs are less skewed than the values.
    """
    differences = np.asarray(b, dtype=np.float64) - np.asarray(a, dtype=np.float64)
    pairs = len(differences)
    mean = float(differences.mean()) if pairs else math.nan
    ends = (float(np.mean(a)) if pairs else math.nan, float(np.mean(b)) if pairs else math.nan)
    of = _cluster_numbers(clusters, pairs)
    count = int(of.max()) + 1 if pairs else 0
    if count < 2:
        return PairedDifference(pairs, *ends, mean, None, None, None, None, count)
    error = _clustered_error(differences, of)
    if error * math.sqrt(count) <= 1e-12 * max(1.0, abs(mean)):
        p_value = 1.0 if mean == 0.0 else 2.0 ** (1 - count)
        return PairedDifference(pairs, *ends, mean, Interval(mean, mean), p_value, None, None, count)
    half = float(scipy.stats.t.ppf(0.5 + confidence / 2, count - 1)) * error
    p_value = 2.0 * float(scipy.stats.t.sf(abs(mean) / error, count - 1))
    means = np.bincount(of, weights=differences) / np.bincount(of)
    signed_rank = float(scipy.stats.wilcoxon(means).pvalue)
    interval = Interval(mean - half, mean + half)
    effect = mean / float(differences.std(ddof=1))
    return PairedDifference(pairs, *ends, mean, interval, p_value, effect, signed_rank, count)


def _cluster_numbers(clusters: Sequence[Hashable] | None, values: int) -> Counts:
    """Return (N,), the cluster of each value, counted from 0. Without clusters, each value is a cluster."""
    if clusters is None:
        return np.arange(values)
    if len(clusters) != values:
        raise ValueError(f"clusters has {len(clusters)} labels for {values} values; give one label for each value")
    numbers = {label: number for number, label in enumerate(dict.fromkeys(clusters))}
    return np.array([numbers[label] for label in clusters], dtype=np.int64)


def _clustered_error(values: Floats, of: Counts) -> float:
    """Return the standard error of the mean of values (N,) in clusters of (N,); at least two clusters."""
    sums = np.bincount(of, weights=values - values.mean())
    return math.sqrt(len(sums) / (len(sums) - 1) * float(sums @ sums)) / len(values)


def _effective_share(values: Floats, of: Counts, confidence: float) -> float:
    """Return the share of N clustered values (N,) that count as independent (Korn and Graubard 1998, Survey Methodology
    24).

    It is the inverse of the design effect, times the squared ratio of the normal and the t quantile for this number of
    clusters. It is at most 1, and 1 without clusters. Equal values show no design effect: a cluster then counts as one
    value. The same applies for a single cluster.
    """
    count = int(of.max()) + 1
    if count == len(values):
        return 1.0
    least = count / len(values)
    if count < 2:
        return least
    plain, error = float(values.std(ddof=1)) / math.sqrt(len(values)), _clustered_error(values, of)
    share = least if plain == 0.0 else 1.0 if error <= plain else (plain / error) ** 2
    level = 0.5 + confidence / 2
    quantiles = float(scipy.special.ndtri(level)) / float(scipy.stats.t.ppf(level, count - 1))
    return share * quantiles**2


@dataclass(frozen=True, slots=True)
class PairedRates:
    """Pass rates of pairs."""

    pairs: int
    passed_a: int
    passed_b: int
    only_a: int
    """Number of pairs in which only a passed."""
    only_b: int
    """Number of pairs in which only b passed."""
    interval: Interval
    """Interval of rate b - rate a."""
    p_value: float
    clusters: int
    """Number of groups of dependent pairs, such as the pairs of one seed."""

    @property
    def difference(self) -> float:
        return (self.only_b - self.only_a) / self.pairs if self.pairs else 0.0


def paired_rates(
    a: Sequence[bool], b: Sequence[bool], confidence: float = 0.95, clusters: Sequence[Hashable] | None = None
) -> PairedRates:
    """Return an exact test and the interval of the difference of two pass rates. clusters: as for `paired_difference`.

    The test uses all changes of sign of the clusters' differences: without an effect, A and B may be exchanged within a
    cluster. Without clusters it is McNemar's exact test (binomial over the pairs that differ). The interval is that of
    Agresti and Min 2005, Stat. Med. 24, with the effective number of pairs (Korn and Graubard 1998).
    """
    pairs = len(a)
    differences = np.asarray(b, dtype=np.float64) - np.asarray(a, dtype=np.float64)
    only_a, only_b = int((differences < 0).sum()), int((differences > 0).sum())
    passed = (int(sum(a)), int(sum(b)))
    if not pairs:
        return PairedRates(0, *passed, only_a, only_b, Interval(-1.0, 1.0), 1.0, 0)
    of = _cluster_numbers(clusters, pairs)
    p_value = _sign_change_p_value(np.bincount(of, weights=differences).astype(np.int64))
    share = _effective_share(differences, of, confidence)
    effective, differing, lead = share * pairs, share * (only_a + only_b), share * (only_b - only_a)
    z = float(scipy.special.ndtri(0.5 + confidence / 2))
    middle = lead / (effective + 2)
    half = z * math.sqrt(differing + 1 - lead**2 / (effective + 2)) / (effective + 2)
    interval = Interval(max(-1.0, middle - half), min(1.0, middle + half))
    return PairedRates(pairs, *passed, only_a, only_b, interval, p_value, int(of.max()) + 1)


def _sign_change_p_value(differences: Counts) -> float:
    """Return the share of all changes of sign of integers (G,) with a sum at least as far from zero as theirs."""
    sizes = np.abs(differences[differences != 0])
    distance = abs(int(differences.sum()))
    middle = int(sizes.sum())
    chances = np.zeros(2 * middle + 1)  # of each sum from -middle to middle
    chances[middle] = 1.0
    for size in sizes:
        chances = 0.5 * (np.roll(chances, size) + np.roll(chances, -size))  # the ends are zero, so nothing wraps around
    sums = np.abs(np.arange(-middle, middle + 1))
    return min(1.0, float(chances[sums >= distance].sum()))


def clustered_rate_interval(passed: Sequence[bool], clusters: Sequence[Hashable]) -> Interval:
    """Return Wilson's 95 % interval of a pass rate for runs that depend on each other in clusters, such as one seed.

    passed, clusters: (N,). Runs count as the effective number of independent ones (Korn and Graubard 1998). With a
    cluster for each run it is `wilson_interval`.
    """
    if not len(passed):
        return Interval(0.0, 1.0)
    values = np.asarray(passed, dtype=np.float64)
    share = _effective_share(values, _cluster_numbers(clusters, len(values)), 0.95)
    return wilson_interval(share * float(values.sum()), share * len(values))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for their number (Holm 1979): reject those below the level of a single test."""
    order = np.argsort(p_values, kind="stable")
    adjusted = [0.0] * len(p_values)
    highest = 0.0
    for rank, place in enumerate(order):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[place]))
        adjusted[int(place)] = highest
    return adjusted


@dataclass(frozen=True, slots=True)
class FigureSpread:
    """Distribution of a figure over runs: quartiles and the 5th and 95th percentile, interpolated between runs."""

    runs: int
    least: float
    p5: float
    q1: float
    median: float
    q3: float
    p95: float
    most: float


def spread(values: Floats) -> FigureSpread:
    """Return the distribution of values (N,), at least one."""
    return FigureSpread(len(values), *(float(value) for value in np.percentile(values, (0, 5, 25, 50, 75, 95, 100))))


def mean_interval(values: Floats, confidence: float = 0.95) -> Interval | None:
    """Return the interval of Student's t; None for fewer than two values."""
    if len(values) < 2:
        return None
    half = float(scipy.stats.t.ppf(0.5 + confidence / 2, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values)))
    middle = float(values.mean())
    return Interval(middle - half, middle + half)


_PRIOR_DEVIATION = 10.0  # of a coefficient in logits per unit of share: almost no limit, but it keeps a step finite


@dataclass(frozen=True, slots=True)
class LogisticSurface:
    """Pass rate over several axes: logit of a polynomial of second order in shares of each axis' range (0 to 1).

    For plots and orientation: the value at one place depends on the data at all others.
    """

    axes: int
    coefficients: Floats
    covariance: Floats

    @classmethod
    def fitted(cls, shares: Floats, passed: Sequence[bool]) -> LogisticSurface:
        """Fit shares (N, D), one row per run, by ridge regression with a wide normal prior and Newton's method."""
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
        """Return the pass rate at shares (N, D), and the ends of its 95 % interval by the delta method: (N,) each."""
        terms = _quadratic_terms(shares)
        logits = terms @ self.coefficients
        deviation = np.sqrt(np.einsum("ni,ij,nj->n", terms, self.covariance, terms))
        half = float(scipy.special.ndtri(0.975)) * deviation
        return scipy.special.expit(logits), scipy.special.expit(logits - half), scipy.special.expit(logits + half)


def _quadratic_terms(shares: Floats) -> Floats:
    axes = shares.shape[1]
    products = [shares[:, i] * shares[:, j] for i in range(axes) for j in range(i, axes)]
    return np.column_stack([np.ones(len(shares)), shares, *products])
