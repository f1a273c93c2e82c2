"""Periodic tasks on absolute deadlines, and how they kept them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable

from agent.timing.clock import Clock


@dataclass(frozen=True)
class TaskStats:
    """How one task kept its deadlines since the start.

    All times are from the executor's clock: under a TickClock, which stands still while a task runs, run times are 0
    by construction.

    cycles: cycles run. missed: cycles that were skipped, or ended after the next was due. skipped: the skipped ones
    among them. start_jitter: from the instant a cycle was due to its start. worst_ns: start of the longest run.
    """

    name: str
    rate_hz: float
    cycles: int = 0
    missed: int = 0
    skipped: int = 0
    start_jitter_max_ns: int = 0
    start_jitter_mean_ns: float = 0.0
    run_max_ns: int = 0
    run_mean_ns: float = 0.0
    worst_ns: int = 0


class _Task:
    def __init__(self, name: str, rate_hz: float, function: Callable[[int], None], start_ns: int) -> None:
        self.name = name
        self.rate_hz = rate_hz
        self.function = function
        self.restart(start_ns)

    def restart(self, start_ns: int) -> None:
        self.start_ns = start_ns
        self.index = 0
        self.due_ns = start_ns
        self.cycles = self.missed = self.skipped = 0
        self.jitter_max_ns = self.jitter_sum_ns = 0
        self.run_max_ns = self.run_sum_ns = self.worst_ns = 0

    def due(self, index: int) -> int:
        """Instant of a cycle, from the start and not from the cycle before: rounding does not add up."""
        return self.start_ns + round(index * 1e9 / self.rate_hz)

    def run(self, clock: Clock) -> None:
        begin_ns = clock.now_ns()
        index = self.index
        next_ns = self.due(index + 1)
        if next_ns <= begin_ns:
            index = max(index, int((begin_ns - self.start_ns) * self.rate_hz / 1e9) - 1)
            while (next_ns := self.due(index + 1)) <= begin_ns:
                index += 1
            self.skipped += index - self.index
            self.missed += index - self.index
        jitter_ns = begin_ns - self.due_ns
        self.index, self.due_ns = index + 1, next_ns
        self.function(begin_ns)
        end_ns = clock.now_ns()
        run_ns = end_ns - begin_ns
        self.cycles += 1
        self.missed += end_ns > next_ns
        self.jitter_sum_ns += jitter_ns
        self.jitter_max_ns = max(self.jitter_max_ns, jitter_ns)
        self.run_sum_ns += run_ns
        if run_ns > self.run_max_ns or self.cycles == 1:
            self.run_max_ns, self.worst_ns = run_ns, begin_ns

    def stats(self) -> TaskStats:
        cycles = max(self.cycles, 1)
        return TaskStats(
            name=self.name,
            rate_hz=self.rate_hz,
            cycles=self.cycles,
            missed=self.missed,
            skipped=self.skipped,
            start_jitter_max_ns=self.jitter_max_ns,
            start_jitter_mean_ns=self.jitter_sum_ns / cycles,
            run_max_ns=self.run_max_ns,
            run_mean_ns=self.run_sum_ns / cycles,
            worst_ns=self.worst_ns,
        )


class Executor:
    """Runs functions at fixed rates; the caller waits, this one decides what is due.

    Cycle k of a task is due at start + k / rate, whatever happened before. A task that comes late runs once, for the
    newest cycle due; the cycles it slept through are skipped and counted, never made up for.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._tasks: list[_Task] = []

    def add(self, name: str, rate_hz: float, function: Callable[[int], None]) -> None:
        """A task, first due now; `function` gets the instant its cycle starts.

        What is due together runs in the order added.
        """
        if not 0.0 < rate_hz <= 1e6:
            raise ValueError(f"task {name}: rate_hz = {rate_hz} is not a rate; use a number above 0 up to 1e6")
        if any(task.name == name for task in self._tasks):
            raise ValueError(f"task {name}: the name is taken; give each task its own")
        self._tasks.append(_Task(name, rate_hz, function, self._clock.now_ns()))

    @property
    def next_due_ns(self) -> int | None:
        """Earliest instant at which a task is due, None without tasks."""
        return min((task.due_ns for task in self._tasks), default=None)

    def run_due(self, now_ns: int) -> int:
        """Run once each task due at now_ns (an instant of the executor's clock, not in its future).

        Returns how many ran.
        """
        ran = 0
        for task in self._tasks:
            if task.due_ns <= now_ns:
                task.run(self._clock)
                ran += 1
        return ran

    def restart(self, now_ns: int) -> None:
        """All tasks first due at now_ns, with empty statistics."""
        for task in self._tasks:
            task.restart(now_ns)

    @property
    def stats(self) -> list[TaskStats]:
        """One per task, in the order added."""
        return [task.stats() for task in self._tasks]
