"""Waiting for the deadline of a real-time loop: no garbage collection and no system call in the last moments."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic_ns
from typing import Callable

SPIN_NS = 50_000
"""Last part of a wait, spent on reading the clock: a sleeping thread wakes some 10 µs to 100 µs late."""
YOUNG_OBJECTS = 700
"""New objects at which garbage is collected, as Python does by itself."""
FULL_EVERY_NS = 10_000_000_000
OVERDUE_NS = 30_000_000_000
"""A loop without slack gets a collection nevertheless after this time, so that its memory does not grow."""
_FIRST_GUESS_NS = 300_000
_TIMER_SLACK = "/proc/self/timerslack_ns"
_CLOCK_MONOTONIC, _TIMER_ABSTIME = 1, 1  # linux/time.h


class DeadlineWait:
    """Waits of one loop for its deadlines.

    Inside `deferred`, Python collects no garbage by itself. `until` collects it in a wait that is long enough: young
    objects when there are some hundreds, all objects every `FULL_EVERY_NS`. A collection starts only if the time left
    is twice the time of the last one. Objects from before `deferred` are excluded until its end.

    Outside `deferred`, only the wait itself differs from a sleep.

    clock_ns: clock of the collections. spin: waits for the last moments, in nanoseconds, without a system call.
    """

    def __init__(
        self,
        clock_ns: Callable[[], int] = monotonic_ns,
        spin: Callable[[int], object] | None = None,
    ) -> None:
        self._clock_ns = clock_ns
        self._spin = spin_ns if spin is None else spin
        self._deferring = False
        self._took_ns = [0, _FIRST_GUESS_NS, _FIRST_GUESS_NS]  # of the last collection, by generation
        self._young_ns = self._full_ns = 0

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Context without automatic collections and with exact timers."""
        enabled = gc.isenabled()
        slack_ns = timer_slack_ns()
        gc.collect()
        gc.freeze()
        set_timer_slack_ns(1)
        self._young_ns = self._full_ns = self._clock_ns()
        self.defer(True)
        try:
            yield
        finally:
            self._deferring = False
            if enabled:
                gc.enable()
            gc.unfreeze()
            if slack_ns:
                set_timer_slack_ns(slack_ns)

    def defer(self, deferring: bool) -> None:
        """Leave the collections to `until`, or to Python for a time without deadlines."""
        if deferring == self._deferring:
            return
        self._deferring = deferring
        if deferring:
            gc.disable()
        else:
            gc.enable()

    def until(self, left_ns: int, idle: Callable[[float], object]) -> bool:
        """Wait for a deadline that is `left_ns` away. Return False if `idle` waited, so that time may be left.

        idle: waits for at most so many seconds, and may return early. It is not called in the last `SPIN_NS`.
        """
        if left_ns <= SPIN_NS:
            self._spin(left_ns)
            return True
        if self._deferring:
            left_ns -= self.collect(left_ns)
        if left_ns > SPIN_NS:
            idle((left_ns - SPIN_NS) * 1e-9)
        return False

    def missed(self) -> None:
        """Note a deadline that left nothing to wait for. Garbage is collected nevertheless when it is overdue."""
        if self._deferring:
            self.collect(0)

    def collect(self, left_ns: int) -> int:
        """Collect garbage if it is due and fits into `left_ns`. Return the time that this took in nanoseconds."""
        now_ns = self._clock_ns()
        since_full_ns = now_ns - self._full_ns
        if since_full_ns >= FULL_EVERY_NS and (left_ns >= 2 * self._took_ns[2] or since_full_ns >= OVERDUE_NS):
            return self._collect(2, now_ns)
        overdue = now_ns - self._young_ns >= OVERDUE_NS
        if gc.get_count()[0] >= YOUNG_OBJECTS and (left_ns >= 2 * self._took_ns[1] or overdue):
            return self._collect(1, now_ns)
        return 0

    def _collect(self, generation: int, began_ns: int) -> int:
        gc.collect(generation)
        self._young_ns = self._clock_ns()
        if generation == 2:
            self._full_ns = self._young_ns
        self._took_ns[generation] = self._young_ns - began_ns
        return self._took_ns[generation]


def spin_ns(left_ns: int) -> None:
    """Read the clock until `left_ns` have passed."""
    due_ns = monotonic_ns() + left_ns
    while monotonic_ns() < due_ns:
        pass


def timer_slack_ns() -> int:
    """Return the time by which the system may delay a timer of the main thread; 0 if it does not say."""
    try:
        with open(_TIMER_SLACK) as file:  # noqa: PTH123  as in agent.machine
            return int(file.read())
    except (OSError, ValueError):
        return 0


def set_timer_slack_ns(slack_ns: int) -> None:
    """Set the time by which the system may delay a timer of the main thread, where the system permits it."""
    try:
        with open(_TIMER_SLACK, "w") as file:  # noqa: PTH123  as in agent.machine
            file.write(str(slack_ns))
    except OSError:
        return


def absolute_sleep() -> Callable[[int], None] | None:
    """Return `clock_nanosleep` until an instant of the monotonic clock in nanoseconds; None on other systems."""
    if not sys.platform.startswith("linux"):
        return None
    from ctypes import CDLL, byref, c_long

    clock_nanosleep = getattr(CDLL(None), "clock_nanosleep", None)
    if clock_nanosleep is None:
        return None
    timespec = (c_long * 2)()
    pointer = byref(timespec)

    def sleep_until(due_ns: int) -> None:
        timespec[0], timespec[1] = divmod(due_ns, 1_000_000_000)
        while clock_nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, pointer, None):
            pass  # interrupted by a signal

    return sleep_until
