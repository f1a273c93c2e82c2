"""Real time on a clock that the test moves: catching up, slipping, and simulation time of any instant."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.timing.deadline import DeadlineWait
from xitl_cli.run.core.pace import Lockstep, Realtime

MS = 1_000_000
S = 1000 * MS
PERIOD_S = 0.0025
PERIOD = round(PERIOD_S * 1e9)
START = 7 * S


class Wall:
    """A monotonic clock; waiting moves it on by as long as was asked for."""

    def __init__(self) -> None:
        self.now_ns = START

    def __call__(self) -> int:
        return self.now_ns

    def idle(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)

    def spin(self, left_ns: int) -> None:
        self.now_ns += left_ns


class Steps:
    """A loop of steps of one period each, worked on in no time."""

    def __init__(self) -> None:
        self.wall = Wall()
        self.pace = Realtime(PERIOD_S, self.wall, DeadlineWait(self.wall, self.wall.spin))
        self.sim_ns = 0

    def run(self, count: int = 1) -> None:
        for _ in range(count):
            self.sim_ns += PERIOD
            self.pace.wait_until(self.sim_ns, self.wall.idle)


@pytest.fixture
def steps() -> Steps:
    return Steps()


def test_steps_come_one_period_apart(steps: Steps) -> None:
    steps.run(401)
    assert steps.wall.now_ns == START + 400 * PERIOD
    task = steps.pace.task(400.0)
    assert (task.cycles, task.missed, steps.pace.slips) == (401, 0, 0)


def test_a_short_stop_is_caught_up_with(steps: Steps) -> None:
    steps.run(100)
    steps.wall.now_ns += 400 * MS
    steps.run(300)
    assert steps.wall.now_ns == START + 399 * PERIOD  # as if nothing had been
    assert steps.pace.slips == 0
    assert steps.pace.task(400.0).missed == 158  # late by 397.5 ms and then by one period less each, until one period


def test_a_long_stop_is_a_slip_and_not_raced_after(steps: Steps) -> None:
    steps.run(100)
    steps.wall.now_ns += 3 * S
    steps.run(301)
    report = steps.pace.report()
    assert report.slips == steps.pace.slips == 1
    assert report.slipped_s == pytest.approx(3.0 - PERIOD_S)
    assert steps.wall.now_ns == START + 99 * PERIOD + 3 * S + 300 * PERIOD  # the rest in real time again
    assert steps.pace.task(400.0).missed == 1


def test_stalls_are_counted_whether_they_are_caught_up_with_or_not(steps: Steps) -> None:
    steps.run(100)
    for stop_ms in (30, 60, 400, 3000):  # the first is as long as an autopilot takes no notice of
        steps.wall.now_ns += stop_ms * MS
        steps.run(400)
    report = steps.pace.report()
    assert (report.slips, report.stalls) == (1, 3)
    assert report.stalled_s == pytest.approx(0.06 + 0.4 + 3.0)
    assert report.longest_stall_s == pytest.approx(3.0)
    assert report.slipped_s == pytest.approx(3.0 - PERIOD_S)


def test_the_world_stands_still_while_the_host_does(steps: Steps) -> None:
    steps.run(100)
    stopped_ns, stopped_sim_ns = steps.wall.now_ns, steps.sim_ns
    steps.wall.now_ns += 3 * S
    steps.run(100)
    sim = steps.pace.sim_of_host
    assert sim(START) == PERIOD
    assert sim(START - PERIOD) == 0
    assert sim(START - S) == 0
    assert sim(stopped_ns) == stopped_sim_ns
    assert sim(stopped_ns + S) == sim(stopped_ns + 2 * S) == stopped_sim_ns + PERIOD
    assert sim(stopped_ns + 3 * S) == stopped_sim_ns + PERIOD
    assert sim(steps.wall.now_ns) == steps.pace.now_sim_ns(0) == steps.sim_ns
    assert sim(steps.wall.now_ns + S // 3) == steps.sim_ns + S // 3


def test_what_is_taken_in_before_the_slip_is_noticed_is_not_from_the_future(steps: Steps) -> None:
    """The host sleeps while it waits for a step, and handles what came meanwhile before it looks at the clock."""
    steps.run(100)
    seen: list[int] = []

    def sleeps(seconds: float) -> None:
        steps.wall.now_ns += 3 * S
        seen.append(steps.pace.now_sim_ns(steps.sim_ns))

    steps.pace.wait_until(steps.sim_ns + PERIOD, sleeps)
    assert seen == [steps.sim_ns + PERIOD]
    assert steps.pace.now_sim_ns(0) == steps.sim_ns + PERIOD


@pytest.mark.medium
@given(st.lists(st.integers(0, 2 * S), min_size=1, max_size=100))
def test_simulation_time_never_runs_back_nor_faster_than_the_clock(stops_ns: list[int]) -> None:
    steps = Steps()
    for stop_ns in stops_ns:
        steps.run(3)
        steps.wall.now_ns += stop_ns
    steps.run()
    times = range(START - S, steps.wall.now_ns, 100 * MS)
    mapped = [steps.pace.sim_of_host(time_ns) for time_ns in times]
    assert all(0 <= after - before <= 100 * MS for before, after in pairwise(mapped))


def test_before_the_first_step_it_is_zero(steps: Steps) -> None:
    assert steps.pace.sim_of_host(START) == 0
    assert steps.pace.now_sim_ns(0) == 0


def test_the_time_base_of_the_steps(steps: Steps) -> None:
    """Even steps: the slope is the period, and nothing varies."""
    steps.run(4001)
    slope = steps.pace.slope(400.0)
    assert slope.mean_s == pytest.approx(PERIOD_S, rel=1e-9)
    assert slope.deviation_s == pytest.approx(0.0, abs=1e-12)
    lockstep = Lockstep()
    for number in range(1, 4):
        lockstep.wait_until(number * PERIOD, steps.wall.idle)
    assert (lockstep.slope(400.0).mean_s, lockstep.slips) == (PERIOD_S, 0)


def test_a_point_of_the_physics_time_base_says_when_the_step_began_and_how_late() -> None:
    """The third step is asked for 4 ms after the second was due: 1.5 ms late."""
    steps = Steps()
    steps.pace.wait_until(PERIOD, steps.wall.idle)
    steps.pace.wait_until(2 * PERIOD, steps.wall.idle)
    steps.wall.now_ns += 4 * MS
    steps.pace.wait_until(3 * PERIOD, steps.wall.idle)
    point = steps.pace.clock(3, 3 * PERIOD)
    assert (point.node, point.sample, point.host_ns, point.node_ns) == ("PS1", 3, steps.wall.now_ns, 3 * PERIOD)
    assert point.residual_s == pytest.approx(-1.5e-3)
    assert point.host_ns * 1e-9 + point.offset_s + point.residual_s == pytest.approx(point.node_ns * 1e-9)
    assert Lockstep().clock(3, 3 * PERIOD) is None
