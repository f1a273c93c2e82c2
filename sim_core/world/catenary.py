"""A line that hangs between two points with a given sag, as a boom does in plan under an even current."""

from __future__ import annotations

import math

import numpy as np
from numpy import float64
from numpy.typing import NDArray

Array = NDArray[float64]


def parameter_m(span_m: float, sag_m: float) -> float:
    """a of y = a cosh(x / a) with the given sag over the span: sag = a (cosh(span / 2a) - 1). By halving; sag > 0."""
    # sag < span^2 / 8a (1 + (span / 2a)^2 / 6 ...): the parabola's a is the least.
    low, high = 0.1 * min(sag_m, span_m), 10.0 * (span_m**2 / (8 * sag_m) + sag_m + span_m)
    for _ in range(200):
        middle = math.sqrt(low * high)
        # cosh overflows beyond 700.
        turn = min(span_m / (2 * middle), 700.0)
        if 2 * middle * math.sinh(turn / 2) ** 2 > sag_m:
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)


def length_m(span_m: float, sag_m: float) -> float:
    """Along the line: 2 a sinh(span / 2a)."""
    if sag_m == 0.0:
        return span_m
    a = parameter_m(span_m, sag_m)
    return 2 * a * math.sinh(span_m / (2 * a))


def points_m(from_ne_m: Array, to_ne_m: Array, sag_m: float, share: Array) -> Array:
    """(K, 2) places at shares (K,) of the length between two points (2,), sagging to the right of the way there."""
    way = to_ne_m - from_ne_m
    if sag_m == 0.0:
        straight: Array = from_ne_m + share[:, None] * way
        return straight
    span_m = math.hypot(way[0], way[1])
    a = parameter_m(span_m, sag_m)
    # s = a sinh(x / a) from the middle.
    x = a * np.arcsinh((share - 0.5) * 2 * math.sinh(span_m / (2 * a)))
    depth = sag_m - 2 * a * np.sinh(x / (2 * a)) ** 2
    ahead = way / span_m
    right = np.array([-ahead[1], ahead[0]])
    hanging: Array = from_ne_m + (x[:, None] + span_m / 2) * ahead + depth[:, None] * right
    return hanging
