"""Relation of another machine's clock to this one, from four-timestamp exchanges over a link with jitter.

In an exchange, t2 - t1 is the offset plus the delay there, and t3 - t4 is the offset minus the delay back. Delays have
a floor and accumulate above it, so the truth is at the edges. One line is below all t2 - t1, the other above all t3 -
t4 (the linear programme of Moon, Skelly and Towsley, INFOCOM 1999). Both lines have the same drift, and each drift
leaves a gap between them.

If delays decrease exponentially from their floor, the widest gap is the likeliest drift. The estimate is the mean of
all drifts, weighted by that likelihood with the observed density of delays at the floor. It has a smaller error than
the likeliest drift. It makes no assumption about longer delays: outliers, bursts and heavy tails have no weight. Only
the vertices of two convex hulls matter, so the computation is exact and cheap.

With n samples the edges converge as 1/n, whereas averages converge as 1/sqrt(n). The offset is half way between the
lines. No exchange can observe the asymmetry of the two floors. It shifts the offset by half of the difference, at most
by half of the smallest round trip. Delays without a floor (a Gaussian distribution) converge more slowly.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, isfinite, sqrt

HISTORY = 600
FIT_EVERY = 10  # samples between fits of a long history; a fit of 600 takes some 0.5 ms
PENDING = 10
DENSITY_SHARE = 20  # the lowest 1/20 of the delays define the density at the floor
VIOLATIONS = 3
SMALLEST_STEP_NS = 200_000.0
SETTLING_NS = 3e9  # shorter spans have little information on drift, which is then drawn to zero

Point = tuple[float, float]


@dataclass(frozen=True)
class SyncEstimate:
    """Remote clock against local clock at the newest sample."""

    offset_ns: int
    """Remote minus local."""
    drift_ppm: float
    """Growth of the offset."""
    drift_error_ppm: float
    """Standard error of `drift_ppm`."""
    path_delay_ns: int
    """One way, half of the smallest round trip."""
    asymmetry_bound_ns: int
    """Largest shift of the offset by unequal floors of the two ways and an uneven clock."""
    residual_ns: float
    """RMS of the single exchanges about the line, a measure of the jitter."""
    used: int
    """Number of samples in the estimate."""
    refused: int
    """Number of impossible exchanges."""
    outliers: int
    """Number of exchanges that contradict the others."""
    steps: int
    """Number of times that the relation changed and was estimated anew."""


@dataclass(frozen=True)
class _Sample:
    sent_ns: float  # local, since the first sample
    returned_ns: float
    there_ns: float  # t2 - t1 and t3 - t4, minus the first sample's offset
    back_ns: float


class ClockSync:
    """Estimates the relation of two clocks from exchanges. Memory and time per sample are bounded.

    A clock that steps contradicts the lines: the offset would need negative delays. `VIOLATIONS` such samples among
    `PENDING` ones start a new history. Fewer are outliers and dropped.

    uneven_ns: amount by which the remote clock may fall behind and catch up again, which is not a step. The observed
    part of it increases the bound of the offset.
    """

    def __init__(self, max_drift_ppm: float = 500.0, uneven_ns: float = 0.0) -> None:
        if not max_drift_ppm > 0.0:
            raise ValueError(f"clock sync: max_drift_ppm = {max_drift_ppm} leaves no drift; use a number above 0")
        self._max_slope = max_drift_ppm * 1e-6
        self._uneven_ns = uneven_ns
        self._history: deque[_Sample] = deque(maxlen=HISTORY)
        self._pending: list[tuple[_Sample, bool]] = []
        self._local_zero_ns = self._offset_zero_ns = 0
        self._slope_error = self._max_slope
        self._slope = self._upper_ns = self._lower_ns = self._residual_ns = 0.0
        self._newest_ns = 0.0
        self._since_fit = 0
        self._smallest_trip_ns = 0.0
        self._refused = self._outliers = self._steps = 0

    @property
    def ready(self) -> bool:
        """Whether there is an estimate."""
        return bool(self._history)

    @property
    def doubtful(self) -> bool:
        """Whether the newest exchanges contradict the relation, so that it may soon be estimated anew."""
        return bool(self._pending)

    def add(self, t1_ns: int, t2_ns: int, t3_ns: int, t4_ns: int) -> bool:
        """Add an exchange: sent (local), arrived (remote), answered (remote), returned (local).

        Return False when it was refused.
        """
        if t4_ns < t1_ns or t3_ns < t2_ns or t4_ns - t1_ns < t3_ns - t2_ns:
            self._refused += 1
            return False
        if not self._history:
            self._local_zero_ns, self._offset_zero_ns = t1_ns, t2_ns - t1_ns
        zero, offset = self._local_zero_ns, self._offset_zero_ns
        sample = _Sample(
            float(t1_ns - zero), float(t4_ns - zero), float(t2_ns - t1_ns - offset), float(t3_ns - t4_ns - offset)
        )
        self._newest_ns = max(self._newest_ns, sample.returned_ns)
        below_ns = self._upper_ns + self._slope * sample.sent_ns - sample.there_ns
        above_ns = sample.back_ns - self._lower_ns - self._slope * sample.returned_ns
        tolerance_ns = max(SMALLEST_STEP_NS, self._residual_ns, self._uneven_ns)
        violates = len(self._history) >= 2 * PENDING and max(below_ns, above_ns) > tolerance_ns
        if not violates and not self._pending:
            self._history.append(sample)
            self._since_fit += 1
            if self._since_fit >= FIT_EVERY or len(self._history) < FIT_EVERY * 6:
                self._fit()
            return True
        self._pending.append((sample, violates))
        if sum(bad for _, bad in self._pending) >= VIOLATIONS:
            self._steps += 1
            self._history.clear()
            self._resolve_pending(keep_violating=True)
        elif len(self._pending) >= PENDING:
            self._resolve_pending(keep_violating=False)
        return True

    def _resolve_pending(self, keep_violating: bool) -> None:
        for sample, violates in self._pending:
            if keep_violating or not violates:
                self._history.append(sample)
            else:
                self._outliers += 1
        self._pending.clear()
        self._fit()

    def _fit(self) -> None:
        samples = self._history
        self._since_fit = 0
        there = _lower_hull([(s.sent_ns, s.there_ns) for s in samples])
        back = _lower_hull([(s.returned_ns, -s.back_ns) for s in samples])
        span_ns = samples[-1].sent_ns - samples[0].sent_ns
        lines = _lines(there, back, self._max_slope)
        likeliest = max(lines, key=_Line.at_start).start
        excess_ns = sorted(_excesses(samples, likeliest))
        rank = max(len(excess_ns) // DENSITY_SHARE, 1)
        seen, error = _weighted_slope(lines, likeliest, rank / (2.0 * max(excess_ns[rank], 1.0)))
        settled = span_ns**4 / (span_ns**4 + SETTLING_NS**4)
        self._slope = slope = seen * settled
        self._slope_error = error * settled + abs(seen) * (1.0 - settled)
        self._upper_ns = min(y - slope * x for x, y in there)
        self._lower_ns = max(-y - slope * x for x, y in back)
        self._smallest_trip_ns = min(s.there_ns - s.back_ns for s in samples)
        self._slope_error += self._unevenness_ns() / max(span_ns, SETTLING_NS)
        crossed_ns = self._lower_ns - self._upper_ns
        if crossed_ns > self._uneven_ns and len(samples) > PENDING:  # a step before the lines were known
            self._steps += 1
            newest = list(samples)[-PENDING:]
            samples.clear()
            samples.extend(newest)
            self._fit()
            return
        centre_ns = 0.5 * (self._upper_ns + self._lower_ns)
        errors = (0.5 * (s.there_ns + s.back_ns) - centre_ns - slope * s.sent_ns for s in samples)
        self._residual_ns = sqrt(sum(error * error for error in errors) / len(samples))

    def _unevenness_ns(self) -> float:
        """Observed lag of the clock: it brings the two lines closer together, or makes them cross."""
        if not self._uneven_ns:
            return 0.0
        return max(self._smallest_trip_ns - (self._upper_ns - self._lower_ns), 0.0)

    def _offset_at(self, local_ns: float) -> float:
        return 0.5 * (self._upper_ns + self._lower_ns) + self._slope * local_ns

    def _check_ready(self) -> None:
        if not self._history:
            raise ValueError("clock sync: there is no exchange yet; add one before you convert a time")

    def to_remote(self, local_ns: int) -> int:
        """Remote time at a local time. Raises ValueError before the first sample."""
        self._check_ready()
        return local_ns + self._offset_zero_ns + round(self._offset_at(float(local_ns - self._local_zero_ns)))

    def to_local(self, remote_ns: int) -> int:
        """Local time at a remote time. Raises ValueError before the first sample."""
        self._check_ready()
        guess_ns = remote_ns - self._offset_zero_ns
        shift_ns = self._offset_at(float(guess_ns - self._local_zero_ns)) / (1.0 + self._slope)
        return guess_ns - round(shift_ns)

    @property
    def estimate(self) -> SyncEstimate:
        """Relation at the newest sample. Raises ValueError before the first."""
        self._check_ready()
        return SyncEstimate(
            offset_ns=self._offset_zero_ns + round(self._offset_at(self._newest_ns)),
            drift_ppm=self._slope * 1e6,
            drift_error_ppm=self._slope_error * 1e6,
            path_delay_ns=round(0.5 * self._smallest_trip_ns),
            asymmetry_bound_ns=round(0.5 * (self._smallest_trip_ns + self._unevenness_ns())),
            residual_ns=self._residual_ns,
            used=len(self._history),
            refused=self._refused,
            outliers=self._outliers,
            steps=self._steps,
        )


def _lower_hull(points: list[Point]) -> list[Point]:
    """Lower convex hull (Andrew's monotone chain)."""
    hull: list[Point] = []
    for x, y in sorted(points):
        if hull and x == hull[-1][0]:
            continue
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        hull.append((x, y))
    return hull


@dataclass(frozen=True)
class _Line:
    """Gap between the edges, top - fall * slope, for slopes from start to end."""

    start: float
    end: float
    top: float
    fall: float

    def at_start(self) -> float:
        return self.top - self.fall * self.start


def _lines(there: list[Point], back: list[Point], limit: float) -> list[_Line]:
    """Gap as a function of the slope within the limit. It is concave, and linear between two edges of the hulls."""
    i, j, start = 0, len(back) - 1, -limit
    lines: list[_Line] = []
    while True:
        of_there = _slope(there[i], there[i + 1]) if i + 1 < len(there) else inf
        of_back = -_slope(back[j - 1], back[j]) if j > 0 else inf
        end = min(of_there, of_back, limit)
        if end > start or end >= limit:
            (x0, y0), (x1, y1) = there[i], back[j]
            lines.append(_Line(start, max(end, start), y0 + y1, x0 - x1))
            start = max(end, start)
        if end >= limit:
            last = lines[-1]
            lines.append(_Line(limit, limit, last.top, last.fall))  # for its value at the limit
            return lines
        if of_there <= of_back:
            i += 1
        else:
            j -= 1


def _slope(start: Point, end: Point) -> float:
    return (end[1] - start[1]) / (end[0] - start[0])


def _excesses(samples: Sequence[_Sample], slope: float) -> list[float]:
    """Excess of each delay over its floor, in both directions."""
    there = [s.there_ns - slope * s.sent_ns for s in samples]
    back = [slope * s.returned_ns - s.back_ns for s in samples]
    floor_there, floor_back = min(there), min(back)
    return [value - floor_there for value in there] + [value - floor_back for value in back]


def _weighted_slope(lines: list[_Line], likeliest: float, per_ns: float) -> tuple[float, float]:
    """Mean and standard deviation of the slopes, weighted by exp(gap * per_ns), in closed form.

    The likeliest slope has the widest gap.
    """
    widest = max(line.at_start() for line in lines)
    area = moment = square = 0.0
    for line in lines:
        a, b = line.start - likeliest, line.end - likeliest
        at_a = exp(min((line.at_start() - widest) * per_ns, 0.0))
        at_b = exp(min((line.top - line.fall * line.end - widest) * per_ns, 0.0))
        rate = line.fall * per_ns
        if abs(rate) * (b - a) < 1e-6:
            piece = (b - a) * 0.5 * (at_a + at_b)
            first = piece * 0.5 * (a + b)
            square += piece * (a * a + a * b + b * b) / 3.0
        else:
            piece = (at_a - at_b) / rate
            first = (a * at_a - b * at_b + piece) / rate
            square += (a * a * at_a - b * b * at_b + 2.0 * first) / rate
        moment += first
        area += piece
    mean = moment / area if area > 0.0 else 0.0
    if not isfinite(mean):
        return likeliest, 0.0
    return likeliest + mean, sqrt(max(square / area - mean * mean, 0.0)) if area > 0.0 else 0.0
