"""Thinning out a sensor, and measuring how often it comes."""

from __future__ import annotations

import pytest

from agent.bridges.ahrs import RATE_WINDOW, RateGauge, SpeedLimit
from agent.bridges.readings import SampleDecimator

MS = 1_000_000


def passed(period_ns: int, stamps_ns: list[int]) -> list[int]:
    pace = SampleDecimator(period_ns)
    return [stamp_ns for stamp_ns in stamps_ns if pace.is_due(stamp_ns)]


def test_all_of_them() -> None:
    stamps = list(range(0, 50 * MS, 5 * MS))
    assert passed(0, stamps) == stamps
    assert passed(5 * MS, stamps) == stamps


def test_every_other_one() -> None:
    assert passed(5 * MS, [2_500_000 * n for n in range(8)]) == [0, 5 * MS, 10 * MS, 15 * MS]


def test_a_slower_sensor_loses_none() -> None:
    stamps = [8 * MS * n for n in range(10)]
    assert passed(5 * MS, stamps) == stamps


def test_rounded_stamps_lose_none() -> None:
    stamps = [3_333_000 * n for n in range(30)]
    assert passed(3_333_333, stamps) == stamps


def test_a_rate_that_does_not_divide_is_met_on_average() -> None:
    assert len(passed(5 * MS, [3 * MS * n for n in range(1000)])) == pytest.approx(600, abs=2)


def test_after_a_gap_or_a_step_back_it_begins_anew() -> None:
    assert passed(10 * MS, [0, 5 * MS, 100 * MS, 105 * MS, 110 * MS]) == [0, 100 * MS, 110 * MS]
    assert passed(10 * MS, [100 * MS, 0, 5 * MS, 10 * MS]) == [100 * MS, 0, 10 * MS]


def test_the_rate() -> None:
    gauge = RateGauge()
    found = [gauge.add(5 * MS * n) for n in range(3 * RATE_WINDOW)]
    assert [rate for rate in found if rate is not None] == pytest.approx(2 * [200.0])


class Wall:
    """A clock that goes on when somebody waits."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.waited_s = 0.0

    def clock_s(self) -> float:
        return self.now_s

    def wait(self, duration_s: float) -> None:
        self.now_s += duration_s
        self.waited_s += duration_s


def test_a_run_is_held_back() -> None:
    wall = Wall()
    limit = SpeedLimit(8.0, wall.clock_s, wall.wait)
    for tick in range(801):
        limit.hold(tick * 10 * MS)
    assert wall.now_s == pytest.approx(101.0)


def test_a_run_that_is_slow_by_itself_is_not_held_back() -> None:
    wall = Wall()
    limit = SpeedLimit(8.0, wall.clock_s, wall.wait)
    for tick in range(100):
        wall.now_s += 0.002
        limit.hold(tick * 10 * MS)
    assert wall.waited_s == 0.0


def test_what_was_lost_is_not_caught_up() -> None:
    wall = Wall()
    limit = SpeedLimit(8.0, wall.clock_s, wall.wait)
    limit.hold(0)
    wall.now_s += 10.0
    limit.hold(10 * MS)
    assert wall.waited_s == 0.0
    limit.hold(20 * MS)
    assert wall.waited_s == pytest.approx(0.00125)


def test_a_long_step_is_waited_for_half_a_second() -> None:
    wall = Wall()
    limit = SpeedLimit(8.0, wall.clock_s, wall.wait)
    limit.hold(0)
    limit.hold(3600_000 * MS)
    assert wall.waited_s == 0.5
