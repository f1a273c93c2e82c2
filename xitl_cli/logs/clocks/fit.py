"""Fit of one clock against another: straight lines between steps, and the variation of the rate.

The series of offsets (second clock minus first clock) is cut at its steps. Each piece gets a line, by a method for its
kind of readings. The standard error of a rate is a jackknife: one fit for each tenth of the time left out. Thus errors
that are correlated over less than a tenth of the piece need not be independent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from agent.timing.sync import ClockSync
from xitl_cli.logs.clocks.readings import ClockReadings, clock_readings
from xitl_cli.logs.clocks.time_line import AlignedLog
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals.spans import runs

ROUNDS = 30
HUBER = 1.345  # in units of the scale: 95 % as efficient as least squares if all errors are normal
TO_SIGMA = 1.4826  # factor of the median absolute deviation of a normal distribution


def robust_spread(values: Floats) -> float:
    """Standard deviation estimated from the median absolute deviation. Up to half of the values may be outliers."""
    return float(TO_SIGMA * np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def robust_line(x: Floats, y: Floats) -> tuple[float, float]:
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
        scale = robust_spread(error)
        if scale <= 0.0 or before == (slope, value):
            break
        weight = HUBER * scale / np.maximum(np.abs(error), HUBER * scale)
    return slope, value


def lower_hull(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Vertices of the lower convex hull (Andrew's monotone chain). x increases; of equal x, the lowest point counts."""
    order = np.lexsort((y, x))
    xs, ys = x[order], y[order]
    first = np.ones(len(xs), dtype=np.bool_)
    first[1:] = xs[1:] != xs[:-1]
    hull: list[tuple[float, float]] = []
    for px, py in zip(xs[first].tolist(), ys[first].tolist(), strict=True):
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (x1 - x0) * (py - y0) > (y1 - y0) * (px - x0):
                break
            hull.pop()
        hull.append((px, py))
    points = np.array(hull, dtype=np.float64).reshape(-1, 2)
    return points[:, 0], points[:, 1]


def lower_line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope, and value at x = 0, of the line below all points with the least sum of distances to them.

    This is the linear programme of Moon, Skelly and Towsley (INFOCOM 1999). Its solution is the edge of the lower hull
    above the mean of x.
    """
    hull_x, hull_y = lower_hull(x, y)
    if len(hull_x) < 2:
        return 0.0, float(hull_y[0])
    edge = int(np.clip(np.searchsorted(hull_x, np.mean(x)) - 1, 0, len(hull_x) - 2))
    slope = float((hull_y[edge + 1] - hull_y[edge]) / (hull_x[edge + 1] - hull_x[edge]))
    return slope, float(hull_y[edge] - slope * hull_x[edge])


SIDE = 8  # readings on each side whose levels are compared
LEAST_STEP_S = 1e-3
LEAST_DELAYED_S = 5e-3  # in one direction, a step and a longer path look the same
STRENGTH = 12.0  # times the scatter of such differences: normal noise never reaches it, a burst of delays might
MOST_STEPS = 64
LASTING_S, LASTS = 2.0, 0.5
SETTLED = 0.8
ENDS_S = 1.0
BURST_S = 60.0  # a level that returns sooner was a delay, not the clock
CAME_BACK = 0.3
BENDS = 4
BEND_POINTS = 240
BEND_LEAST = 12
BEST_OF = 6  # readings per group; of each group, the least delayed is used, because the others measure the delay
BEND_PPM = 5.0
BEND_GAIN = 3.0
MOST_BEND_PPM = 1000.0  # above it, the change is a growing or shrinking delay, not a clock


@dataclass(frozen=True, slots=True)
class ClockStep:
    """A step of the offset between two clocks, or a bend."""

    index: int
    """First reading after the step."""
    at_ns: int
    """On the log's time."""
    first_ns: int
    """On the first clock."""
    size_s: float
    """Growth of the offset; 0 if only the rate changed."""


def find_steps(readings: ClockReadings) -> tuple[ClockStep, ...]:
    """Find steps and bends, in order: at most 64 steps, and at most 4 bends in each part between them."""
    if len(readings) < 4:
        return ()
    jumps = _jumps(readings)
    cuts = [0, *(index for index, _ in jumps), len(readings)]
    sizes_s = dict(jumps)
    for begin, end in pairwise(cuts):
        for index in _bends(readings[begin:end], BENDS):
            sizes_s[begin + index] = 0.0
    return tuple(
        ClockStep(index, int(readings.at_ns[index]), int(readings.first_ns[index]), size_s)
        for index, size_s in sorted(sizes_s.items())
    )


def _jumps(readings: ClockReadings) -> list[tuple[int, float]]:
    x = (readings.first_ns - readings.first_ns[0]).astype(np.float64) * 1e-9
    level_ns = readings.level_ns
    y = (level_ns - level_ns[0]).astype(np.float64) * 1e-9
    side = SIDE if len(y) >= 6 * SIDE else 1
    # Level of the `side` readings before and after each gap: the reading of least delay, or the median.
    windows = sliding_window_view(y, side)
    if readings.floor_ns is not None:
        trip = sliding_window_view(readings.offset_ns - readings.floor_ns, side)
        level = windows[np.arange(len(windows)), np.argmin(trip, axis=1)]
    else:
        level = windows.min(axis=1) if readings.late else np.median(windows, axis=1)
    before, after = level[: len(level) - side], level[side:]
    between = np.arange(side, len(y) - side + 1)
    dx = x[np.minimum(between + side // 2, len(x) - 1)] - x[np.maximum(between - side // 2 - 1, 0)]
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.where(dx > 0.0, (after - before) / dx, 0.0)
    slope = float(np.median(rates))
    jump = after - before - slope * dx
    least_s = LEAST_DELAYED_S if readings.late and readings.floor_ns is None else LEAST_STEP_S
    least_s = max(least_s, 3.0 * max(readings.resolution_s, readings.slack_s), STRENGTH * robust_spread(jump))
    strong = np.abs(jump - np.median(jump)) > least_s
    jumps: list[tuple[int, float]] = []
    single = np.diff(y)
    for begin, end in runs(strong):
        peak = begin + int(np.argmax(np.abs(jump[begin:end])))
        size_s = float(jump[peak])
        first, last = int(between[begin]), int(between[end - 1])
        # At either end of the readings, the step may lie beyond the places with a full side.
        low = 0 if begin == 0 else max(first - 1, 0)
        high = len(single) if end == len(strong) else last
        index = low + int(np.argmax(single[low:high] * np.sign(size_s))) + 1
        if not first <= index <= last:
            level = np.min if readings.late else np.median
            ahead, behind = y[index : index + side], y[max(index - side, 0) : index]
            size_s = float(level(ahead) - level(behind)) - slope * float(x[index] - x[index - 1])
        if readings.late and size_s > 0.0:  # the step has stages; readings between the levels belong to neither line
            settled = y[low:high] < float(before[max(begin - 1, 0)]) + SETTLED * size_s
            index = max(index, low + int(np.flatnonzero(settled)[-1]) + 1) if settled.any() else index
        if not readings.late or _lasts(readings, x, y, min(first, index), max(last, index), size_s):
            jumps.append((index, size_s))
    if readings.late or side == 1:
        jumps = _without_bursts(jumps, x)
    return sorted(sorted(jumps, key=lambda jump: -abs(jump[1]))[:MOST_STEPS])


def _lasts(readings: ClockReadings, x: Floats, y: Floats, first: int, last: int, size_s: float) -> bool:
    """Whether the level over some seconds also shows the step.

    A queue that fills at once and drains slowly has returned to its level by then.

    first, last: readings between which the step occurred. A clock that was held up several times steps in stages.
    """
    before = slice(min(int(np.searchsorted(x, x[first] - LASTING_S)), max(first - SIDE, 0)), first)
    after = slice(last, max(int(np.searchsorted(x, x[last] + LASTING_S)), last + SIDE))
    if not len(y[before]) or not len(y[after]):
        return False
    if readings.floor_ns is None:
        known_s = min(x[first] - x[0], x[-1] - x[min(last, len(x) - 1)])
        if known_s < ENDS_S:  # a burst of delay that began or ended outside the readings
            return False
        shown_s = float(y[after].min() - y[before].min())
        return shown_s * size_s > 0.0 and abs(shown_s) > LASTS * abs(size_s)
    # No offset satisfies the bounds of both sides at once.
    ceiling_ns, floor_ns = readings.offset_ns, readings.floor_ns
    earlier, later = (before, after) if size_s > 0.0 else (after, before)
    return bool(floor_ns[later].max() > ceiling_ns[earlier].min())


def _without_bursts(jumps: list[tuple[int, float]], x: Floats) -> list[tuple[int, float]]:
    """The steps without pairs that cancel each other within a short time."""
    lasting: list[tuple[int, float]] = []
    for index, size_s in jumps:
        if lasting:
            last, last_s = lasting[-1]
            soon = x[min(index, len(x) - 1)] - x[last] < BURST_S
            if soon and last_s * size_s < 0.0 and abs(size_s + last_s) < CAME_BACK * abs(last_s):
                lasting.pop()
                continue
        lasting.append((index, size_s))
    return lasting


def _bends(readings: ClockReadings, most: int) -> list[int]:
    """Readings at which two lines fit better than one, by index. Each half is searched again."""
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
    return [*left, index, *(index + bend for bend in right)]


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


MOST_READINGS = 4000  # of a fit; more are thinned to the best of each group
EXCHANGES = 300
BLOCKS = 10
LEAST = 3
WINDOWS = 12
WINDOW_S = (10.0, 120.0)
IN_WINDOW = 8
MAX_DRIFT_PPM = 20_000.0
FARTHEST_NS = 1 << 61  # 73 years: a larger value is no instant, and sums of two values fit in 64 bits


@dataclass(frozen=True, slots=True)
class FitPiece:
    """One line of a fit."""

    from_ns: int
    """On the first clock."""
    until_ns: int
    """On the first clock."""
    about_ns: int
    """On the first clock."""
    offset_ns: int
    """Second clock minus first clock at `about_ns`."""
    slope_ppm: float
    """Growth of the offset."""
    slope_error_ppm: float | None
    """Standard error of the slope; None with too few readings."""
    offset_error_s: float
    """Standard deviation of the offset in the middle, without the error that a constant delay hides."""
    residual_s: float
    """Standard deviation of the readings about the line."""
    readings: int

    def offset_at(self, first_ns: Stamps) -> Stamps:
        """(N,) second clock minus first clock, in whole nanoseconds."""
        grown = self.slope_ppm * 1e-6 * (first_ns - self.about_ns).astype(np.float64)
        return self.offset_ns + np.round(np.clip(grown, -FARTHEST_NS, FARTHEST_NS)).astype(np.int64)


@dataclass(frozen=True, slots=True)
class ClockRelation:
    """Fit of two clocks."""

    readings: ClockReadings
    pieces: tuple[FitPiece, ...]
    """In order of time."""
    steps: tuple[ClockStep, ...]
    """The steps between the pieces."""
    residual_s: Floats
    """(N,) of every reading about its piece."""
    window_s: float
    """Length of the windows of the rate."""
    window_ns: Stamps
    """(W,) centres of the windows, on the first clock."""
    window_ppm: Floats
    """(W,) rate in each window alone."""

    @property
    def longest(self) -> FitPiece:
        return max(self.pieces, key=lambda piece: piece.until_ns - piece.from_ns)

    @property
    def second_bounds_ns(self) -> tuple[int, ...]:
        """Readings of the second clock at the boundary between pieces: the middle of the interval that it jumped
        over."""
        bounds = []
        for before, after in pairwise(self.pieces):
            at_ns = np.array([after.from_ns], dtype=np.int64)
            ends, begins = (after.from_ns + int(piece.offset_at(at_ns)[0]) for piece in (before, after))
            bounds.append(begins - max(begins - ends, 0) // 2)
        return tuple(bounds)

    def to_second(self, first_ns: Stamps) -> Stamps:
        """(N,) second clock at these readings of the first; the nearest line applies before and after the readings."""
        bounds = np.array([piece.from_ns for piece in self.pieces[1:]], dtype=np.int64)
        which = np.searchsorted(bounds, first_ns, side="right")
        result = np.empty(len(first_ns), dtype=np.int64)
        for index, piece in enumerate(self.pieces):
            mine = which == index
            result[mine] = first_ns[mine] + piece.offset_at(first_ns[mine])
        return result

    def to_first(self, second_ns: Stamps) -> Stamps:
        """(N,) first clock at these readings of the second. A reading that a step back repeats belongs to the later
        piece."""
        which = np.zeros(len(second_ns), dtype=np.intp)
        for index, bound in enumerate(self.second_bounds_ns):
            which[second_ns >= bound] = index + 1
        result = np.empty(len(second_ns), dtype=np.int64)
        for index, piece in enumerate(self.pieces):
            mine = which == index
            guess = second_ns[mine] - piece.offset_ns
            for _ in range(3):
                guess = second_ns[mine] - piece.offset_at(guess)
            result[mine] = guess
        return result


def fit_relation(readings: ClockReadings) -> ClockRelation | None:
    """Fit two clocks. Return None with fewer than three readings, or if the first clock does not advance."""
    readings = readings.within(FARTHEST_NS).in_order()
    if len(readings) < LEAST or readings.first_ns[-1] <= readings.first_ns[0]:
        return None
    steps = find_steps(readings)
    cuts = [0, *(step.index for step in steps), len(readings)]
    pieces: list[FitPiece] = []
    residual_s = np.zeros(len(readings))
    for begin, end in pairwise(cuts):
        part = readings[begin:end]
        piece = _piece(part)
        pieces.append(piece)
        residual_s[begin:end] = (part.offset_ns - piece.offset_at(part.first_ns)).astype(np.float64) * 1e-9
    # The rate in windows that contain no step
    span_s = float(readings.first_ns[-1] - readings.first_ns[0]) * 1e-9
    window_s = float(np.clip(span_s / WINDOWS, *WINDOW_S))
    centres: list[int] = []
    rates: list[float] = []
    for begin, end in pairwise(cuts):
        part = readings[begin:end]
        which = ((part.first_ns - part.first_ns[0]) // round(window_s * 1e9)).astype(np.int64)
        for number in np.unique(which):
            inside = part[which == number]
            covered_s = float(inside.first_ns[-1] - inside.first_ns[0]) * 1e-9
            if len(inside) < IN_WINDOW or covered_s < 0.7 * window_s:
                continue
            about_ns = int(inside.first_ns[0]) + round(covered_s * 5e8)
            slope, _ = _fit(inside.thinned(EXCHANGES), about_ns, int(inside.offset_ns[0]))
            centres.append(about_ns)
            rates.append(slope * 1e6)
    window_ns, window_ppm = np.array(centres, dtype=np.int64), np.array(rates)
    # The lines on both sides give the size of a step better than single readings, if they have enough readings.
    sized: list[ClockStep] = []
    for step, (before, after) in zip(steps, pairwise(pieces), strict=True):
        at = np.array([after.from_ns], dtype=np.int64)
        size_s = float(after.offset_at(at)[0] - before.offset_at(at)[0]) * 1e-9
        enough = min(before.readings, after.readings) >= 2 * IN_WINDOW
        similar = abs(size_s - step.size_s) <= 0.2 * abs(step.size_s)
        sized.append(replace(step, size_s=size_s) if enough and similar else step)
    return ClockRelation(readings, tuple(pieces), tuple(sized), residual_s, window_s, window_ns, window_ppm)


def _piece(readings: ClockReadings) -> FitPiece:
    first_ns = readings.first_ns
    about_ns = int(first_ns[0]) + (int(first_ns[-1]) - int(first_ns[0])) // 2
    base_ns = int(readings.offset_ns[0])
    thin = readings.thinned(EXCHANGES if readings.floor_ns is not None else MOST_READINGS)
    span_s = float(first_ns[-1] - first_ns[0]) * 1e-9
    slope, value_s = _fit(thin, about_ns, base_ns) if len(thin) >= 2 and span_s > 0.0 else (0.0, 0.0)
    error_ppm, offset_error_s = _jackknife(thin, about_ns, base_ns)
    offset_ns = base_ns + round(float(np.clip(value_s * 1e9, -FARTHEST_NS, FARTHEST_NS)))
    piece = FitPiece(
        int(first_ns[0]), int(first_ns[-1]), about_ns, offset_ns, slope * 1e6, error_ppm, 0.0, 0.0, len(readings)
    )
    away_s = (readings.offset_ns - piece.offset_at(first_ns)).astype(np.float64) * 1e-9
    residual_s = robust_spread(away_s) if readings.late else float(np.std(away_s))
    if offset_error_s is None:
        offset_error_s = float(np.max(np.abs(away_s)))
    offset_error_s = max(offset_error_s, readings.resolution_s / np.sqrt(12.0))
    return replace(piece, offset_error_s=offset_error_s, residual_s=residual_s)


def _fit(readings: ClockReadings, about_ns: int, base_ns: int) -> tuple[float, float]:
    """Slope (1) and offset (s, above `base_ns`) at `about_ns`."""
    x = (readings.first_ns - about_ns).astype(np.float64) * 1e-9
    y = (readings.offset_ns - base_ns).astype(np.float64) * 1e-9
    if readings.floor_ns is not None:
        # Fit by the estimator that the agent uses. An exchange counts as answered at once.
        sync = ClockSync(MAX_DRIFT_PPM)
        for first_ns, ceiling_ns, least_ns in zip(
            (readings.first_ns - about_ns).tolist(),
            (readings.offset_ns - base_ns).tolist(),
            (readings.floor_ns - base_ns).tolist(),
            strict=True,
        ):
            back_ns = first_ns + ceiling_ns - least_ns
            sync.add(first_ns, first_ns + ceiling_ns, first_ns + ceiling_ns, back_ns)
        if not sync.ready:
            return 0.0, 0.0
        estimate = sync.estimate
        return estimate.drift_ppm * 1e-6, (sync.to_remote(0)) * 1e-9
    return lower_line(x, y) if readings.late else robust_line(x, y)


def _jackknife(readings: ClockReadings, about_ns: int, base_ns: int) -> tuple[float | None, float | None]:
    """Standard errors of the rate (ppm) and of the offset in the middle (s)."""
    if len(readings) < 2 * BLOCKS:
        return None, None
    block = np.arange(len(readings)) * BLOCKS // len(readings)
    fits = [_fit(readings[block != left_out], about_ns, base_ns) for left_out in range(BLOCKS)]
    slopes, values = np.array(fits).T
    factor = (BLOCKS - 1) / BLOCKS
    error_ppm = float(np.sqrt(factor * np.sum((slopes - slopes.mean()) ** 2)) * 1e6)
    span_s = float(readings.first_ns[-1] - readings.first_ns[0]) * 1e-9
    rounding_ppm = 1e6 * readings.resolution_s / np.sqrt(6.0) / max(span_s, 1e-9)  # of both ends, each uniform
    return max(error_ppm, float(rounding_ppm)), float(np.sqrt(factor * np.sum((values - values.mean()) ** 2)))


_known: WeakKeyDictionary[Log, tuple[ClockRelation, ...]] = WeakKeyDictionary()


def clock_relations(log: Log) -> tuple[ClockRelation, ...]:
    """Fit every pair of clocks that has enough readings. The result is cached as long as the log exists."""
    if isinstance(log, AlignedLog):  # the same rows and stamps
        log = log.inner
    if log not in _known:
        fits = map(fit_relation, clock_readings(log))
        _known[log] = tuple(relation for relation in fits if relation is not None)
    return _known[log]
