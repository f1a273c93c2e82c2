"""Periodic tasks on absolute deadlines, and how they kept them."""

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
    """How one task kept its deadlines since the start.

    All times are from the executor's clock: under a TickClock, which stands still while a task runs, run times are 0
    by construction.

    cycles: cycles run. missed: cycles that were skipped, or ended after the next was due. skipped: the skipped ones
    among them. start_jitter: from the instant a cycle was due to its start. worst_run_ns: start of the longest run.
    worst_start_ns: the most delayed start. The histograms are those of `agent.timing.tasks`.
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
    worst_run_ns: int = 0
    worst_start_ns: int = 0
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
        """Instant of a cycle, from the start and not from the cycle before: rounding does not add up."""
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
        cycles = self.cycles  # below, times under 0 are of a clock that stepped back meanwhile
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
    """Runs functions at fixed rates; the caller waits, this one decides what is due.

    Cycle k of a task is due at start + k / rate, whatever happened before. A task that comes late runs once, for the
    newest cycle due; the cycles it slept through are skipped and counted, never made up for. A clock that jumps ahead
    does just that. When it steps back, the deadlines step back with it: nothing is waited for twice.

    misses: the deadlines missed, one by one. steps_back: how often the clock did that.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.misses = TaskMisses()
        self.steps_back = 0
        self._tasks: list[_Task] = []
        self._urgent: list[_Task] = []
        self._last_ns = clock.now_ns()

    def add(self, name: str, rate_hz: float, function: Callable[[int], None], urgent: bool = False) -> None:
        """A task, first due now; `function` gets the instant its cycle starts.

        What is due together runs in the order added. `run_urgent` runs the urgent ones alone.
        """
        if not 0.0 < rate_hz <= 1e6:
            raise ValueError(f"task {name}: rate_hz = {rate_hz} is not a rate; use a number above 0 up to 1e6")
        if any(task.name == name for task in self._tasks):
            raise ValueError(f"task {name}: the name is taken; give each task its own")
        task = _Task(name, rate_hz, function, self.clock.now_ns())
        self._tasks.append(task)
        if urgent:
            self._urgent.append(task)

    @property
    def next_due_ns(self) -> int | None:
        """Earliest instant at which a task is due, None without tasks."""
        return min([task.due_ns for task in self._tasks], default=None)

    def run_due(self, now_ns: int) -> int:
        """Run once each task due at now_ns (an instant of the executor's clock, not in its future).

        Returns how many ran.
        """
        return self._run(self._tasks, now_ns)

    def run_urgent(self, now_ns: int) -> int:
        """The same for the urgent ones; the others stay due."""
        return self._run(self._urgent, now_ns)

    def _run(self, tasks: list[_Task], now_ns: int) -> int:
        if now_ns < self._last_ns:
            self._step_back(now_ns)
        self._last_ns = now_ns
        ran = 0
        for task in tasks:
            if task.due_ns <= now_ns:
                task.run(self.clock, self.misses)
                ran += 1
        return ran

    def _step_back(self, now_ns: int) -> None:
        self.steps_back += 1
        for task in self._tasks:
            task.shift(now_ns - self._last_ns)

    def clock_stepped(self, ahead_ns: int) -> None:
        """The clock was set ahead. The deadlines move with it: a step of the clock is not a late task."""
        self._last_ns += ahead_ns
        for task in self._tasks:
            task.shift(ahead_ns)

    def restart(self, now_ns: int) -> None:
        """All tasks first due at now_ns, with empty statistics."""
        self._last_ns = now_ns
        self.steps_back = 0
        self.misses.clear()
        for task in self._tasks:
            task.restart(now_ns)

    @property
    def stats(self) -> list[TaskStats]:
        """One per task, in the order added."""
        return [task.stats() for task in self._tasks]


def histogram_bin(duration_ns: int) -> int:
    """Which bin a time belongs to; below 0 to the first."""
    number = (duration_ns // 1000).bit_length() - 1 if duration_ns >= 2000 else 0
    return number if number < BINS else BINS - 1


def quantile_us(histogram: Sequence[int], share: float, longest_us: int) -> int:
    """The time that `share` of all counted did not exceed, as far as the bins tell: the upper edge of its bin.

    At most `longest_us`, the longest time counted; 0 when nothing was.
    """
    wanted = share * sum(histogram)
    counted = 0
    for number, count in enumerate(histogram):
        counted += count
        if count and counted >= wanted:
            return longest_us if number == BINS - 1 else min(2 << number, longest_us)
    return 0


class TaskMiss(NamedTuple):
    """A task that came late by a cycle or more, or took longer than it had.

    cycle, due_ns: the cycle that was due, counted from 0 in periods since the start, and when. start_ns, end_ns: of the
    run it got. skipped: cycles that were due after it before it started; they are never made up for. All on the
    executor's clock.
    """

    task: str
    cycle: int
    due_ns: int
    start_ns: int
    end_ns: int
    skipped: int


class TaskMisses:
    """The misses nobody has taken yet, at most `MOST_KEPT`: the first ones, as they tell how it began.

    unreported: misses for which there was no room.
    """

    def __init__(self) -> None:
        self.unreported = 0
        self._kept: deque[TaskMiss] = deque()

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, miss: TaskMiss) -> None:
        """Keep it, if there is room."""
        if len(self._kept) < MOST_KEPT:
            self._kept.append(miss)
        else:
            self.unreported += 1

    def drain(self, most: int) -> list[TaskMiss]:
        """The oldest ones, at most so many."""
        kept = self._kept
        return [kept.popleft() for _ in range(min(most, len(kept)))]

    def clear(self) -> None:
        """As at the start."""
        self.unreported = 0
        self._kept.clear()
