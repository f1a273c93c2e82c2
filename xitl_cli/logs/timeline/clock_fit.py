"""One clock against another: straight lines between steps, and how the rate varies.

The offset (second less first) of each pair is cut where it steps; each piece gets a line by what kind of readings they
are. The standard error of a rate is from the fits with a tenth of the time left out each (jackknife), so errors that
last shorter than a tenth of the piece need not be independent.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from agent.timing.sync import ClockSync
from xitl_cli.logs.timeline import one_way, robust
from xitl_cli.logs.timeline.readings import Readings
from xitl_cli.logs.timeline.steps import Step, find_steps

Floats = NDArray[np.float64]

MOST_READINGS = 4000  # of a fit; more are thinned to the best of each group
EXCHANGES = 300
BLOCKS = 10
LEAST = 3
WINDOWS = 12
WINDOW_S = (10.0, 120.0)
IN_WINDOW = 8
MAX_DRIFT_PPM = 20_000.0
FARTHEST_NS = 1 << 61  # 73 years: what is beyond is no instant, and sums of two stay within 64 bits


@dataclass(frozen=True, slots=True)
class Piece:
    """One line. from_ns, until_ns, about_ns: of the first clock. offset_ns: second less first at `about_ns`.

    slope_ppm: growth of the offset. slope_error_ppm: its standard error, None where there are too few readings.
    offset_error_s: of the offset in the middle, one standard deviation, without what a constant delay hides.
    residual_s: standard deviation of the readings about the line.
    """

    from_ns: int
    until_ns: int
    about_ns: int
    offset_ns: int
    slope_ppm: float
    slope_error_ppm: float | None
    offset_error_s: float
    residual_s: float
    readings: int

    def offset_at(self, first_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """(N,) second less first, in whole nanoseconds."""
        grown = self.slope_ppm * 1e-6 * (first_ns - self.about_ns).astype(np.float64)
        return self.offset_ns + np.round(np.clip(grown, -FARTHEST_NS, FARTHEST_NS)).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Relation:
    """pieces in order, with the steps between them. residual_s: (N,) of every reading about its piece.

    window_ns: (W,) centres, of the first clock, of windows of `window_s`; window_ppm: (W,) the rate in each by itself.
    """

    readings: Readings
    pieces: tuple[Piece, ...]
    steps: tuple[Step, ...]
    residual_s: Floats
    window_s: float
    window_ns: NDArray[np.int64]
    window_ppm: Floats

    @property
    def longest(self) -> Piece:
        return max(self.pieces, key=lambda piece: piece.until_ns - piece.from_ns)

    @property
    def second_bounds_ns(self) -> tuple[int, ...]:
        """Where the second clock passes from each piece to the next: midway in what it leapt over."""
        bounds = []
        for before, after in pairwise(self.pieces):
            at_ns = np.array([after.from_ns], dtype=np.int64)
            ends, begins = (after.from_ns + int(piece.offset_at(at_ns)[0]) for piece in (before, after))
            bounds.append(begins - max(begins - ends, 0) // 2)
        return tuple(bounds)

    def to_second(self, first_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """(N,) the second clock where the first shows these; before and after the readings by the nearest line."""
        bounds = np.array([piece.from_ns for piece in self.pieces[1:]], dtype=np.int64)
        which = np.searchsorted(bounds, first_ns, side="right")
        result = np.empty(len(first_ns), dtype=np.int64)
        for index, piece in enumerate(self.pieces):
            mine = which == index
            result[mine] = first_ns[mine] + piece.offset_at(first_ns[mine])
        return result

    def to_first(self, second_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """(N,) the first clock where the second shows these; what a step back shows twice, by the later piece."""
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


def relate(readings: Readings) -> Relation | None:
    """None with fewer than three readings, or when the first clock stands still."""
    readings = readings.within(FARTHEST_NS).in_order()
    if len(readings) < LEAST or readings.first_ns[-1] <= readings.first_ns[0]:
        return None
    steps = find_steps(readings)
    cuts = [0, *(step.index for step in steps), len(readings)]
    pieces: list[Piece] = []
    residual_s = np.zeros(len(readings))
    for begin, end in pairwise(cuts):
        part = readings[begin:end]
        piece = _piece(part)
        pieces.append(piece)
        residual_s[begin:end] = (part.offset_ns - piece.offset_at(part.first_ns)).astype(np.float64) * 1e-9
    window_s, window_ns, window_ppm = _windows(readings, cuts)
    placed = tuple(_with_size(step, pieces[i], pieces[i + 1]) for i, step in enumerate(steps))
    return Relation(readings, tuple(pieces), placed, residual_s, window_s, window_ns, window_ppm)


def _with_size(step: Step, before: Piece, after: Piece) -> Step:
    """The size as the lines on both sides tell it, where they are lines: it errs less than single readings."""
    if min(before.readings, after.readings) < 2 * IN_WINDOW:
        return step
    at = np.array([after.from_ns], dtype=np.int64)
    size_s = float(after.offset_at(at)[0] - before.offset_at(at)[0]) * 1e-9
    return step if abs(size_s - step.size_s) > 0.2 * abs(step.size_s) else step.resized(size_s)


def _piece(readings: Readings) -> Piece:
    first_ns = readings.first_ns
    about_ns = int(first_ns[0]) + (int(first_ns[-1]) - int(first_ns[0])) // 2
    base_ns = int(readings.offset_ns[0])
    thin = readings.thinned(EXCHANGES if readings.floor_ns is not None else MOST_READINGS)
    span_s = float(first_ns[-1] - first_ns[0]) * 1e-9
    slope, value_s = _fit(thin, about_ns, base_ns) if len(thin) >= 2 and span_s > 0.0 else (0.0, 0.0)
    error_ppm, offset_error_s = _jackknife(thin, about_ns, base_ns)
    offset_ns = base_ns + round(float(np.clip(value_s * 1e9, -FARTHEST_NS, FARTHEST_NS)))
    piece = Piece(
        int(first_ns[0]), int(first_ns[-1]), about_ns, offset_ns, slope * 1e6, error_ppm, 0.0, 0.0, len(readings)
    )
    away_s = (readings.offset_ns - piece.offset_at(first_ns)).astype(np.float64) * 1e-9
    residual_s = robust.spread(away_s) if readings.late else float(np.std(away_s))
    if offset_error_s is None:
        offset_error_s = float(np.max(np.abs(away_s)))
    return Piece(
        piece.from_ns,
        piece.until_ns,
        about_ns,
        offset_ns,
        piece.slope_ppm,
        error_ppm,
        max(offset_error_s, readings.resolution_s / np.sqrt(12.0)),
        residual_s,
        len(readings),
    )


def _fit(readings: Readings, about_ns: int, base_ns: int) -> tuple[float, float]:
    """Slope (1) and offset (s, above `base_ns`) at `about_ns`."""
    x = (readings.first_ns - about_ns).astype(np.float64) * 1e-9
    y = (readings.offset_ns - base_ns).astype(np.float64) * 1e-9
    if readings.floor_ns is not None:
        return _fit_exchanges(readings, readings.floor_ns, about_ns, base_ns)
    return one_way.lower_line(x, y) if readings.late else robust.line(x, y)


def _fit_exchanges(readings: Readings, floor_ns: NDArray[np.int64], about_ns: int, base_ns: int) -> tuple[float, float]:
    """By the estimator that the agent itself uses. An exchange is as if answered at once."""
    sync = ClockSync(MAX_DRIFT_PPM)
    for first_ns, ceiling_ns, least_ns in zip(
        (readings.first_ns - about_ns).tolist(),
        (readings.offset_ns - base_ns).tolist(),
        (floor_ns - base_ns).tolist(),
        strict=True,
    ):
        back_ns = first_ns + ceiling_ns - least_ns
        sync.add(first_ns, first_ns + ceiling_ns, first_ns + ceiling_ns, back_ns)
    if not sync.ready:
        return 0.0, 0.0
    estimate = sync.estimate
    return estimate.drift_ppm * 1e-6, (sync.to_remote(0)) * 1e-9


def _jackknife(readings: Readings, about_ns: int, base_ns: int) -> tuple[float | None, float | None]:
    """Standard errors of the rate (ppm) and of the offset in the middle (s)."""
    if len(readings) < 2 * BLOCKS:
        return None, None
    block = np.arange(len(readings)) * BLOCKS // len(readings)
    fits = [_fit(readings[block != left_out], about_ns, base_ns) for left_out in range(BLOCKS)]
    slopes, values = np.array(fits).T
    factor = (BLOCKS - 1) / BLOCKS
    error_ppm = float(np.sqrt(factor * np.sum((slopes - slopes.mean()) ** 2)) * 1e6)
    span_s = float(readings.first_ns[-1] - readings.first_ns[0]) * 1e-9
    rounding_ppm = 1e6 * readings.resolution_s / np.sqrt(6.0) / max(span_s, 1e-9)  # of both ends, each evenly spread
    return max(error_ppm, float(rounding_ppm)), float(np.sqrt(factor * np.sum((values - values.mean()) ** 2)))


def _windows(readings: Readings, cuts: list[int]) -> tuple[float, NDArray[np.int64], Floats]:
    """The rate in windows that no step falls into."""
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
    return window_s, np.array(centres, dtype=np.int64), np.array(rates)
