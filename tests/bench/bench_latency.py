"""Start lateness of a periodic task at 400 Hz under SCHED_FIFO, against a bare sleep by turns of a second.

`xitl doctor --latency` measures the same with all details.
"""

from __future__ import annotations

from contextlib import nullcontext

from agent.board.latency import BARE, XITL, fifo_problem, load, measure_loops, scheduled
from agent.timing.deadline import absolute_sleep
from agent.timing.realtime import DEFAULT_PRIORITY
from tests.bench.figure import Figure, scaled

RATE_HZ, LENGTH_S, RUNS = 400.0, 20.0, 3


def p999_ratios(loaded: bool) -> list[float]:
    """p99.9 of the task over that of the bare sleep."""
    return [_ratio(loaded) for _ in range(scaled(RUNS, 1))]


def _ratio(loaded: bool) -> float:
    with load() if loaded else nullcontext(), scheduled(DEFAULT_PRIORITY):
        rows = {row["loop"]: row for row in measure_loops((RATE_HZ,), scaled(LENGTH_S, 0.2))}
    return float(rows[XITL]["p999_us"] / rows[BARE]["p999_us"])


def available() -> bool:
    """Whether this system permits SCHED_FIFO and has a bare sleep."""
    return not fifo_problem() and absolute_sleep() is not None


FIGURES = [
    Figure("start lateness at 400 Hz, p99.9, of a bare sleep's", "<= 2", "x", lambda: p999_ratios(False)),
    Figure("start lateness at 400 Hz under load, p99.9, of a bare sleep's", "<= 2", "x", lambda: p999_ratios(True)),
]
