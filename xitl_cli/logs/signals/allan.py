"""Allan deviation of a sensor at rest, and the noise parameters that follow from it.

Sources: IEEE Std 952-1997, annex C; N. El-Sheimy, H. Hou, X. Niu, "Analysis and Modeling of Inertial Sensors Using
Allan Variance", IEEE Trans. Instrum. Meas. 57(1), 2008. For a signal with unit u, each process alone has the deviation

    quantisation     sqrt(3) Q / tau               slope -1
    white noise      N / sqrt(tau)                 slope -1/2    N in u/sqrt(Hz), read at 1 s
    bias instability sqrt(2 ln 2 / pi) B           slope  0      B in u, read at the minimum: 0.664 B
    random walk      K sqrt(tau / 3)               slope +1/2    K in u sqrt(Hz), read at 3 s
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FLAT = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Allan deviation of flicker noise of bias instability 1: 0.664."""

FEWEST_CLUSTERS = 9
"""Least number of averages at the longest time: 9 leave the deviation uncertain by 25 %."""

_POINTS_PER_DECADE = 10
_STARTS_PER_CLUSTER = 64
_SLOPE_TOLERANCE = 0.15
_DECADE_SPAN = 0.5  # a slope counts if it holds over half a decade
_DEVIATIONS = 2.0  # allowed error of a slope, in its own standard deviations


@dataclass(frozen=True, slots=True)
class AllanCurve:
    """Allan deviation over averaging time.

    The error is 1 / sqrt(2 (T / tau - 1)), the value for clusters without overlap, which is conservative here.
    """

    tau_s: NDArray[np.float64]
    """(M,) rising."""
    deviation: NDArray[np.float64]
    """(M,) in the signal's unit."""
    relative_error: NDArray[np.float64]
    """(M,) one standard deviation."""


@dataclass(frozen=True, slots=True)
class ReadOff:
    """A parameter that is read off an Allan curve."""

    value: float
    """N, B or K in the unit of the module's table."""
    relative_error: float
    """One standard deviation."""
    from_tau_s: float
    """Beginning of the part of the curve that is used."""
    bound: bool = False
    """The record is too short to show the end of the process, so that the true value may be smaller."""


def overlapping(values: NDArray[np.float64], period_s: float) -> AllanCurve:
    """Overlapping Allan deviation of evenly spaced samples (N,); an empty curve with fewer than 18 samples.

    Clusters of up to 64 samples begin at every sample, longer ones 64 times per length. This costs no visible accuracy
    and limits the work to about 64 N. Raises ValueError if a sample is not finite or the period is not positive.
    """
    values = np.asarray(values, dtype=np.float64)
    if not (math.isfinite(period_s) and period_s > 0.0):
        raise ValueError(f"period_s = {period_s} must be a positive number of seconds")
    if not np.isfinite(values).all():
        raise ValueError("values must be finite; leave out what is not")
    samples = len(values)
    longest = samples // FEWEST_CLUSTERS
    if longest < 2:
        sizes = np.empty(0, dtype=np.int64)
    else:
        points = max(2, math.ceil(_POINTS_PER_DECADE * math.log10(longest)) + 1)
        sizes = np.unique(np.rint(np.geomspace(1, longest, points)).astype(np.int64))
    # Subtract the mean first: the running sum stays small, and so does its rounding.
    angle = np.concatenate(([0.0], np.cumsum(values - values.mean()))) if samples else np.zeros(1)
    variance = np.empty(len(sizes))
    for place, size in enumerate(sizes):
        step = max(1, int(size) // _STARTS_PER_CLUSTER)
        start = np.arange(0, samples - 2 * size + 1, step)
        second = angle[start + 2 * size] - 2.0 * angle[start + size] + angle[start]
        variance[place] = float(np.mean(second * second)) / (2.0 * float(size) ** 2)
    error = 1.0 / np.sqrt(2.0 * (samples / sizes - 1.0))
    return AllanCurve(sizes.astype(np.float64) * period_s, np.sqrt(variance), error)


def white_noise_density(curve: AllanCurve) -> ReadOff | None:
    """N from the part with slope -1/2: `N = sigma sqrt(tau)`, the value of the fitted line at 1 s."""
    return _by_slope(curve, -0.5, 1.0)


def random_walk(curve: AllanCurve) -> ReadOff | None:
    """K from the part with slope +1/2: `K = sigma sqrt(3 / tau)`, the value of the fitted line at 3 s."""
    return _by_slope(curve, 0.5, math.sqrt(3.0))


def bias_instability(curve: AllanCurve) -> ReadOff | None:
    """B from the lowest point, `sigma / 0.664`; None if the curve only rises, a bound if it falls to its end.

    It is only a bound unless two points beyond the lowest rise by more than their own error.
    """
    known = curve.deviation > 0.0
    if np.count_nonzero(known) < 3:
        return None
    tau_s, deviation, error = curve.tau_s[known], curve.deviation[known], curve.relative_error[known]
    lowest = int(np.argmin(deviation))
    if lowest == 0:
        return None
    beyond = deviation[lowest + 1 :] > deviation[lowest] * (1.0 + error[lowest])
    bound = int(np.count_nonzero(beyond)) < 2
    return ReadOff(float(deviation[lowest] / FLAT), float(error[lowest]), float(tau_s[lowest]), bound)


def _by_slope(curve: AllanCurve, slope: float, factor: float) -> ReadOff | None:
    """Mean of `sigma tau^-slope` over the widest part of the curve that has this slope, times `factor`."""
    if len(curve.tau_s) < 4 or not (curve.deviation > 0.0).all():
        return None
    x, y = np.log10(curve.tau_s), np.log10(curve.deviation)
    # Slope of the regression line through the points within `reach` decades on both sides of each point.
    local = np.empty(len(x))
    for place, centre in enumerate(x):
        near = np.abs(x - centre) <= 0.25
        if np.count_nonzero(near) < 2:
            near[max(0, place - 1) : place + 2] = True
        xs, ys = x[near] - x[near].mean(), y[near]
        local[place] = float(xs @ ys / (xs @ xs))
    # log10 of a value with a relative error e scatters by e / ln 10; neighbours on a short curve are strongly
    # correlated.
    scatter = curve.relative_error / math.log(10.0) * _DEVIATIONS
    fits = np.abs(local - slope) <= np.maximum(_SLOPE_TOLERANCE, np.minimum(scatter, 2 * _SLOPE_TOLERANCE))
    first, last = _widest(x, fits)
    if last < first or x[last] - x[first] < _DECADE_SPAN:
        return None
    part = slice(first, last + 1)
    weights = curve.relative_error[part] ** -2
    level = float(np.average(y[part] - slope * x[part], weights=weights))
    error = float(np.average(curve.relative_error[part], weights=weights))  # as if the errors of all points were equal
    return ReadOff(factor * 10.0**level, error, float(curve.tau_s[first]))


def _widest(x: NDArray[np.float64], fits: NDArray[np.bool_]) -> tuple[int, int]:
    """First and last index of the run of `fits` that spans most of x; (0, -1) if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], fits, [False])).astype(np.int8)))
    runs = list(zip(edges[0::2], edges[1::2] - 1, strict=True))
    if not runs:
        return 0, -1
    first, last = max(runs, key=lambda run: x[run[1]] - x[run[0]])
    return int(first), int(last)
