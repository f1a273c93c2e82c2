"""MAVLink with another autopilot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest
from bridged_vehicle import ARMED, BOAT, PLANE, VehicleDouble

from agent.bridges.vehicle_link import VehicleLink
from agent.timing.clock import TickClock
from agent.wire import dialect as mav
from agent.wire.codec import Packer
from agent.wire.tcp import TcpListener
from agent.wire.transport import TransportError
from tests.golden import Golden
from tests.patience import wait_until

S = 1_000_000_000


@pytest.fixture
def double() -> Iterator[VehicleDouble]:
    double = VehicleDouble(system_id=7, component_id=3)
    yield double
    double.close()


class Bench:
    """A link to the double, and what it said and handed on."""

    def __init__(self, url: str, vessel: int | None = None, fleet: bool = False) -> None:
        self.link = VehicleLink(url, vessel=vessel, fleet=fleet)
        self.said: list[tuple[int, str]] = []
        self.tapped: list[Any] = []
        self.passed: list[Any] = []
        self.link.add_tap(self.tapped.append)
        self.link.reset(TickClock(), lambda severity, text: self.said.append((severity, text)))
        self.link.receive(0)  # calls

    def serve(self, now_ns: int, count: int = 1) -> list[Any]:
        """Until so many messages have come."""
        before, new = len(self.tapped), []

        def come() -> bool:
            new.extend(self.link.receive(now_ns))
            return len(self.tapped) - before >= count

        wait_until(come)
        self.passed += new
        return new


@pytest.fixture
def bench(double: VehicleDouble) -> Iterator[Bench]:
    bench = Bench(double.url)
    assert bench.link.wait_for_line(2.0)
    double.link.receive(0.01)  # accepts the call
    yield bench
    bench.link.close()


def test_a_bad_address() -> None:
    with pytest.raises(TransportError, match="unknown scheme"):
        VehicleLink("pigeon://coop")


def test_its_ids_are_those_of_its_heartbeat(double: VehicleDouble, bench: Bench) -> None:
    assert not bench.link.connected
    double.beat(flags=ARMED)
    assert [message.get_type() for message in bench.serve(0)] == ["HEARTBEAT"]
    assert bench.link.connected
    assert bench.link.armed
    order: Any = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 0, 0, 0, 0, 0, 0)
    bench.link.send(order, mav.MAVLink_set_mode_message(1, 0, 4), mav.MAVLink_manual_control_message(1, 0, 0, 0, 0, 0))
    command, mode, sticks = double.hear()
    assert (command.target_system, command.target_component) == (7, 3)
    assert (mode.target_system, sticks.target) == (7, 7)
    assert (command.get_srcSystem(), command.get_srcComponent()) == (255, 190)


@pytest.mark.parametrize(
    ("vessel", "fleet", "said", "beats"),
    [(None, False, 0, 2), (7, False, 0, 2), (7, True, 0, 2), (3, False, 1, 2), (3, True, 1, 5)],
)
def test_one_of_another_number_is_heard_and_told_of_once(
    double: VehicleDouble, vessel: int | None, fleet: bool, said: int, beats: int
) -> None:
    """At once by a vessel that is alone; in a fleet once its own would have been heard."""
    bench = Bench(double.url, vessel, fleet)
    double.link.receive(0.01)
    for second in range(beats):
        assert bench.link.heard == (second >= beats - 1 if fleet and vessel == 3 else second > 0)
        double.beat()
        arrived = bench.link.counters.received
        wait_until(lambda: bench.link.receive(second * S) or bench.link.counters.received > arrived)  # noqa: B023
    bench.link.close()
    assert (bench.link.heard, bench.link.system_id) == (True, 7)
    assert [severity for severity, _ in bench.said] == [4] * said
    assert all("is MAVLink system 7, but this vessel is 3; make both equal" in text for _, text in bench.said)


def test_its_own_autopilot_may_pass_on_the_heartbeats_of_others_first(double: VehicleDouble) -> None:
    """A PX4 that meets the others of its fleet at the ground stations' router does."""
    bench = Bench(double.url, 7, fleet=True)
    double.link.receive(0.01)
    other = Packer(8, 3)
    beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GROUND_ROVER, mav.MAV_AUTOPILOT_PX4, 0, 0, 4, 3)
    place = mav.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 0)
    double.transport.send(other.pack(beat) + other.pack(place))
    double.beat()
    bench.serve(0)
    bench.link.close()
    assert (bench.link.system_id, bench.said) == (7, [])
    assert [message.get_srcSystem() for message in bench.tapped] == [7]


def test_its_own_autopilot_that_comes_late_is_taken_for_another(double: VehicleDouble, golden: Golden) -> None:
    bench = Bench(double.url, 7, fleet=True)
    double.link.receive(0.01)
    beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GROUND_ROVER, mav.MAV_AUTOPILOT_PX4, 0, 0, 4, 3)
    other = Packer(8, 3)
    for second in (0, 1, 2, 3):
        double.transport.send(other.pack(beat))
        wait_until(lambda: bench.link.counters.received > second or bench.link.receive(second * S))  # noqa: B023
    assert bench.link.system_id == 8
    double.beat()
    bench.serve(4 * S)
    assert bench.link.system_id == 7
    double.transport.send(other.pack(beat))
    double.beat()
    bench.serve(5 * S)
    bench.link.close()
    assert bench.link.system_id == 7
    assert [severity for severity, _ in bench.said] == [4, 5]
    golden("message", bench.said[-1][1])


def test_others_on_the_same_line_are_not_heard(double: VehicleDouble, bench: Bench) -> None:
    """A ground station, and another boat whose outputs are not ours."""
    other = Packer(8, 3)
    station = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    double.beat()
    bench.serve(0)
    double.transport.send(other.pack(station))
    double.transport.send(other.pack(mav.MAVLink_servo_output_raw_message(1, 0, *[1900] * 16)))
    double.say(mav.MAVLink_system_time_message(1, 2))
    assert [message.get_type() for message in bench.serve(0)] == ["SYSTEM_TIME"]
    assert [message.get_type() for message in bench.tapped] == ["HEARTBEAT", "SYSTEM_TIME"]


def test_a_heartbeat_once_a_second(double: VehicleDouble, bench: Bench) -> None:
    for now_ns in range(0, 3 * S, S // 10):
        bench.link.update(now_ns)
    beats = wait_until(lambda: double.hear() and double.heard)
    assert [beat.type for beat in beats] == [mav.MAV_TYPE_GCS] * 3


def test_streams_are_asked_for_once_it_is_heard_and_again_after_a_reboot(double: VehicleDouble, bench: Bench) -> None:
    bench.link.update(0)
    assert double.asked_for() == set()
    double.beat()
    double.say(mav.MAVLink_system_time_message(0, 50_000))
    bench.serve(0, 2)
    for _ in range(4):
        bench.link.update(S)
    first = double.asked_for()
    assert mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW in first
    assert mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED in first
    double.say(mav.MAVLink_system_time_message(0, 1_000))
    bench.serve(S)
    for _ in range(4):
        bench.link.update(S)
    assert double.asked_for() == first
    assert bench.link.reboots == 1


def test_a_plane_is_said_once(golden: Golden, double: VehicleDouble, bench: Bench) -> None:
    for _ in range(3):
        double.beat(PLANE)
    bench.serve(0, 3)
    ((severity, text),) = bench.said
    assert severity == 3
    golden("message", text, "MAV_TYPE 1")


@pytest.mark.parametrize("kind", [mav.MAV_TYPE_GROUND_ROVER, BOAT])
def test_a_rover_or_a_boat_is_fine(double: VehicleDouble, bench: Bench, kind: int) -> None:
    double.beat(kind)
    bench.serve(0)
    assert bench.said == []


def test_silence_and_its_end(double: VehicleDouble, bench: Bench) -> None:
    double.beat()
    bench.serve(0)
    for second in range(6):
        bench.link.update(second * S)
    assert bench.said == [(4, f"no MAVLink from the autopilot at {double.url}")]
    assert not bench.link.connected
    double.beat()
    bench.serve(6 * S)
    bench.link.update(6 * S)
    assert bench.said[1:] == [(5, "MAVLink from the autopilot again")]
    assert bench.link.connected


def test_nothing_ever_comes(double: VehicleDouble, bench: Bench) -> None:
    for second in range(10):
        bench.link.update(second * S)
    assert len(bench.said) == 1
    assert bench.said[0][1].startswith(f"nothing arrives from the autopilot's MAVLink at {double.url}; check")


def test_what_comes_is_no_mavlink(double: VehicleDouble, bench: Bench) -> None:
    double.transport.send(b"\n\nInit ArduRover\n" * 3)
    wait_until(lambda: bench.link.receive(0) or bench.link.counters.bytes_in)
    bench.link.update(6 * S)
    assert "not MAVLink 2; set SERIALn_PROTOCOL 2 there" in bench.said[0][1]
    assert bench.link.counters.dropped_noise == 1


def test_nobody_is_there(golden: Golden) -> None:
    gone = VehicleDouble()
    gone.close()
    bench = Bench(gone.url)
    assert not bench.link.wait_for_line(0.05)
    assert not bench.link.line_is_up
    bench.link.update(6 * S)
    golden("message", bench.said[0][1], url=gone.url)
    bench.link.close()


def test_one_that_has_just_started_is_reached_without_the_pause_after_a_failure() -> None:
    before = VehicleDouble()
    before.close()
    bench = Bench(before.url)  # nobody listens yet; the next call of its own is half a second later
    listener = TcpListener(urlsplit(before.url))
    assert bench.link.wait_for_line(0.25)
    bench.link.close()
    listener.close()


def test_its_time_requests_are_answered_here(double: VehicleDouble, bench: Bench) -> None:
    double.beat()
    bench.serve(0)
    double.say(mav.MAVLink_timesync_message(0, 1234), mav.MAVLink_timesync_message(55, 66))
    assert [(message.tc1, message.ts1) for message in bench.serve(7 * S, 2)] == [(55, 66)]
    (answer,) = double.hear()
    assert (answer.tc1, answer.ts1) == (7 * S, 1234)


def test_kinds_that_the_dialect_has_not_are_no_damage(double: VehicleDouble, bench: Bench) -> None:
    double.beat()
    bench.serve(0)
    packer = double.link._packer
    frame = bytearray(packer.pack(mav.MAVLink_system_time_message(1, 2)))
    frame[7:10] = (168).to_bytes(3, "little")  # WIND of ArduPilot; its checksum is not known here
    double.transport.send(bytes(frame))
    double.beat()
    bench.serve(0)
    counters = bench.link.counters
    assert bench.link.passed == 1
    assert (counters.received, counters.lost, counters.dropped) == (2, 0, 0)


def test_a_px4_is_asked_for_its_attitude_more_often_than_an_ardupilot(double: VehicleDouble) -> None:
    """Its streams come each at its own instants, and a position is worth little without an attitude near it."""
    bench = Bench(double.url)
    assert bench.link.wait_for_line(2.0)
    for make, rate_hz in ((mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 10.0), (mav.MAV_AUTOPILOT_PX4, 50.0)):
        bench.link.reset(TickClock(), lambda severity, text: None)
        double.say(mav.MAVLink_heartbeat_message(10, make, 0, 0, 4, 3))
        bench.serve(0)
        double.hear()
        double.heard.clear()
        bench.link.update(0)
        double.hear()
        asked = [m for m in double.heard if m.get_type() == "COMMAND_LONG" and m.command == 511]
        assert {m.param2 for m in asked if m.param1 == mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION} == {1e6 / rate_hz}
    bench.link.close()


def test_streams_of_a_px4_that_nothing_needs_are_slowed_down(double: VehicleDouble) -> None:
    """PX4 sends these 100, 50 and 30 times a second to a companion computer unless it is asked for another rate."""
    bench = Bench(double.url)
    assert bench.link.wait_for_line(2.0)
    bench.link.reset(TickClock(), lambda severity, text: None)
    double.say(mav.MAVLink_heartbeat_message(10, mav.MAV_AUTOPILOT_PX4, 0, 0, 4, 3))
    bench.serve(0)
    for _ in range(6):
        bench.link.update(0)
    double.hear()
    interval_us = {m.param1: m.param2 for m in double.heard if m.get_type() == "COMMAND_LONG" and m.command == 511}
    for number in (mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mav.MAVLINK_MSG_ID_ODOMETRY):
        assert interval_us[number] == 500_000
    bench.link.close()
