"""Which samples of a sensor are passed on where more come than are wanted, and how fast a run may go."""

from __future__ import annotations

from time import monotonic, sleep
from typing import Callable

RATE_WINDOW = 64
LONGEST_HOLD_S = 0.5


class Pace:
    """Every sample whose turn it is; with `period_ns` 0 each one. Stamps that step back begin anew."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._early_ns = period_ns // 8
        self._next_ns: int | None = None
        self._last_ns = 0

    def due(self, stamp_ns: int) -> bool:
        """Whether this sample is to be passed on."""
        if self._period_ns == 0:
            return True
        if self._next_ns is None or stamp_ns < self._last_ns or stamp_ns > self._next_ns + self._period_ns:
            self._next_ns = stamp_ns
        self._last_ns = stamp_ns
        if stamp_ns + self._early_ns < self._next_ns:
            return False
        self._next_ns += self._period_ns
        return True


class RateGauge:
    """How many samples a second come, by their stamps."""

    def __init__(self) -> None:
        self._first_ns = 0
        self._count = 0

    def add(self, stamp_ns: int) -> float | None:
        """The rate, once for every `RATE_WINDOW` samples, None in between."""
        if self._count == 0 or stamp_ns <= self._first_ns:
            self._first_ns, self._count = stamp_ns, 1
            return None
        self._count += 1
        if self._count <= RATE_WINDOW:
            return None
        rate_hz = RATE_WINDOW * 1e9 / (stamp_ns - self._first_ns)
        self._count = 0
        return rate_hz


class SpeedLimit:
    """Holds a run in lockstep back to `factor` times real time."""

    def __init__(
        self, factor: float, clock_s: Callable[[], float] = monotonic, wait: Callable[[float], None] = sleep
    ) -> None:
        self._wall_s_per_ns = 1e-9 / factor
        self._clock_s = clock_s
        self._wait = wait
        self._last_ns: int | None = None
        self._due_s = 0.0

    def hold(self, now_ns: int) -> None:
        """The run has got to `now_ns`: wait until it may be there, half a second at most."""
        clock_s = self._clock_s()
        if self._last_ns is not None:
            self._due_s += (now_ns - self._last_ns) * self._wall_s_per_ns
            early_s = min(self._due_s - clock_s, LONGEST_HOLD_S)
            if early_s > 0.0:
                self._wait(early_s)
                clock_s = self._clock_s()
        self._last_ns = now_ns
        self._due_s = max(self._due_s, clock_s)
