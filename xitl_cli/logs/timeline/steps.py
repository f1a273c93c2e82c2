"""Where the offset of two clocks steps, or its rate bends: told from jitter, bursts of delay and drift."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from xitl_cli.logs.timeline import robust
from xitl_cli.logs.timeline.readings import Readings

Floats = NDArray[np.float64]

SIDE = 8  # readings on each side whose levels are compared
LEAST_STEP_S = 1e-3
LEAST_DELAYED_S = 5e-3  # in one direction a step and a path that takes longer look the same
STRENGTH = 12.0  # of the scatter of such differences: a normal one would do that never, a burst of delays might
MOST_STEPS = 64
LASTING_S, LASTS = 2.0, 0.5
SETTLED = 0.8
ENDS_S = 1.0
BURST_S = 60.0  # a level that came back after less was delay, not the clock
CAME_BACK = 0.3
BENDS = 4
BEND_POINTS = 240
BEND_LEAST = 12
BEST_OF = 6  # of delayed readings the best of so many, as the others tell of the delay
BEND_PPM = 5.0
BEND_GAIN = 3.0
MOST_BEND_PPM = 1000.0  # more is a delay that grows or shrinks, not a clock


@dataclass(frozen=True, slots=True)
class Step:
    """index: of the first reading after it. at_ns: on the log's time. first_ns: on the first clock.

    size_s: by how much the offset grew there; 0 where only the rate changed.
    """

    index: int
    at_ns: int
    first_ns: int
    size_s: float

    def resized(self, size_s: float) -> Step:
        return replace(self, size_s=size_s)


def find_steps(readings: Readings) -> tuple[Step, ...]:
    """Steps and bends in order. Bounded: at most 64 steps and 4 bends in each part between them."""
    if len(readings) < 4:
        return ()
    jumps = _jumps(readings)
    cuts = [0, *(index for index, _ in jumps), len(readings)]
    found = dict(jumps)
    for begin, end in pairwise(cuts):
        for index in _bends(readings[begin:end], BENDS):
            found[begin + index] = 0.0
    return tuple(
        Step(index, int(readings.at_ns[index]), int(readings.first_ns[index]), size_s)
        for index, size_s in sorted(found.items())
    )


def _jumps(readings: Readings) -> list[tuple[int, float]]:
    x = (readings.first_ns - readings.first_ns[0]).astype(np.float64) * 1e-9
    level_ns = readings.level_ns
    y = (level_ns - level_ns[0]).astype(np.float64) * 1e-9
    side = SIDE if len(y) >= 6 * SIDE else 1
    before, after = _sides(readings, y, side)
    between = np.arange(side, len(y) - side + 1)
    dx = x[np.minimum(between + side // 2, len(x) - 1)] - x[np.maximum(between - side // 2 - 1, 0)]
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.where(dx > 0.0, (after - before) / dx, 0.0)
    slope = float(np.median(rates))
    jump = after - before - slope * dx
    least_s = LEAST_DELAYED_S if readings.late and readings.floor_ns is None else LEAST_STEP_S
    least_s = max(least_s, 3.0 * max(readings.resolution_s, readings.slack_s), STRENGTH * robust.spread(jump))
    strong = np.abs(jump - np.median(jump)) > least_s
    found: list[tuple[int, float]] = []
    single = np.diff(y)
    for begin, end in _runs(strong):
        peak = begin + int(np.argmax(np.abs(jump[begin:end])))
        size_s = float(jump[peak])
        first, last = int(between[begin]), int(between[end - 1])
        # At either end of the readings the step may lie beyond the places that have a whole side.
        low = 0 if begin == 0 else max(first - 1, 0)
        high = len(single) if end == len(strong) else last
        index = low + int(np.argmax(single[low:high] * np.sign(size_s))) + 1
        if not first <= index <= last:
            level = np.min if readings.late else np.median
            ahead, behind = y[index : index + side], y[max(index - side, 0) : index]
            size_s = float(level(ahead) - level(behind)) - slope * float(x[index] - x[index - 1])
        if readings.late and size_s > 0.0:  # in stages: what lies between the levels belongs to neither line
            settled = y[low:high] < float(before[max(begin - 1, 0)]) + SETTLED * size_s
            index = max(index, low + int(np.flatnonzero(settled)[-1]) + 1) if settled.any() else index
        if not readings.late or _lasts(readings, x, y, min(first, index), max(last, index), size_s):
            found.append((index, size_s))
    if readings.late or side == 1:
        found = _without_bursts(found, x)
    return sorted(sorted(found, key=lambda one: -abs(one[1]))[:MOST_STEPS])


def _sides(readings: Readings, y: Floats, side: int) -> tuple[Floats, Floats]:
    """Level of the `side` readings before, and after, each place between two: of the least delay, or the median."""
    windows = sliding_window_view(y, side)
    if readings.floor_ns is not None:
        trip = sliding_window_view(readings.offset_ns - readings.floor_ns, side)
        level = windows[np.arange(len(windows)), np.argmin(trip, axis=1)]
    else:
        level = windows.min(axis=1) if readings.late else np.median(windows, axis=1)
    return level[: len(level) - side], level[side:]


def _lasts(readings: Readings, x: Floats, y: Floats, first: int, last: int, size_s: float) -> bool:
    """Whether the level of some seconds shows it too: a queue that fills at once and drains slowly is back by then.

    first, last: between which readings it came; a clock that was held up several times gets there in stages.
    """
    before = slice(min(int(np.searchsorted(x, x[first] - LASTING_S)), max(first - SIDE, 0)), first)
    after = slice(last, max(int(np.searchsorted(x, x[last] + LASTING_S)), last + SIDE))
    if not len(y[before]) or not len(y[after]):
        return False
    if readings.floor_ns is None:
        known_s = min(x[first] - x[0], x[-1] - x[min(last, len(x) - 1)])
        if known_s < ENDS_S:  # a burst of delay that began or ended out of sight
            return False
        shown_s = float(y[after].min() - y[before].min())
        return shown_s * size_s > 0.0 and abs(shown_s) > LASTS * abs(size_s)
    # No offset is possible on both sides at once.
    ceiling_ns, floor_ns = readings.offset_ns, readings.floor_ns
    earlier, later = (before, after) if size_s > 0.0 else (after, before)
    return bool(floor_ns[later].max() > ceiling_ns[earlier].min())


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _without_bursts(found: list[tuple[int, float]], x: Floats) -> list[tuple[int, float]]:
    """Without pairs that undo each other soon after."""
    kept: list[tuple[int, float]] = []
    for index, size_s in found:
        if kept:
            last, last_s = kept[-1]
            soon = x[min(index, len(x) - 1)] - x[last] < BURST_S
            if soon and last_s * size_s < 0.0 and abs(size_s + last_s) < CAME_BACK * abs(last_s):
                kept.pop()
                continue
        kept.append((index, size_s))
    return kept


def _bends(readings: Readings, most: int) -> list[int]:
    """Where two lines describe what one does not, by index; each half is looked at again."""
    if most == 0 or len(readings) < 2 * BEND_LEAST:
        return []
    points = len(readings) // BEST_OF if readings.late else len(readings)
    thin = readings.thinned(min(max(points, 2 * BEND_LEAST), BEND_POINTS))
    x = (thin.first_ns - thin.first_ns[0]).astype(np.float64) * 1e-9
    level_ns = thin.level_ns
    y = (level_ns - level_ns[0]).astype(np.float64) * 1e-9
    one = _squares(x, y)[-1]
    ahead, behind = _squares(x, y), _squares(x[::-1], y[::-1])[::-1]
    cut = np.arange(BEND_LEAST, len(x) - BEND_LEAST + 1)
    if not len(cut):
        return []
    both = ahead[cut - 1] + behind[cut]
    best = int(cut[np.argmin(both)])
    two = float(both.min())
    (low, low_error), (high, high_error) = _rate(x[:best], y[:best]), _rate(x[best:], y[best:])
    change = abs(high - low)
    known = change * 1e6 < MOST_BEND_PPM and change > 10.0 * np.hypot(low_error, high_error) and change * 1e6 > BEND_PPM
    grain_s = max(thin.resolution_s / 3.0, 1e-9)
    if not known or one < BEND_GAIN * two or one < len(x) * grain_s**2:
        return []
    index = int(np.searchsorted(readings.first_ns, thin.first_ns[best]))
    left = _bends(readings[:index], most - 1)
    right = _bends(readings[index:], most - 1)
    return [*left, index, *(index + one for one in right)]


def _squares(x: Floats, y: Floats) -> Floats:
    """Sum of the squared errors of the line through the first n points, for every n."""
    n = np.arange(1, len(x) + 1)
    x = x - x[0]
    y = y - y[0]
    sx, sy, sxx, sxy, syy = (np.cumsum(value) for value in (x, y, x * x, x * y, y * y))
    vxx, vxy, vyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.maximum(np.where(vxx > 0.0, vyy - vxy * vxy / vxx, vyy), 0.0)


def _rate(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope by least squares and its standard error for independent errors."""
    away = x - x.mean()
    square = float(np.sum(away * away))
    if square <= 0.0:
        return 0.0, np.inf
    slope = float(np.sum(away * y)) / square
    error = y - y.mean() - slope * away
    return slope, float(np.sqrt(np.sum(error * error) / max(len(x) - 2, 1) / square))
