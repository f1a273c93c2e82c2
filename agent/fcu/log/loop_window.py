"""How regularly the loop came and what the tasks took, over a window of ten seconds, as ArduPilot's PM reports it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from agent.timing.tasks import TaskStats

WINDOW_NS = 10_000_000_000
_CALL_NS = 1_000_000_000  # between calls of `take`; the window ends with the nearest one


class LoopTimes(NamedTuple):
    """`longest_us` from the start of one loop to that of the next; `load` is the tasks' share of the time, in 0.1 %."""

    long_loops: int
    loops: int
    longest_us: int
    load: int


class LoopWindow:
    """Told of every loop; a loop is long at 1.2 times its period."""

    def __init__(self, now_ns: int, loop_hz: int) -> None:
        self._long_ns = 1_200_000_000 // loop_hz
        self._last_ns: int | None = None
        self._start(now_ns, 0.0)

    def _start(self, now_ns: int, busy_ns: float) -> None:
        self._start_ns = now_ns
        self._busy_ns = busy_ns
        self._loops = 0
        self._long_loops = 0
        self._longest_ns = 0

    def loop(self, now_ns: int) -> None:
        """A loop starts."""
        if self._last_ns is not None:
            interval_ns = now_ns - self._last_ns
            self._loops += 1
            self._long_loops += interval_ns > self._long_ns
            if interval_ns > self._longest_ns:
                self._longest_ns = interval_ns
        self._last_ns = now_ns

    def take(self, now_ns: int, stats: Sequence[TaskStats]) -> LoopTimes | None:
        """The window, once it is full; a new one then starts. Ask about once a second.

        `stats` count since the executor's start.
        """
        duration_ns = now_ns - self._start_ns
        if duration_ns < WINDOW_NS - _CALL_NS // 2:
            return None
        busy_ns = sum(task.run_mean_ns * task.cycles for task in stats)
        load = round(1000.0 * max(0.0, busy_ns - self._busy_ns) / duration_ns)
        times = LoopTimes(self._long_loops, self._loops, self._longest_ns // 1000, load)
        self._start(now_ns, busy_ns)
        return times
