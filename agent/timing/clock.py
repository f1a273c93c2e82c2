"""Where a part of the agent gets its time from: real, or that of the lockstep ticks."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Time that never steps back."""

    def now_ns(self) -> int:
        """Nanoseconds since the clock's own zero."""


class MonotonicClock:
    """The machine's monotonic clock, zero at construction."""

    def __init__(self) -> None:
        self._start_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        """Nanoseconds since construction."""
        return time.monotonic_ns() - self._start_ns


class TickClock:
    """Lockstep: stands still between ticks."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        """Time of the newest tick."""
        return self._now_ns

    def advance_to(self, now_ns: int) -> bool:
        """Set the time. False, and nothing happens, when that would be a step back or no step."""
        if now_ns <= self._now_ns:
            return False
        self._now_ns = now_ns
        return True


class SteppedClock:
    """Another clock with faults: ahead by steps, and running fast. Without faults it is that clock."""

    def __init__(self, clock: Clock) -> None:
        self._base_ns = clock.now_ns
        self._skew = 0.0
        self._since_ns = 0
        self._ahead_ns = 0
        self.offset_ns = 0

    def now_ns(self) -> int:
        """Nanoseconds since the other clock's zero, and what this one is ahead."""
        now_ns = self._base_ns()
        if self._skew:
            return now_ns + self._ahead_ns + round((now_ns - self._since_ns) * self._skew)
        return now_ns + self._ahead_ns

    def disturb(self, offset_ns: int, skew_ppm: float) -> bool:
        """Be `offset_ns` ahead by steps and run fast by `skew_ppm` (below 0: slow) from now on.

        What an earlier skew has made of the time stays. False, and nothing is changed, for a smaller offset than now:
        time never steps back.
        """
        if offset_ns < self.offset_ns or not -1e6 < skew_ppm < 1e6:
            return False
        now_ns = self._base_ns()
        gained_ns = round((now_ns - self._since_ns) * self._skew)
        self._ahead_ns += gained_ns + offset_ns - self.offset_ns
        self.offset_ns = offset_ns
        self._since_ns, self._skew = now_ns, skew_ppm * 1e-6
        return True
