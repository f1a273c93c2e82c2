"""How another machine's clock runs against this one's, from four-timestamp exchanges over a link with jitter.

Of an exchange, t2 - t1 is the offset plus the delay there, t3 - t4 the offset minus the delay back. Delays have a floor
and pile up above it, so the truth is seen at the edges: a line below all t2 - t1 and one above all t3 - t4, each the
one that lies closest to its points (the linear programme of Moon, Skelly and Towsley, INFOCOM 1999; solved exactly by
the edge of the convex hull at the mean instant). With n samples the edges close in as 1/n, where averages of any kind
close in as 1/sqrt(n). Both lines share the mean of their slopes, the drift; the offset is half way between them. What
no exchange can see is the asymmetry of the two floors: it shifts the offset by half of the difference, at most by half
of the smallest round trip.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import sqrt

HISTORY = 600
FIT_EVERY = 10  # samples between fits once there are many; a fit costs some 0.5 ms for 600
PENDING = 10
VIOLATIONS = 3
SMALLEST_STEP_NS = 200_000.0
SETTLING_NS = 3e9  # spans shorter than this say little about drift, which is then drawn to zero

Point = tuple[float, float]


@dataclass(frozen=True)
class SyncEstimate:
    """Remote clock against local clock at the newest sample.

    offset_ns: remote minus local. drift_ppm: growth of the offset. path_delay_ns: one way, half of the smallest round
    trip. asymmetry_bound_ns: the most by which unequal floors of the two ways can shift the offset. residual_ns: RMS of
    the single exchanges about the line, a measure of the jitter. used: samples behind the estimate. refused: exchanges
    that no clocks could give. outliers: exchanges that contradict the rest. steps: times the relation broke and was
    learned anew.
    """

    offset_ns: int
    drift_ppm: float
    path_delay_ns: int
    asymmetry_bound_ns: int
    residual_ns: float
    used: int
    refused: int
    outliers: int
    steps: int


@dataclass(frozen=True)
class _Sample:
    sent_ns: float  # local, since the first sample
    returned_ns: float
    there_ns: float  # t2 - t1 and t3 - t4, less the first sample's offset
    back_ns: float


class ClockSync:
    """Feed it exchanges; ask it for the relation. Memory and time per sample are bounded.

    A clock that steps contradicts the lines: the offset would need negative delays. `VIOLATIONS` of that among
    `PENDING` samples start a new history; fewer are outliers and left out.
    """

    def __init__(self, max_drift_ppm: float = 500.0) -> None:
        if not max_drift_ppm > 0.0:
            raise ValueError(f"clock sync: max_drift_ppm = {max_drift_ppm} leaves no drift; use a number above 0")
        self._max_slope = max_drift_ppm * 1e-6
        self._history: deque[_Sample] = deque(maxlen=HISTORY)
        self._pending: list[tuple[_Sample, bool]] = []
        self._local_zero_ns = self._offset_zero_ns = 0
        self._slope = self._upper_ns = self._lower_ns = self._residual_ns = 0.0
        self._newest_ns = 0.0
        self._since_fit = 0
        self._smallest_trip_ns = 0.0
        self._refused = self._outliers = self._steps = 0

    @property
    def ready(self) -> bool:
        """Whether there is a relation at all."""
        return bool(self._history)

    def add(self, t1_ns: int, t2_ns: int, t3_ns: int, t4_ns: int) -> bool:
        """An exchange: sent (local), arrived (remote), answered (remote), returned (local).

        False when it was refused.
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
        violates = len(self._history) >= 2 * PENDING and self._violates(sample)
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
            self._take_pending(keep_violating=True)
        elif len(self._pending) >= PENDING:
            self._take_pending(keep_violating=False)
        return True

    def _violates(self, sample: _Sample) -> bool:
        tolerance_ns = max(SMALLEST_STEP_NS, self._residual_ns)
        below_ns = self._upper_ns + self._slope * sample.sent_ns - sample.there_ns
        above_ns = sample.back_ns - self._lower_ns - self._slope * sample.returned_ns
        return max(below_ns, above_ns) > tolerance_ns

    def _take_pending(self, keep_violating: bool) -> None:
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
        middle_ns = sum(s.sent_ns for s in samples) / len(samples)
        span_ns = samples[-1].sent_ns - samples[0].sent_ns
        slope = 0.5 * (_slope_at(there, middle_ns) - _slope_at(back, middle_ns))
        slope *= span_ns**4 / (span_ns**4 + SETTLING_NS**4)
        self._slope = slope = min(max(slope, -self._max_slope), self._max_slope)
        self._upper_ns = min(y - slope * x for x, y in there)
        self._lower_ns = max(-y - slope * x for x, y in back)
        self._smallest_trip_ns = min(s.there_ns - s.back_ns for s in samples)
        if self._upper_ns < self._lower_ns and len(samples) > PENDING:  # a step before there was a line to break
            self._steps += 1
            newest = list(samples)[-PENDING:]
            samples.clear()
            samples.extend(newest)
            self._fit()
            return
        centre_ns = 0.5 * (self._upper_ns + self._lower_ns)
        errors = (0.5 * (s.there_ns + s.back_ns) - centre_ns - slope * s.sent_ns for s in samples)
        self._residual_ns = sqrt(sum(error * error for error in errors) / len(samples))

    def _offset_at(self, local_ns: float) -> float:
        return 0.5 * (self._upper_ns + self._lower_ns) + self._slope * local_ns

    def _need_ready(self) -> None:
        if not self._history:
            raise ValueError("clock sync: no exchange has come back yet; add one before asking for a time")

    def to_remote(self, local_ns: int) -> int:
        """What the remote clock shows when the local one shows local_ns. Raises ValueError before the first sample."""
        self._need_ready()
        return local_ns + self._offset_zero_ns + round(self._offset_at(float(local_ns - self._local_zero_ns)))

    def to_local(self, remote_ns: int) -> int:
        """What the local clock shows when the remote one shows remote_ns. Raises ValueError before the first sample."""
        self._need_ready()
        guess_ns = remote_ns - self._offset_zero_ns
        shift_ns = self._offset_at(float(guess_ns - self._local_zero_ns)) / (1.0 + self._slope)
        return guess_ns - round(shift_ns)

    @property
    def estimate(self) -> SyncEstimate:
        """The relation at the newest sample. Raises ValueError before the first."""
        self._need_ready()
        return SyncEstimate(
            offset_ns=self._offset_zero_ns + round(self._offset_at(self._newest_ns)),
            drift_ppm=self._slope * 1e6,
            path_delay_ns=round(0.5 * self._smallest_trip_ns),
            asymmetry_bound_ns=round(0.5 * self._smallest_trip_ns),
            residual_ns=self._residual_ns,
            used=len(self._history),
            refused=self._refused,
            outliers=self._outliers,
            steps=self._steps,
        )


def _lower_hull(points: list[Point]) -> list[Point]:
    """Convex hull from below of points in order of x (Andrew's monotone chain)."""
    hull: list[Point] = []
    for x, y in points:
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        hull.append((x, y))
    return hull


def _slope_at(hull: list[Point], x: float) -> float:
    """Slope of the edge over x: the line below all points that is closest to them in the sum of distances."""
    for (x0, y0), (x1, y1) in zip(hull, hull[1:]):
        if x1 >= x and x1 > x0:
            return (y1 - y0) / (x1 - x0)
    return 0.0
