"""Periodic tasks on absolute deadlines, and their timing statistics."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Callable, NamedTuple

from agent.timing.clock import Clock

BINS = 16
EMPTY = (0,) * BINS
MOST_KEPT = 64


@dataclass(frozen=True)
class TaskStats:
    """Timing of one task since the start, on the executor's clock.

    A TickClock is constant while a task runs, so run times are 0 under it. `histogram_bin` defines the bins of the
    histograms.
    """

    name: str
    rate_hz: float
    cycles: int = 0
    missed: int = 0
    """Cycles that were skipped, or ended after the next was due."""
    skipped: int = 0
    """Skipped cycles among them."""
    start_jitter_max_ns: int = 0
    """Start jitter is the time from the due instant of a cycle to its start."""
    start_jitter_mean_ns: float = 0.0
    run_max_ns: int = 0
    run_mean_ns: float = 0.0
    worst_run_ns: int = 0
    """Start of the longest run."""
    worst_start_ns: int = 0
    """The most delayed start."""
    start_jitter_histogram: tuple[int, ...] = EMPTY
    run_histogram: tuple[int, ...] = EMPTY


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
        self.jitter_max_ns = self.jitter_sum_ns = self.worst_start_ns = 0
        self.run_max_ns = self.run_sum_ns = self.worst_run_ns = 0
        self.jitter_bins = [0] * BINS
        self.run_bins = [0] * BINS

    def due(self, index: int) -> int:
        """Due instant of a cycle, computed from the start so that rounding errors do not accumulate."""
        return self.start_ns + round(index * 1e9 / self.rate_hz)

    def shift(self, by_ns: int) -> None:
        self.start_ns += by_ns
        self.due_ns += by_ns

    def run(self, clock: Clock, misses: TaskMisses) -> None:
        begin_ns = clock.now_ns()
        due_ns, first = self.due_ns, self.index
        index = first
        next_ns = self.start_ns + round((index + 1) * 1e9 / self.rate_hz)
        if next_ns <= begin_ns:
            index = max(index, int((begin_ns - self.start_ns) * self.rate_hz / 1e9) - 1)
            while (next_ns := self.due(index + 1)) <= begin_ns:
                index += 1
            self.skipped += index - first
            self.missed += index - first
        self.index, self.due_ns = index + 1, next_ns
        self.function(begin_ns)
        end_ns = clock.now_ns()
        cycles = self.cycles  # below, negative times mean that the clock stepped back meanwhile
        self.cycles = cycles + 1
        jitter_ns = begin_ns - due_ns
        if jitter_ns < 0:
            jitter_ns = 0
        self.jitter_sum_ns += jitter_ns
        if jitter_ns > self.jitter_max_ns or not cycles:
            self.jitter_max_ns, self.worst_start_ns = jitter_ns, begin_ns
        self.jitter_bins[histogram_bin(jitter_ns)] += 1
        run_ns = end_ns - begin_ns
        if run_ns < 0:
            run_ns = 0
        self.run_sum_ns += run_ns
        if run_ns > self.run_max_ns or not cycles:
            self.run_max_ns, self.worst_run_ns = run_ns, begin_ns
        self.run_bins[histogram_bin(run_ns)] += 1
        if end_ns > next_ns or index != first:
            self.missed += end_ns > next_ns
            misses.add(TaskMiss(self.name, first, due_ns, begin_ns, end_ns, index - first))

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
            worst_run_ns=self.worst_run_ns,
            worst_start_ns=self.worst_start_ns,
            start_jitter_histogram=tuple(self.jitter_bins),
            run_histogram=tuple(self.run_bins),
        )


class Executor:
    """Runs functions at fixed rates. The caller waits, and the executor decides which are due.

    Cycle k of a task is due at start + k / rate, whatever happened before. A late task runs once, for the newest due
    cycle. Missed cycles are skipped and counted, and never made up. A clock that jumps ahead has the same effect. When
    the clock steps back, the deadlines step back with it, so that no wait is repeated.

    misses: the missed deadlines.
    steps_back: number of times that the clock stepped back.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.misses = TaskMisses()
        self.steps_back = 0
        self._tasks: list[_Task] = []
        self._urgent: list[_Task] = []
        self._last_ns = clock.now_ns()

    def add(self, name: str, rate_hz: float, function: Callable[[int], None], urgent: bool = False) -> None:
        """Add a task that is first due now. `function` gets the start instant of its cycle.

        Tasks that are due together run in the order of addition. `run_urgent` runs only the urgent ones.
        """
        if not 0.0 < rate_hz <= 1e6:
            raise ValueError(f"task {name}: rate_hz = {rate_hz} is not a rate; use a number above 0 up to 1e6")
        if any(task.name == name for task in self._tasks):
            raise ValueError(f"task {name}: another task has this name; choose another name")
        task = _Task(name, rate_hz, function, self.clock.now_ns())
        self._tasks.append(task)
        if urgent:
            self._urgent.append(task)

    @property
    def next_due_ns(self) -> int | None:
        """Earliest instant at which a task is due, None without tasks."""
        return min([task.due_ns for task in self._tasks], default=None)

    def run_due(self, now_ns: int) -> int:
        """Run each task that is due at now_ns once. now_ns must not be in the future of the executor's clock.

        Return the number of tasks that ran.
        """
        return self._run(self._tasks, now_ns)

    def run_urgent(self, now_ns: int) -> int:
        """Run only the urgent tasks that are due; the others remain due."""
        return self._run(self._urgent, now_ns)

    def _run(self, tasks: list[_Task], now_ns: int) -> int:
        if now_ns < self._last_ns:
            self.steps_back += 1
            for task in self._tasks:
                task.shift(now_ns - self._last_ns)
        self._last_ns = now_ns
        ran = 0
        for task in tasks:
            if task.due_ns <= now_ns:
                task.run(self.clock, self.misses)
                ran += 1
        return ran

    def clock_stepped(self, ahead_ns: int) -> None:
        """Handle a clock that was set ahead. The deadlines move with it, because a clock step is not a late task."""
        self._last_ns += ahead_ns
        for task in self._tasks:
            task.shift(ahead_ns)

    def restart(self, now_ns: int) -> None:
        """Restart all tasks, first due at now_ns, with empty statistics."""
        self._last_ns = now_ns
        self.steps_back = 0
        self.misses.clear()
        for task in self._tasks:
            task.restart(now_ns)

    @property
    def stats(self) -> list[TaskStats]:
        """Statistics of each task, in the order of addition."""
        return [task.stats() for task in self._tasks]


def histogram_bin(duration_ns: int) -> int:
    """Return the bin of a time. Negative times are in the first bin."""
    number = (duration_ns // 1000).bit_length() - 1 if duration_ns >= 2000 else 0
    return number if number < BINS else BINS - 1


def quantile_us(histogram: Sequence[int], share: float, longest_us: int) -> int:
    """Return the quantile `share` of the counted times: the upper edge of its bin.

    It is at most `longest_us`, the longest counted time, and 0 without counts.
    """
    wanted = share * sum(histogram)
    counted = 0
    for number, count in enumerate(histogram):
        counted += count
        if count and counted >= wanted:
            return longest_us if number == BINS - 1 else min(2 << number, longest_us)
    return 0


class TaskMiss(NamedTuple):
    """A cycle that started a period late or later, or ran longer than its period. Times are on the executor's clock."""

    task: str
    cycle: int
    """The due cycle, counted from 0 in periods since the start."""
    due_ns: int
    """Due instant of that cycle."""
    start_ns: int
    """Start of its run."""
    end_ns: int
    """End of its run."""
    skipped: int
    """Later cycles that were due before it started. They are not made up."""


class TaskMisses:
    """Misses that were not drained yet, at most `MOST_KEPT`: the first ones, because they show the cause.

    unreported: number of misses beyond that limit.
    """

    def __init__(self) -> None:
        self.unreported = 0
        self._kept: deque[TaskMiss] = deque()

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, miss: TaskMiss) -> None:
        """Store a miss, if there is room."""
        if len(self._kept) < MOST_KEPT:
            self._kept.append(miss)
        else:
            self.unreported += 1

    def drain(self, most: int) -> list[TaskMiss]:
        """Return the oldest misses, at most `most`."""
        return [self._kept.popleft() for _ in range(min(most, len(self._kept)))]

    def clear(self) -> None:
        """Reset to the initial state."""
        self.unreported = 0
        self._kept.clear()
