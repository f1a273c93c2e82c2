"""Latencies and clocks on a link whose delays are known."""

from __future__ import annotations

import random

import pytest

from agent.wire import dialect
from xitl_cli.run.links.link_accounts import LinkTiming, LockstepTiming

MS = 1_000_000
S = 1000 * MS


class Far:
    """An agent 3 s ahead and 80 ppm fast, behind a link of 1 ms each way and up to 2 ms more."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.stepped_ns = 0
        self.timing = LinkTiming("LC", lambda: self.now_ns)
        self.rng = random.Random(5)

    def clock_ns(self) -> int:
        return round(self.now_ns * (1 + 80e-6)) + 3 * S + self.stepped_ns

    def pass_link(self) -> None:
        self.now_ns += round(MS + self.rng.uniform(0.0, 2.0) * MS)

    def exchange(self) -> None:
        request = self.timing.request(0)
        self.pass_link()
        request.t2_ns = request.t3_ns = self.clock_ns()
        self.pass_link()
        clock = self.timing.answered(request)
        assert clock is not None
        assert clock.round_trip_s == pytest.approx(4e-3, abs=2.1e-3)

    def command(self, number: int) -> None:
        """A sample goes there, commands come back at once."""
        stamp_us = number * 10_000
        self.timing.sent([dialect.MAVLink_xitl_imu_message(stamp_us, [0.0] * 3, [0.0] * 3, 20.0)])
        self.pass_link()
        there_us = self.clock_ns() // 1000
        self.pass_link()
        self.timing.arrived(
            dialect.MAVLink_xitl_actuators_message(there_us, stamp_us, there_us, number, [0.0] * 8, 2, 0)
        )


def test_drift_offset_and_time_base_after_a_minute() -> None:
    far = Far()
    for _ in range(10):
        far.exchange()
    far.timing.begin()
    for number in range(600):
        far.now_ns = S + number * 100 * MS
        far.exchange()
    report = far.timing.report()
    assert report.drift_ppm == pytest.approx(80.0, abs=1.0)
    assert report.offset_us is not None
    assert report.offset_us * 1e-6 == pytest.approx((far.clock_ns() - far.now_ns) * 1e-9, abs=100e-6)
    assert report.path_delay_us == pytest.approx(1000, abs=300)
    assert report.residual_us == pytest.approx(2000 / 12**0.5 / 2**0.5, rel=0.1)  # of half the sum of two even jitters
    assert report.slope_s == pytest.approx(0.1 * (1 + 80e-6), abs=2 * 2e-3 / 600)
    assert report.slope_std_s == pytest.approx(2e-3 / 12**0.5 * 2**0.5, rel=0.15)  # between two ends with even jitter
    assert report.drift_std_ppm is not None
    assert report.drift_std_ppm < 10.0  # 100 exchanges in 10 s leave each edge some 2 ms / 100 open
    assert report.steps == 0


def test_how_long_samples_and_commands_took() -> None:
    far = Far()
    for number in range(300):
        far.now_ns = number * 100 * MS
        far.exchange()
    for number in range(100):
        far.now_ns += 10 * MS
        far.command(number)
    far.timing.settle()
    for histogram in (far.timing.sensors, far.timing.actuators):
        assert histogram.count == 100
        assert histogram.quantile_ns(0.5) == pytest.approx(2 * MS, abs=0.3 * MS)
        assert histogram.max_ns == pytest.approx(3 * MS, abs=0.3 * MS)


def test_before_the_first_exchange_nothing_is_told() -> None:
    timing = LinkTiming("LC")
    assert timing.host_ns(5) is None
    assert timing.report().offset_us is None


def test_in_lockstep_both_ends_read_one_clock() -> None:
    timing = LockstepTiming("LC")
    for tick in range(1, 51):
        timing.arrived(dialect.MAVLink_xitl_actuators_message(tick * 20_000, 0, 0, tick, [0.0] * 8, 2, 0))
    report = timing.report()
    assert (report.offset_us, report.drift_ppm) == (0.0, 0.0)
    assert report.slope_s == pytest.approx(0.02)
    assert report.slope_std_s == pytest.approx(0.0, abs=1e-12)
    assert timing.host_ns(7) == 7


def test_a_step_of_the_clock_spoils_neither_latencies_nor_slope() -> None:
    """The clock steps by 0.5 s half way. Latencies stay at most 3 ms, and the slope of 0.1 s that of the smooth part.

    Both are off by no more than what the relation is right after the step, when ten exchanges make it: some 2 ms.
    """
    far = Far()
    far.timing.begin()
    for number in range(400):
        far.now_ns = S + number * 100 * MS
        far.stepped_ns = 500 * MS if number >= 200 else 0
        far.exchange()
        far.command(number)
    report = far.timing.report()
    assert report.steps == 1
    assert report.slope_s == pytest.approx(0.1 * (1 + 80e-6), abs=2 * 2e-3 / 190)
    assert report.slope_std_s is not None
    assert report.slope_std_s < 2e-3
    for histogram in (far.timing.sensors, far.timing.actuators):
        assert 380 < histogram.count < 400
        assert histogram.max_ns < 5 * MS
