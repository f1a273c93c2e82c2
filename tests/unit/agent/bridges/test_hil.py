"""Our sensors as HIL messages: what goes out is read by pymavlink, what the script says comes in as it packs it."""

from __future__ import annotations

import math
import os
import tty
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as public

from agent.bridges.hil import ABSENT_NS, SILENT_NS, HilMessages
from agent.bridges.injector import InjectorError
from agent.bridges.vehicle_link import SAMPLES_WAITING, VehicleLink
from agent.navigation.gps_time import EPOCH_UNIX_S, LEAP_S, START_OF_RUNS_S
from agent.timing.clock import TickClock
from agent.wire import dialect as mav
from agent.wire.codec import Message, Packer
from tests.golden import Golden

MS, SECOND = 1_000_000, 1_000_000_000
FIELD, ACCEL, GYRO = (0.21, -0.02, 0.05), (0.25, -0.5, -9.75), (0.125, -0.0625, 0.75)


class Line:
    """In place of the vehicle's: keeps what is sent as pymavlink reads it."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.connected = True
        self.full = False
        self.tap: Callable[[Message], None] = lambda message: None
        self._packer, self._reader = Packer(255, 190), public.MAVLink(None)

    def add_tap(self, tap: Callable[[Message], None]) -> None:
        self.tap = tap

    def send(self, *messages: Message) -> bool:
        if not self.full:
            for message in messages:
                self.sent += self._reader.parse_buffer(bytearray(self._packer.pack(message)))
        return not self.full

    send_sample = send

    def of(self, name: str) -> list[Any]:
        return [message for message in self.sent if message.get_type() == name]


class Bridge:
    """The injector in a run, fed as by a host."""

    def __init__(self, lockstep: bool = True, unix_s: float = 1.79e9) -> None:
        self.line = Line()
        self.said: list[tuple[int, str]] = []
        self.injector = HilMessages(self.line, lambda: unix_s)  # type: ignore[arg-type]
        self.begin(lockstep)

    def begin(self, lockstep: bool = True) -> None:
        self.clock = TickClock()
        self.injector.reset(self.clock, lockstep, lambda severity, text: self.said.append((severity, text)))

    def take(self, message: Message, now_ns: int) -> None:
        self.clock.advance_to(now_ns)
        self.injector.handle(message, now_ns)
        self.injector.serve(now_ns)

    def imu(self, at_ns: int, accel: tuple[float, ...] = ACCEL, gyro: tuple[float, ...] = GYRO) -> None:
        self.take(mav.MAVLink_xitl_imu_message(at_ns // 1000, list(gyro), list(accel), 21.5), at_ns)

    def field(self, at_ns: int, field: tuple[float, ...] = FIELD) -> None:
        self.take(mav.MAVLink_xitl_magnetometer_message(at_ns // 1000, list(field)), at_ns)

    def pressure(self, at_ns: int) -> None:
        self.take(mav.MAVLink_xitl_barometer_message(at_ns // 1000, 100_650.0, 24.5), at_ns)

    def fix(self, at_ns: int, velocity: tuple[float, ...] = (3.1, -0.45, 0.03)) -> None:
        message = mav.MAVLink_xitl_gnss_message(
            at_ns // 1000, -88_012_345, -639_512_345, 61_230, list(velocity), 0.81, 1.22, 0.1, 3, 14
        )
        self.take(message, at_ns)

    def script(self, at_ns: int, **told: float) -> None:
        self.clock.advance_to(at_ns)
        for name, value in told.items():
            self.line.tap(mav.MAVLink_named_value_float_message(0, f"xitl_{name}".encode(), value))
        self.injector.serve(at_ns)


@pytest.fixture
def bridge() -> Bridge:
    return Bridge()


def test_a_sample_goes_out_with_the_newest_of_the_others(bridge: Bridge) -> None:
    bridge.field(1 * MS)
    bridge.pressure(2 * MS)
    bridge.imu(5 * MS)
    (message,) = bridge.line.of("HIL_SENSOR")
    assert message.time_usec == 5000
    assert (message.xacc, message.yacc, message.zacc) == ACCEL
    assert (message.xgyro, message.ygyro, message.zgyro) == GYRO
    assert (message.xmag, message.ymag, message.zmag) == pytest.approx(FIELD, rel=1e-6)
    assert (message.abs_pressure, message.temperature) == pytest.approx((1006.5, 24.5), rel=1e-6)
    assert bridge.injector.counts.imu_out == 1


def test_only_what_is_new_counts_as_updated(bridge: Bridge) -> None:
    accel_and_gyro = 0b111111
    bridge.field(0)
    bridge.pressure(0)
    bridge.imu(5 * MS)
    bridge.imu(10 * MS)
    bridge.field(12 * MS)
    bridge.imu(15 * MS)
    updated = [message.fields_updated for message in bridge.line.of("HIL_SENSOR")]
    assert updated == [accel_and_gyro | 0b111 << 6 | 0b1101 << 9, accel_and_gyro, accel_and_gyro | 0b111 << 6]


def test_a_sensor_that_is_not_there_is_waited_for_a_second(bridge: Bridge) -> None:
    bridge.field(0)
    for at_ns in range(5 * MS, ABSENT_NS + 20 * MS, 5 * MS):
        bridge.imu(at_ns)
    messages = bridge.line.of("HIL_SENSOR")
    assert [message.time_usec for message in messages] == [1_010_000, 1_015_000]
    assert all(not message.fields_updated & 1 << 9 for message in messages)
    assert messages[0].abs_pressure == pytest.approx(1013.25)


def test_a_fix_in_the_units_of_the_message(bridge: Bridge) -> None:
    bridge.imu(0)
    bridge.fix(200 * MS)
    (message,) = bridge.line.of("HIL_GPS")
    assert (message.fix_type, message.satellites_visible) == (3, 14)
    assert (message.lat, message.lon, message.alt) == (-88_012_345, -639_512_345, 61_230)
    assert (message.eph, message.epv) == (81, 122)
    assert (message.vn, message.ve, message.vd, message.vel) == (310, -45, 3, round(100 * math.hypot(3.1, 0.45)))
    assert message.cog == pytest.approx(100 * (360 - math.degrees(math.atan(0.45 / 3.1))), abs=1)


def test_the_date_is_this_machine_s_and_in_lockstep_always_the_same() -> None:
    for lockstep, unix_s in ((False, 1.79e9), (True, START_OF_RUNS_S + EPOCH_UNIX_S - LEAP_S)):
        bridge = Bridge(lockstep)
        bridge.imu(0)
        bridge.fix(SECOND)
        assert bridge.line.of("HIL_GPS")[0].time_usec == pytest.approx((unix_s + 1.0) * 1e6, abs=1)


@pytest.mark.medium
def test_the_solution_of_our_own_estimator_follows_once_it_has_a_place(bridge: Bridge) -> None:
    """At rest, level, heading north in a field that points there."""
    for step in range(2400):
        at_ns = step * 5 * MS
        if step % 4 == 0:
            bridge.field(at_ns, (0.25, 0.0, 0.1))
            bridge.pressure(at_ns)
        if step % 40 == 0:
            bridge.fix(at_ns, (0.0, 0.0, 0.0))
        bridge.imu(at_ns, (0.0, 0.0, -9.783), (0.0, 0.0, 0.0))
    states = bridge.line.of("HIL_STATE_QUATERNION")
    seconds = (states[-1].time_usec - states[0].time_usec) * 1e-6
    assert len(states) == bridge.injector.counts.solution_out == pytest.approx(20.0 * seconds + 1, abs=1)
    last = states[-1]
    assert (last.lat, last.lon) == pytest.approx((-88_012_345, -639_512_345), abs=5)
    assert last.alt == pytest.approx(61_230, abs=200)
    w, x, y, z = last.attitude_quaternion
    assert (x, y) == pytest.approx((0.0, 0.0), abs=0.01)
    assert abs(math.degrees(2.0 * math.atan2(z, w))) < 30.0  # the declination of the place


def test_what_the_line_does_not_take_is_counted(bridge: Bridge) -> None:
    bridge.field(0)
    bridge.pressure(0)
    bridge.line.full = True
    bridge.imu(5 * MS)
    bridge.fix(6 * MS)
    counts = bridge.injector.counts
    assert (counts.imu_out, counts.gnss_out, counts.unsent) == (0, 0, 2)


def test_a_slow_line_makes_samples_few_and_not_late() -> None:
    """What waits for the line stays little; an order waits behind no more than that."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    vehicle = VehicleLink(f"serial://{os.ttyname(theirs)}?baud=9600")
    injector = HilMessages(vehicle)
    injector.reset(TickClock(), False, lambda severity, text: None)
    injector.handle(mav.MAVLink_xitl_magnetometer_message(0, FIELD), 0)
    injector.handle(mav.MAVLink_xitl_barometer_message(0, 100_650.0, 24.5), 0)
    for step in range(1, 101):
        injector.handle(mav.MAVLink_xitl_imu_message(step * 5000, GYRO, ACCEL, 21.5), step * 5 * MS)
    counts = injector.counts
    assert counts.imu_out + counts.unsent == 100
    assert vehicle._link.waiting <= SAMPLES_WAITING
    assert counts.imu_out < 20
    assert vehicle.send(mav.MAVLink_system_time_message(1, 2))
    vehicle.close()
    os.close(ours)
    os.close(theirs)


def test_extreme_values_fit_the_message(bridge: Bridge) -> None:
    bridge.imu(0)
    message = mav.MAVLink_xitl_gnss_message(0, 0, 0, 0, [400.0, -400.0, 0.0], 900.0, 900.0, 0.1, 0, 0)
    bridge.take(message, MS)
    (sent,) = bridge.line.of("HIL_GPS")
    assert (sent.vn, sent.ve, sent.eph) == (32767, -32768, 65534)


# The script


def test_counters_of_the_script_count_from_the_run_on(bridge: Bridge) -> None:
    counts = bridge.injector.counts
    bridge.imu(0)
    bridge.script(SECOND, **{"in": 5000, "out": 4990, "drop": 10, "hs": 1, "gap": 12})
    assert (counts.script_in, counts.script_answers, counts.taken) == (0, True, True)
    bridge.script(2 * SECOND, **{"in": 5200, "out": 5187, "drop": 13})
    assert (counts.script_in, counts.script_out, counts.script_dropped) == (200, 197, 3)
    bridge.begin()
    bridge.imu(0)
    bridge.script(SECOND, **{"in": 5300, "out": 5287})
    assert (bridge.injector.counts.script_in, bridge.injector.counts.script_out) == (100, 100)


def test_a_script_that_starts_anew_is_noticed(bridge: Bridge) -> None:
    bridge.imu(0)
    bridge.script(SECOND, **{"in": 5000, "out": 5000})
    bridge.script(2 * SECOND, **{"in": 40, "out": 30, "drop": 10, "hs": 0})
    counts = bridge.injector.counts
    assert (counts.restarts, counts.script_in, counts.script_dropped, counts.taken) == (1, 40, 10, False)


def test_a_script_that_starts_in_the_run_is_counted_from_its_start(bridge: Bridge) -> None:
    """It cannot have taken what was sent to it before, so that no more than was sent is all from this run."""
    bridge.field(0)
    bridge.pressure(0)
    for step in range(1, 201):
        bridge.imu(step * 5 * MS)
    bridge.script(SECOND, **{"in": 195, "out": 190, "drop": 5})
    counts = bridge.injector.counts
    assert (counts.imu_out, counts.script_in, counts.script_out, counts.script_dropped) == (200, 195, 190, 5)
    assert counts.restarts == 0


def test_what_the_script_counted_before_it_started_anew_stays_counted(bridge: Bridge) -> None:
    bridge.imu(0)
    bridge.script(SECOND, **{"in": 5000, "out": 5000, "drop": 7})
    bridge.script(2 * SECOND, **{"in": 5200, "out": 5190, "drop": 17})
    bridge.script(3 * SECOND, **{"in": 40, "out": 30, "drop": 10})
    counts = bridge.injector.counts
    assert (counts.script_in, counts.script_out, counts.script_dropped) == (240, 220, 20)


def test_a_count_that_is_no_number_is_passed_over(bridge: Bridge) -> None:
    bridge.imu(0)
    bridge.script(SECOND, **{"in": math.nan, "out": math.inf})
    assert not bridge.injector.counts.script_answers


def test_a_silent_script_is_said_once_and_again_when_it_is_heard(bridge: Bridge, golden: Golden) -> None:
    for at_ns in range(0, 3 * SILENT_NS, 100 * MS):
        bridge.imu(at_ns)
    (said,) = bridge.said
    assert said[0] == 4
    golden("message", said[1])
    assert not bridge.injector.counts.script_answers
    bridge.script(3 * SILENT_NS, **{"in": 1, "hs": 1})
    assert bridge.said[1] == (5, "the script on the autopilot answers")
    bridge.imu(4 * SILENT_NS + SECOND)
    assert len(bridge.said) == 3


def test_without_an_autopilot_or_sensors_nothing_is_said_of_the_script(bridge: Bridge) -> None:
    bridge.injector.serve(10 * SILENT_NS)
    bridge.line.connected = False
    bridge.imu(11 * SILENT_NS)
    bridge.injector.serve(20 * SILENT_NS)
    assert bridge.said == []


def test_numbers_of_others_are_passed_over(bridge: Bridge) -> None:
    bridge.imu(0)
    bridge.line.tap(mav.MAVLink_named_value_float_message(0, b"depth", 3.0))
    bridge.line.tap(mav.MAVLink_heartbeat_message(11, 3, 0, 0, 3, 3))
    bridge.injector.serve(MS)
    assert not bridge.injector.counts.script_answers


def test_it_has_no_link_of_its_own() -> None:
    with pytest.raises(InjectorError, match="go over the autopilot's own link"):
        HilMessages.open("tcp://127.0.0.1:1", Line())  # type: ignore[arg-type]
