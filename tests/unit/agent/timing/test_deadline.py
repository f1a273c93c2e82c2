"""Waits for deadlines on a clock that the test moves, and the collector of garbage around them."""

from __future__ import annotations

import gc
import time

import pytest

from agent.timing import deadline
from agent.timing.deadline import FULL_EVERY_NS, OVERDUE_NS, SPIN_NS, DeadlineWait, absolute_sleep

MS = 1_000_000


class Wall:
    """A clock; idling and spinning move it on."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.idled_s: list[float] = []
        self.spun_ns: list[int] = []

    def __call__(self) -> int:
        return self.now_ns

    def idle(self, seconds: float) -> None:
        self.idled_s.append(seconds)
        self.now_ns += round(seconds * 1e9)

    def spin(self, left_ns: int) -> None:
        self.spun_ns.append(left_ns)
        self.now_ns += left_ns


@pytest.fixture
def wall() -> Wall:
    return Wall()


@pytest.fixture
def wait(wall: Wall) -> DeadlineWait:
    return DeadlineWait(wall, wall.spin)


@pytest.fixture
def collected(monkeypatch: pytest.MonkeyPatch, wall: Wall) -> list[int]:
    """Generations that were collected in the test; a collection takes as many milliseconds as its generation."""
    generations: list[int] = []

    def collect(generation: int = 2) -> int:
        generations.append(generation)
        wall.now_ns += generation * MS
        return 0

    monkeypatch.setattr(deadline.gc, "collect", collect)
    return generations


def due_in(wait: DeadlineWait, wall: Wall, left_ns: int) -> None:
    due_ns = wall.now_ns + left_ns
    while wall.now_ns < due_ns:
        wait.until(due_ns - wall.now_ns, wall.idle)


def test_the_last_moments_are_spun_and_the_rest_is_idle(wait: DeadlineWait, wall: Wall) -> None:
    due_in(wait, wall, 2 * MS)
    assert wall.idled_s == [pytest.approx((2 * MS - SPIN_NS) * 1e-9)]
    assert wall.spun_ns == [SPIN_NS]
    assert wall.now_ns == 2 * MS


def test_until_tells_whether_the_deadline_is_reached(wait: DeadlineWait, wall: Wall) -> None:
    assert not wait.until(2 * SPIN_NS, wall.idle)
    assert wait.until(SPIN_NS, wall.idle)
    assert len(wall.idled_s) == 1


@pytest.mark.medium
def test_python_collects_by_itself_again_afterwards(wait: DeadlineWait) -> None:
    with wait.deferred():
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
        wait.defer(False)
        assert gc.isenabled()
        wait.defer(True)
        assert not gc.isenabled()
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


@pytest.mark.medium
def test_a_collector_that_was_off_stays_off(wait: DeadlineWait) -> None:
    gc.disable()
    try:
        with wait.deferred():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


@pytest.mark.medium
def test_an_error_ends_it_too(wait: DeadlineWait) -> None:
    with pytest.raises(RuntimeError), wait.deferred():
        raise RuntimeError
    assert gc.isenabled()


def test_all_objects_are_collected_in_a_wait_that_is_long_enough(
    wait: DeadlineWait, wall: Wall, collected: list[int]
) -> None:
    with wait.deferred():
        collected.clear()
        wall.now_ns += FULL_EVERY_NS
        due_in(wait, wall, 3 * MS)
        assert collected == [2]
        due_in(wait, wall, 3 * MS)
        assert collected == [2]
        wall.now_ns += FULL_EVERY_NS
        due_in(wait, wall, 3 * MS)  # the last one took 2 ms
        assert collected == [2]
        due_in(wait, wall, 5 * MS)
        assert collected == [2, 2]


def test_a_loop_without_slack_collects_now_and_then(wait: DeadlineWait, wall: Wall, collected: list[int]) -> None:
    with wait.deferred():
        collected.clear()
        wall.now_ns += FULL_EVERY_NS
        due_in(wait, wall, 2 * SPIN_NS)
        assert collected == []
        wall.now_ns += OVERDUE_NS
        due_in(wait, wall, 2 * SPIN_NS)
        assert collected == [2]


def test_a_loop_that_is_always_late_collects_now_and_then(wait: DeadlineWait, wall: Wall, collected: list[int]) -> None:
    wait.missed()
    with wait.deferred():
        collected.clear()
        for _ in range(5):
            wall.now_ns += OVERDUE_NS // 2
            wait.missed()
        assert collected == [2, 2]


def test_young_objects_are_collected_when_there_are_many(
    wait: DeadlineWait, wall: Wall, collected: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    with wait.deferred():
        collected.clear()
        monkeypatch.setattr(deadline.gc, "get_count", lambda: (10, 0, 0))
        due_in(wait, wall, 3 * MS)
        assert collected == []
        monkeypatch.setattr(deadline.gc, "get_count", lambda: (5000, 0, 0))
        due_in(wait, wall, 2 * SPIN_NS)
        assert collected == []
        due_in(wait, wall, 3 * MS)
        assert collected == [1]


def test_nothing_is_collected_while_python_does(wait: DeadlineWait, wall: Wall, collected: list[int]) -> None:
    wall.now_ns += FULL_EVERY_NS
    due_in(wait, wall, 10 * MS)
    assert collected == []


@pytest.mark.medium
def test_a_cycle_of_garbage_goes_in_a_long_wait() -> None:
    class Node:
        pass

    clock = Wall()
    wait = DeadlineWait(clock, clock.spin)
    with wait.deferred():
        for _ in range(2000):
            node = Node()
            node.itself = node  # type: ignore[attr-defined]
        before = len(gc.get_objects())
        due_in(wait, clock, 10 * MS)
        assert len(gc.get_objects()) < before - 1500


def test_absolute_sleep_ends_after_its_instant() -> None:
    sleep_until = absolute_sleep()
    if sleep_until is None:
        pytest.skip("this system has no clock_nanosleep")
    due_ns = time.monotonic_ns() + 2 * MS
    sleep_until(due_ns)
    assert time.monotonic_ns() >= due_ns
    sleep_until(due_ns)  # one that is past


@pytest.mark.medium
def test_the_slack_of_timers_is_set_and_put_back(wait: DeadlineWait) -> None:
    before_ns = deadline.timer_slack_ns()
    with wait.deferred():
        inside_ns = deadline.timer_slack_ns()
    assert deadline.timer_slack_ns() == before_ns
    assert inside_ns in (0, 1)  # 0: the system does not say, or the thread is one of real time
