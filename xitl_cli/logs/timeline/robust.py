"""A line through readings whose errors have no preferred sign, outliers among them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROUNDS = 30
HUBER = 1.345  # of the scale: 95 % as efficient as least squares where all errors are normal
TO_SIGMA = 1.4826  # of the median absolute deviation of a normal distribution


def spread(values: Floats) -> float:
    """Standard deviation as the median absolute deviation tells it: half of the values may be anything."""
    return float(TO_SIGMA * np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope, and value at x = 0: Huber's M-estimate by iteratively reweighted least squares."""
    weight = np.ones(len(x))
    slope = value = 0.0
    for _ in range(ROUNDS):
        total = float(np.sum(weight))
        mean_x, mean_y = float(np.sum(weight * x)) / total, float(np.sum(weight * y)) / total
        away = x - mean_x
        square = float(np.sum(weight * away * away))
        before = (slope, value)
        slope = float(np.sum(weight * away * (y - mean_y))) / square if square > 0.0 else 0.0
        value = mean_y - slope * mean_x
        error = y - value - slope * x
        scale = spread(error)
        if scale <= 0.0 or before == (slope, value):
            break
        weight = HUBER * scale / np.maximum(np.abs(error), HUBER * scale)
    return slope, value
