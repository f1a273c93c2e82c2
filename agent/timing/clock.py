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
