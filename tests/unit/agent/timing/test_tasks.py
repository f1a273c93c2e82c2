"""The executor under a clock that only moves when the test or a task says so."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import pairwise

from agent.timing.clock import SteppedClock, TickClock
from agent.timing.tasks import MOST_KEPT, Executor, TaskMiss

MS = 1_000_000


def spend(clock: TickClock, duration_ns: int) -> None:
    clock.advance_to(clock.now_ns() + duration_ns)


def run_until(executor: Executor, clock: TickClock, end_ns: int, late_ns: int = 0) -> None:
    """Sleep to each deadline, wake `late_ns` after it, run."""
    while (due_ns := executor.next_due_ns) is not None and due_ns < end_ns:
        clock.advance_to(due_ns + late_ns)
        executor.run_due(clock.now_ns())


def test_cycles_are_due_at_start_plus_k_over_rate() -> None:
    clock = TickClock(7)
    executor = Executor(clock)
    starts: list[int] = []
    executor.add("thirty", 30.0, starts.append)
    run_until(executor, clock, 7 + 1000 * MS)
    assert starts == [7 + round(k * 1e9 / 30) for k in range(30)]
    (stats,) = executor.stats
    assert (stats.cycles, stats.missed, stats.start_jitter_max_ns, stats.run_max_ns) == (30, 0, 0, 0)


def test_rounding_does_not_add_up_in_an_hour() -> None:
    clock = TickClock()
    executor = Executor(clock)
    executor.add("thirds", 3.0, lambda now_ns: None)
    run_until(executor, clock, 3600 * 1000 * MS)
    assert executor.next_due_ns == 3600 * 1000 * MS
    assert executor.stats[0].cycles == 3 * 3600


def test_late_wake_ups_are_jitter_and_do_not_shift_the_phase() -> None:
    clock = TickClock()
    executor = Executor(clock)
    executor.add("loop", 100.0, lambda now_ns: None)
    run_until(executor, clock, 1000 * MS, late_ns=3 * MS)
    (stats,) = executor.stats
    assert (stats.cycles, stats.missed) == (100, 0)
    assert stats.start_jitter_max_ns == 3 * MS
    assert stats.start_jitter_mean_ns == 3 * MS


def test_run_times_and_the_worst_instant() -> None:
    clock = TickClock()
    executor = Executor(clock)
    durations_ns = iter([MS, 2 * MS, 4 * MS, MS])
    executor.add("loop", 100.0, lambda now_ns: spend(clock, next(durations_ns)))
    run_until(executor, clock, 40 * MS)
    (stats,) = executor.stats
    assert (stats.run_max_ns, stats.run_mean_ns, stats.worst_run_ns) == (4 * MS, 2 * MS, 20 * MS)
    assert stats.missed == 0


def test_an_overrun_skips_what_it_slept_through() -> None:
    clock = TickClock()
    executor = Executor(clock)
    starts: list[int] = []

    def task(now_ns: int) -> None:
        starts.append(now_ns)
        spend(clock, 35 * MS if len(starts) == 2 else MS)

    executor.add("loop", 100.0, task)
    run_until(executor, clock, 100 * MS)
    # Cycle 1 runs from 10 to 45 ms and is late; 2 and 3 are skipped; 4 starts at 45 ms; 5 is on time again.
    assert [start // MS for start in starts] == [0, 10, 45, 50, 60, 70, 80, 90]
    (stats,) = executor.stats
    assert (stats.cycles, stats.skipped, stats.missed) == (8, 2, 3)
    assert stats.start_jitter_max_ns == 25 * MS  # cycle 2 was due at 20 ms


def test_a_task_that_always_overruns_does_not_pile_up_or_starve_others() -> None:
    clock = TickClock()
    executor = Executor(clock)
    quick: list[int] = []
    executor.add("slow", 100.0, lambda now_ns: spend(clock, 15 * MS))
    executor.add("quick", 50.0, quick.append)
    run_until(executor, clock, 3000 * MS)
    slow = executor.stats[0]
    assert slow.cycles == pytest.approx(200, abs=2)
    assert slow.cycles + slow.skipped == pytest.approx(300, abs=2)
    assert slow.missed == slow.cycles + slow.skipped
    assert len(quick) >= 100
    assert slow.start_jitter_max_ns < 20 * MS


def test_a_long_sleep_costs_one_run() -> None:
    clock = TickClock()
    executor = Executor(clock)
    executor.add("loop", 400.0, lambda now_ns: None)
    clock.advance_to(3600 * 1000 * MS)
    assert executor.run_due(clock.now_ns()) == 1
    (stats,) = executor.stats
    assert (stats.cycles, stats.skipped) == (1, 3600 * 400)
    assert executor.next_due_ns == 3600 * 1000 * MS + 2_500_000


@pytest.mark.medium
@given(
    rate_hz=st.floats(0.1, 5000.0),
    steps_ns=st.lists(st.integers(0, 50 * MS), min_size=1, max_size=60),
)
def test_every_cycle_due_is_run_or_skipped(rate_hz: float, steps_ns: list[int]) -> None:
    clock = TickClock()
    executor = Executor(clock)
    executor.add("loop", rate_hz, lambda now_ns: None)
    for step_ns in steps_ns:
        spend(clock, step_ns)
        executor.run_due(clock.now_ns())
        due_ns = executor.next_due_ns
        assert due_ns is not None
        assert clock.now_ns() < due_ns <= clock.now_ns() + round(1e9 / rate_hz) + 1
        assert executor.run_due(clock.now_ns()) == 0
    (stats,) = executor.stats
    assert executor.next_due_ns == round((stats.cycles + stats.skipped) * 1e9 / rate_hz)
    assert stats.missed == stats.skipped


def test_what_is_due_together_runs_in_the_order_added() -> None:
    clock = TickClock()
    executor = Executor(clock)
    order: list[str] = []
    for name in ("sense", "control", "send"):
        executor.add(name, 50.0, lambda now_ns, name=name: order.append(name))
    executor.run_due(0)
    assert order == ["sense", "control", "send"]


def test_the_worst_start_and_its_instant() -> None:
    clock = TickClock()
    executor = Executor(clock)
    executor.add("loop", 100.0, lambda now_ns: None)
    for late_ns in (MS, 4 * MS, 2 * MS):
        clock.advance_to((executor.next_due_ns or 0) + late_ns)
        executor.run_due(clock.now_ns())
    (stats,) = executor.stats
    assert (stats.start_jitter_max_ns, stats.worst_start_ns) == (4 * MS, 14 * MS)


@pytest.mark.medium
@given(
    late_ns=st.lists(st.integers(0, 9_999_999), min_size=1, max_size=40),
    runs_ns=st.lists(st.integers(0, 400_000_000), min_size=40, max_size=40),
)
def test_histograms_count_each_cycle_where_it_belongs(late_ns: list[int], runs_ns: list[int]) -> None:
    clock = TickClock()
    executor = Executor(clock)
    left_ns = iter(runs_ns)
    executor.add("loop", 100.0, lambda now_ns: spend(clock, next(left_ns)))
    starts: list[int] = []
    for one_ns in late_ns:
        due_ns = executor.next_due_ns
        assert due_ns is not None
        clock.advance_to(due_ns + one_ns)
        starts.append(clock.now_ns() - due_ns)
        executor.run_due(clock.now_ns())
    (stats,) = executor.stats
    assert stats.start_jitter_histogram == counted(starts)
    assert stats.run_histogram == counted(runs_ns[: len(late_ns)])
    assert sum(stats.run_histogram) == stats.cycles


def counted(times_ns: list[int]) -> tuple[int, ...]:
    """By the edges that the dialect documents."""
    edges_us = [0, *(2**k for k in range(1, 16)), math.inf]
    return tuple(sum(low <= time_ns // 1000 < high for time_ns in times_ns) for low, high in pairwise(edges_us))


def test_each_miss_is_told_with_its_instants() -> None:
    clock = TickClock()
    executor = Executor(clock)
    runs: list[int] = []

    def task(now_ns: int) -> None:
        runs.append(now_ns)
        spend(clock, 35 * MS if len(runs) == 2 else MS)

    executor.add("loop", 100.0, task)
    run_until(executor, clock, 100 * MS)
    # Cycle 1 takes from 10 to 45 ms and so ends late; when it is over, 2 and 3 are skipped in favour of 4.
    overrun, skipped = executor.misses.drain(10)
    assert overrun == TaskMiss("loop", cycle=1, due_ns=10 * MS, start_ns=10 * MS, end_ns=45 * MS, skipped=0)
    assert skipped == TaskMiss("loop", cycle=2, due_ns=20 * MS, start_ns=45 * MS, end_ns=46 * MS, skipped=2)
    assert executor.misses.drain(10) == []


@pytest.mark.medium
@given(st.lists(st.tuples(st.integers(0, 60 * MS), st.integers(0, 40 * MS)), min_size=1, max_size=200))
def test_misses_told_and_untold_add_up(steps_ns: list[tuple[int, int]]) -> None:
    clock = TickClock()
    executor = Executor(clock)
    taking_ns = 0
    executor.add("loop", 100.0, lambda now_ns: spend(clock, taking_ns))
    came = 0
    for sleep_ns, one_ns in steps_ns:
        taking_ns = one_ns
        spend(clock, sleep_ns)
        before = executor.stats[0].missed
        executor.run_due(clock.now_ns())
        came += executor.stats[0].missed > before
    told = executor.misses.drain(1000)
    assert len(told) == min(came, MOST_KEPT)
    assert executor.misses.unreported == came - len(told)
    if not executor.misses.unreported:
        # A run that ends after the next is due is one missed deadline, each skipped cycle another.
        late = sum(miss.end_ns > (miss.cycle + miss.skipped + 1) * 10 * MS for miss in told)
        assert executor.stats[0].missed == late + sum(miss.skipped for miss in told)


def test_a_clock_that_steps_back_takes_the_deadlines_along() -> None:
    clock = Settable()
    executor = Executor(clock)
    starts: list[int] = []
    executor.add("loop", 100.0, starts.append)
    for now_ms in (0, 10, 20, 30, 40):
        clock.time_ns = now_ms * MS
        executor.run_due(clock.time_ns)
    clock.time_ns = -5000 * MS  # the next was due 10 ms from now, and still is
    assert executor.run_due(clock.time_ns) == 0
    assert executor.next_due_ns == -4990 * MS
    for _ in range(3):
        clock.time_ns = executor.next_due_ns or 0
        assert executor.run_due(clock.time_ns) == 1
    (stats,) = executor.stats
    assert executor.steps_back == 1
    assert (stats.cycles, stats.skipped, stats.missed) == (8, 0, 0)
    assert starts[-3:] == [-4990 * MS, -4980 * MS, -4970 * MS]


def test_a_step_back_within_a_run_is_no_time() -> None:
    clock = Settable()
    executor = Executor(clock)

    def task(now_ns: int) -> None:
        clock.time_ns -= 3 * MS

    executor.add("loop", 100.0, task)
    executor.run_due(0)
    (stats,) = executor.stats
    assert (stats.run_max_ns, stats.run_mean_ns, stats.missed) == (0, 0.0, 0)
    assert stats.run_histogram[0] == 1


def test_a_clock_that_jumps_ahead_costs_what_was_skipped() -> None:
    inner = Settable()
    clock = SteppedClock(inner)
    executor = Executor(clock)
    executor.add("loop", 50.0, lambda now_ns: None)
    executor.run_due(clock.now_ns())
    inner.time_ns = 10 * MS
    assert clock.disturb(500 * MS, 0.0)
    executor.run_due(clock.now_ns())
    (stats,) = executor.stats
    assert (stats.cycles, stats.skipped) == (2, 24)  # at 510 ms it is cycle 25 that runs
    (miss,) = executor.misses.drain(9)
    assert (miss.cycle, miss.skipped, miss.start_ns) == (1, 24, 510 * MS)


def test_a_step_of_the_clock_that_is_announced_costs_no_cycle() -> None:
    inner = Settable()
    clock = SteppedClock(inner)
    executor = Executor(clock)
    executor.add("loop", 50.0, lambda now_ns: None)
    executor.run_due(clock.now_ns())
    inner.time_ns = 10 * MS
    assert clock.disturb(5_000_000 * MS, 0.0)
    executor.clock_stepped(5_000_000 * MS)
    assert executor.run_due(clock.now_ns()) == 0
    inner.time_ns = 20 * MS
    assert executor.run_due(clock.now_ns()) == 1
    (stats,) = executor.stats
    assert (stats.cycles, stats.missed, stats.skipped, executor.steps_back) == (2, 0, 0, 0)


class Settable:
    """A clock that anything may happen to."""

    time_ns = 0

    def now_ns(self) -> int:
        return self.time_ns


def test_restart_is_a_new_phase_and_empty_statistics() -> None:
    clock = TickClock()
    executor = Executor(clock)
    executor.add("loop", 100.0, lambda now_ns: None)
    run_until(executor, clock, 95 * MS)
    clock.advance_to(1000 * MS)
    executor.run_due(1000 * MS)
    assert len(executor.misses) == 1
    executor.restart(123 * MS)
    assert len(executor.misses) == 0
    assert executor.next_due_ns == 123 * MS
    assert executor.stats[0].cycles == 0


def test_tasks_that_make_no_sense_are_refused() -> None:
    executor = Executor(TickClock())
    assert executor.next_due_ns is None
    for rate_hz in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"task loop: rate_hz = .* is not a rate"):
            executor.add("loop", rate_hz, lambda now_ns: None)
    executor.add("loop", 1.0, lambda now_ns: None)
    with pytest.raises(ValueError, match="task loop: another task has this name"):
        executor.add("loop", 2.0, lambda now_ns: None)
