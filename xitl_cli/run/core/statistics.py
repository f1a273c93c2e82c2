"""Statistics of endless streams in bounded memory: quantiles, spread, the time base of a clock and its drift."""

from __future__ import annotations

from math import sqrt

from agent.timing.sync import ClockSync
from sim_core.dataclass import dataclass


class Histogram:
    """Counts nanoseconds in buckets 1/32 of their power of two wide: quantiles to 3 %, the maximum exact."""

    def __init__(self) -> None:
        self._buckets: dict[int, int] = {}
        self.count = 0
        self.max_ns = 0

    def add(self, value_ns: int) -> None:
        """Count one value.

        A negative value counts as 0; it occurs when the clocks' alignment error exceeds the latency.
        """
        value_ns = max(value_ns, 0)
        shift = max(value_ns.bit_length() - 6, 0)
        bucket = (shift << 6) + (value_ns >> shift)
        self._buckets[bucket] = self._buckets.get(bucket, 0) + 1
        self.count += 1
        self.max_ns = max(self.max_ns, value_ns)

    def quantile_ns(self, share: float) -> int | None:
        """The value below which `share` of all values lie, None when there are none."""
        if not self.count:
            return None
        left = share * self.count
        for bucket in sorted(self._buckets):
            left -= self._buckets[bucket]
            if left <= 0:
                shift, top = bucket >> 6, bucket & 63
                return min((top << shift) + (1 << shift >> 1), self.max_ns)
        return self.max_ns


WINDOW_NS = 10_000_000_000
WINDOW_SAMPLES = 20  # a window with fewer samples gives no drift


class Spread:
    """Mean and standard deviation of an endless stream (Welford's recurrence)."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = 0.0
        self._squares = 0.0

    def add(self, value: float) -> None:
        """Add a value."""
        self.count += 1
        deviation = value - self.mean
        self.mean += deviation / self.count
        self._squares += deviation * (value - self.mean)

    @property
    def deviation(self) -> float | None:
        """Standard deviation with one degree of freedom less, None for fewer than two values."""
        return sqrt(self._squares / (self.count - 1)) if self.count > 1 else None


@dataclass(frozen=True, slots=True)
class Slope:
    """A time base as a straight line: seconds a sample, and the standard deviation of the single steps about it."""

    mean_s: float | None = None
    deviation_s: float | None = None


class TimeBase:
    """The curve "time base against sample number": its slope and the variation of the slope, in constant memory.

    The mean is the chord from the first sample to the newest. The deviation is that of the steps between neighbours.
    Each step is divided by the number of samples that it spans.
    """

    def __init__(self) -> None:
        self._first: tuple[int, int] | None = None
        self._newest: tuple[int, int] = (0, 0)
        self._steps = Spread()

    def add(self, sample: int, clock_ns: int) -> None:
        """Add the node's clock at a sample. Ignore a sample that is not above the last one.

        A clock that goes back belongs to an agent that was restarted.
        """
        if self._first is None:
            self._first = self._newest = (sample, clock_ns)
            return
        last, last_ns = self._newest
        if sample <= last or clock_ns <= last_ns:
            return
        self._steps.add((clock_ns - last_ns) * 1e-9 / (sample - last))
        self._newest = (sample, clock_ns)

    @property
    def slope(self) -> Slope:
        """The line so far."""
        if self._first is None or self._newest == self._first:
            return Slope()
        (first, first_ns), (last, last_ns) = self._first, self._newest
        return Slope((last_ns - first_ns) * 1e-9 / (last - first), self._steps.deviation)


class DriftWindows:
    """Variation of a clock's drift, from the separate drift of each 10 s.

    It leaves out a window in which the clock stepped, and a window with too few exchanges.
    """

    def __init__(self, uneven_ns: float = 0.0) -> None:
        self._uneven_ns = uneven_ns
        self._sync = ClockSync(uneven_ns=uneven_ns)
        self._began_ns: int | None = None
        self._drifts = Spread()

    def add(self, t1_ns: int, t2_ns: int, t3_ns: int, t4_ns: int) -> None:
        """Add an exchange, see ClockSync."""
        if self._began_ns is None:
            self._began_ns = t1_ns
        if t1_ns - self._began_ns >= WINDOW_NS:
            if self._sync.ready:
                estimate = self._sync.estimate
                if estimate.used >= WINDOW_SAMPLES and not estimate.steps:
                    self._drifts.add(estimate.drift_ppm)
            self._began_ns = t1_ns
            self._sync = ClockSync(uneven_ns=self._uneven_ns)
        self._sync.add(t1_ns, t2_ns, t3_ns, t4_ns)

    @property
    def deviation_ppm(self) -> float | None:
        """Standard deviation over the complete windows so far, None for fewer than two."""
        return self._drifts.deviation
