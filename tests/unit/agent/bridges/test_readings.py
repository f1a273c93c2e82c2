"""Sensor samples from the host's messages, their date, and which of them are passed on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from datetime import datetime, timezone
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.bridges.ahrs import RATE_WINDOW, RateGauge, SensorLine, SpeedLimit
from agent.bridges.hil import HilMessages
from agent.bridges.injector import Injector
from agent.bridges.json_world import JsonWorld
from agent.bridges.microstrain import MicroStrain7
from agent.bridges.px4 import Px4Injector
from agent.bridges.readings import (
    LARGEST,
    SampleDecimator,
    SensorReadings,
    barometer_sample_from,
    imu_sample_from,
    magnetometer_sample_from,
    receiver_fix_from,
)
from agent.bridges.vectornav import VectorNav, sentence
from agent.navigation.gps_time import SECOND_NS, WEEK_S, GpsTime
from agent.timing.clock import TickClock
from agent.wire import dialect as mav
from agent.wire.codec import Message, Packer
from agent.wire.memory import MemoryTransport, memory_pair

START = datetime(2026, 1, 1, tzinfo=timezone.utc)


def test_a_known_date() -> None:
    """The first second of 2026 UTC: GPS week 2399, Thursday, 18 s later."""
    gps_ns = GpsTime.from_unix_time(START.timestamp(), 5 * SECOND_NS).gps_ns(5 * SECOND_NS)
    week, rest_ns = divmod(gps_ns, WEEK_S * SECOND_NS)
    assert (week, rest_ns) == (2399, (4 * 86_400 + 18) * SECOND_NS)


def test_time_goes_on_with_the_stamps() -> None:
    time = GpsTime.from_unix_time(START.timestamp(), 0)
    assert time.gps_ns(1_234) - time.gps_ns(0) == 1_234


def test_the_year() -> None:
    assert GpsTime.from_unix_time(START.timestamp(), 0).year_at(0) == pytest.approx(2026.0, abs=0.003)  # a day


def test_runs_that_repeat_have_a_date_of_their_own() -> None:
    week, rest_ns = divmod(GpsTime.fixed().gps_ns(0), WEEK_S * SECOND_NS)
    assert (week, rest_ns) == (2371, 0)
    assert GpsTime.fixed().year_at(0) == pytest.approx(2025.452, abs=0.003)


def test_a_board_without_a_date() -> None:
    assert GpsTime.from_unix_time(0.0, 0) == GpsTime.fixed()


MS = 1_000_000
OUTPUTS = ("VNWRG,75,3,2,01,0721", "VNWRG,76,3,8,31,0001,0106,0613", "VNWRG,77,3,80,49,0003,26B8,0018")


def gnss(time_us: int = 0, velocity: Any = (1.0, -2.0, 0.5), h_acc: float = 0.8) -> Message:
    message: Message = mav.MAVLink_xitl_gnss_message(
        time_us, -88_012_345, -639_512_345, 61_230, velocity, h_acc, 1.2, 0.1, 3, 14
    )
    return message


def test_a_fix_in_the_units_of_its_name() -> None:
    fix = receiver_fix_from(gnss(250_000), GpsTime.fixed())
    assert fix is not None
    assert (fix.lat_deg, fix.lon_deg, fix.alt_m) == pytest.approx((-8.8012345, -63.9512345, 61.23))
    assert fix.gps_ns == GpsTime.fixed().zero_ns + 250 * MS
    assert (fix.fix_type, fix.satellites) == (3, 14)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, LARGEST])
def test_what_is_no_number_or_beyond_all_sense_is_no_measurement(bad: float) -> None:
    assert imu_sample_from(mav.MAVLink_xitl_imu_message(0, (0.0, bad, 0.0), (0.0, 0.0, 0.0), 20.0)) is None
    assert imu_sample_from(mav.MAVLink_xitl_imu_message(0, (0.0, 0.0, 0.0), (0.0, 0.0, bad), 20.0)) is None
    assert magnetometer_sample_from(mav.MAVLink_xitl_magnetometer_message(0, (0.0, 0.0, bad))) is None
    assert barometer_sample_from(mav.MAVLink_xitl_barometer_message(0, bad, 20.0)) is None
    assert receiver_fix_from(gnss(velocity=(0.0, 0.0, bad)), GpsTime.fixed()) is None
    assert receiver_fix_from(gnss(h_acc=bad), GpsTime.fixed()) is None
    assert receiver_fix_from(gnss(2**64 - 1), GpsTime.fixed()) is None


def test_what_is_refused_is_counted_and_the_last_good_one_stays() -> None:
    readings = SensorReadings(True, lambda: 0.0)
    assert readings.handle(mav.MAVLink_xitl_magnetometer_message(1, (0.2, 0.0, 0.1)))
    assert not readings.handle(mav.MAVLink_xitl_magnetometer_message(2, (math.nan, 0.0, 0.1)))
    assert not readings.handle(mav.MAVLink_xitl_barometer_message(2, math.nan, 20.0))
    assert readings.handle(gnss(velocity=(math.nan, 0.0, 0.0))) is None
    assert readings.handle(mav.MAVLink_xitl_imu_message(0, (math.nan, 0.0, 0.0), (0.0, 0.0, 0.0), 20.0)) is None
    assert readings.refused == 4
    assert readings.field is not None
    assert readings.field.stamp_ns == 1000


class Vehicle:
    """In place of the autopilot's line: packs what is sent."""

    connected = True
    address = "tcp://there"

    def __init__(self) -> None:
        self._packer = Packer(255, 190)

    def add_tap(self, tap: Callable[[Message], None]) -> None:
        self.tap = tap

    def send(self, *messages: Message) -> bool:
        return all(self._packer.pack(message) for message in messages)

    send_sample = send


def _ways_in() -> Iterator[tuple[Injector, MemoryTransport | None]]:
    for make in (VectorNav, MicroStrain7):
        ours, theirs = memory_pair()
        unit = make(SensorLine(ours))
        yield unit, theirs
    vehicle: Any = Vehicle()
    yield HilMessages(vehicle), None
    yield Px4Injector(vehicle, None), None
    yield JsonWorld("udp://127.0.0.1:0", lambda: None), None


numbers = st.floats(width=32)
stamps = st.one_of(st.integers(0, 400).map(lambda step: step * 5000), st.integers(0, 2**64 - 1))
vectors = st.tuples(numbers, numbers, numbers)
words, bytes_ = st.integers(-(2**31), 2**31 - 1), st.integers(0, 255)
messages = st.one_of(
    st.builds(mav.MAVLink_xitl_imu_message, stamps, vectors, vectors, numbers),
    st.builds(mav.MAVLink_xitl_magnetometer_message, stamps, vectors),
    st.builds(mav.MAVLink_xitl_barometer_message, stamps, numbers, numbers),
    st.builds(
        mav.MAVLink_xitl_gnss_message,
        *(stamps, words, words, words, vectors, numbers, numbers, numbers, bytes_, bytes_),
    ),
    st.builds(
        mav.MAVLink_xitl_truth_message,
        *(stamps, vectors, vectors, st.tuples(numbers, numbers, numbers, numbers), vectors, numbers, numbers),
    ),
    st.builds(
        mav.MAVLink_distance_sensor_message, st.just(0), st.just(20), *[st.integers(0, 65535)] * 2, *[bytes_] * 4
    ),
)


def test_each_message_without_a_valid_measurement_is_counted_once() -> None:
    nothing = mav.MAVLink_xitl_imu_message(1, (math.nan,) * 3, (0.0,) * 3, 20.0)
    for injector, _ in _ways_in():
        injector.reset(TickClock(), False, lambda severity, text: None)
        refused = [injector.counts.refused]
        for _ in range(2):
            injector.handle(nothing, 0)
            injector.serve(0)
            refused.append(injector.counts.refused)
        injector.close()
        assert refused == [0, 1, 2], injector.title


@pytest.mark.medium
@settings(max_examples=60, deadline=None)
@given(st.lists(messages, max_size=40))
def test_whatever_the_host_says_nothing_breaks(said: list[Message]) -> None:
    for injector, theirs in _ways_in():
        injector.reset(TickClock(), False, lambda severity, text: None)
        if theirs is not None:
            for command in OUTPUTS:
                theirs.send(sentence(command))
            injector.serve(0)
        for step, message in enumerate(said):
            injector.handle(message, step * 5 * MS)
            injector.serve(step * 5 * MS)
        injector.close()


@pytest.mark.medium
@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["in", "out", "drop", "hs", "?"]), numbers), max_size=20))
def test_whatever_the_script_says_nothing_breaks(told: list[tuple[str, float]]) -> None:
    vehicle: Any = Vehicle()
    injector = HilMessages(vehicle)
    for name, value in told:
        vehicle.tap(mav.MAVLink_named_value_float_message(0, f"xitl_{name}".encode(), value))
    assert min(injector.counts.script_in, injector.counts.script_out, injector.counts.script_dropped) >= 0


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
