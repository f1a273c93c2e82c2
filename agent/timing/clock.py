"""Clocks of the agent: real time, or the time of the lockstep ticks."""

from __future__ import annotations

import select
import time
from collections.abc import Sequence
from typing import Protocol

_MOST_FOR_SELECT = 1024  # FD_SETSIZE


class Clock(Protocol):
    """Time that never steps back."""

    def now_ns(self) -> int:
        """Nanoseconds since the clock's zero."""


class MonotonicClock:
    """The machine's monotonic clock, zero at construction."""

    def __init__(self) -> None:
        self._start_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        """Nanoseconds since construction."""
        return time.monotonic_ns() - self._start_ns


class TickClock:
    """Lockstep clock, which is constant between ticks."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        """Time of the newest tick."""
        return self._now_ns

    def advance_to(self, now_ns: int) -> bool:
        """Set the time. Return False without a change if it is not later than the present time."""
        if now_ns <= self._now_ns:
            return False
        self._now_ns = now_ns
        return True


class SteppedClock:
    """Another clock with faults: ahead by steps, and with a skew. Without faults it equals that clock."""

    def __init__(self, clock: Clock) -> None:
        self._base_ns = clock.now_ns
        self._skew = 0.0
        self._since_ns = 0
        self._ahead_ns = 0
        self.offset_ns = 0

    def now_ns(self) -> int:
        """Nanoseconds since the other clock's zero, plus the lead of this clock."""
        now_ns = self._base_ns()
        if self._skew:
            return now_ns + self._ahead_ns + round((now_ns - self._since_ns) * self._skew)
        return now_ns + self._ahead_ns

    def disturb(self, offset_ns: int, skew_ppm: float) -> bool:
        """Step to `offset_ns` ahead and run fast by `skew_ppm` (below 0: slow) from now on.

        The effect of an earlier skew remains. Return False without a change for a smaller offset than the present one,
        because time never steps back.
        """
        if offset_ns < self.offset_ns or not -1e6 < skew_ppm < 1e6:
            return False
        now_ns = self._base_ns()
        gained_ns = round((now_ns - self._since_ns) * self._skew)
        self._ahead_ns += gained_ns + offset_ns - self.offset_ns
        self.offset_ns = offset_ns
        self._since_ns, self._skew = now_ns, skew_ppm * 1e-6
        return True


def wait_readable(descriptors: Sequence[int], timeout_s: float) -> None:
    """Return when one of the descriptors is readable, or after timeout_s.

    select() has microsecond resolution, while poll() and epoll round up to milliseconds. But select() does not accept
    descriptors from 1024 on. On Windows, it accepts any socket, and there is no poll().
    """
    if max(descriptors) < _MOST_FOR_SELECT or not hasattr(select, "poll"):
        select.select(descriptors, (), (), timeout_s)
        return
    poll = select.poll()
    for descriptor in descriptors:
        poll.register(descriptor, select.POLLIN)
    poll.poll(timeout_s * 1000.0)
