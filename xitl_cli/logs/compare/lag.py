"""How much later one signal comes than another that looks like it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST_S = 10.0
LEAST_ALIKE = 0.5
_STEP_S = 0.025
_MOST_STEPS = 20_000
_LEAST_CHANGE = 1e-9


def best_lag(
    stamp_ns: NDArray[np.int64], a: Array, b: Array, *, turns: bool, longest_s: float = LONGEST_S
) -> tuple[float | None, float | None]:
    """The highest correlation coefficient within shifts of `longest_s`, and how much later (s) B is there.

    Both are sampled at `stamp_ns`. Angles (deg) are correlated as directions, so that a turn more does not count. The
    coefficient is None where one of them does not change; the lag also where nothing is alike (under 0.5) or the best
    shift is the longest one.
    """
    seconds = (stamp_ns - stamp_ns[0]) * 1e-9
    step_s = max(_STEP_S, float(seconds[-1]) / _MOST_STEPS)
    grid = np.arange(0.0, float(seconds[-1]), step_s)
    most = min(int(longest_s / step_s), len(grid) // 4)
    if most < 1:
        return None, None
    in_a, in_b = _even(grid, seconds, a, turns), _even(grid, seconds, b, turns)
    if min(float(np.abs(in_a - in_a[0]).max()), float(np.abs(in_b - in_b[0]).max())) < _LEAST_CHANGE:
        return None, None
    found = np.array([_correlation(in_a, in_b, shift) for shift in range(-most, most + 1)])
    if not np.isfinite(found).any():
        return None, None
    best = int(np.nanargmax(found))
    highest = float(found[best])
    if highest < LEAST_ALIKE or not 0 < best < len(found) - 1:
        return highest, None
    left, top, right = found[best - 1 : best + 2]
    bend = float(left - 2.0 * top + right)
    between = 0.5 * float(left - right) / bend if np.isfinite(bend) and bend < 0.0 else 0.0
    return highest, (best + between - most) * step_s


def _even(grid: Array, seconds: Array, values: Array, turns: bool) -> NDArray[Any]:
    if not turns:
        return np.interp(grid, seconds, values)
    angle = np.radians(values)
    return np.interp(grid, seconds, np.cos(angle)) + 1j * np.interp(grid, seconds, np.sin(angle))


def _correlation(a: NDArray[Any], b: NDArray[Any], shift: int) -> float:
    """Of a(t) with b(t + shift)."""
    first, second = (a[: len(a) - shift], b[shift:]) if shift >= 0 else (a[-shift:], b[:shift])
    first, second = first - first.mean(), second - second.mean()
    scale = float(np.sqrt(np.vdot(first, first).real * np.vdot(second, second).real))
    return float(np.vdot(first, second).real) / scale if scale > 0.0 else np.nan
