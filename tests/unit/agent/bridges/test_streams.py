"""Which messages are asked for, and when again."""

from __future__ import annotations

from typing import Any

from agent.bridges.vehicle_link import A_CYCLE, ASKS, OUTPUTS_HZ, RATES_HZ, SPARE_OUTPUTS_HZ, StreamRequests
from agent.wire import dialect as mav

S = 1_000_000_000
SERVO = mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW
VERSION = mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION
WANTED = {*RATES_HZ, SERVO, VERSION}


def asked(streams: StreamRequests, now_ns: int, cycles: int = 6) -> dict[int, float]:
    """Interval in us by message."""
    found = {}
    for _ in range(cycles):
        requests = streams.poll(now_ns)
        assert len(requests) <= A_CYCLE
        found.update({int(request.param1): request.param2 for request in requests})
    return found


def see(streams: StreamRequests, now_ns: int, outputs: int = 50) -> None:
    """A second's worth: all kinds, and so many sets of outputs."""
    for number in WANTED - {SERVO}:
        streams.note_arrival(number, now_ns)
    for _ in range(outputs):
        streams.note_arrival(SERVO, now_ns)


def ack(command: int) -> Any:
    return mav.MAVLink_command_ack_message(command, 0)


def test_all_are_asked_for_once() -> None:
    streams = StreamRequests(outputs_wanted=True)
    found = asked(streams, 0)
    assert set(found) == WANTED
    assert found[SERVO] == 1e6 / OUTPUTS_HZ[0]
    assert asked(streams, S) == {}
    assert asked(StreamRequests(outputs_wanted=False), 0)[SERVO] == 1e6 / SPARE_OUTPUTS_HZ[0]


def test_what_comes_is_not_asked_for_again() -> None:
    streams = StreamRequests(True)
    asked(streams, 0)
    for second in range(1, 60):
        see(streams, second * S)
        assert asked(streams, second * S) == {}


def test_outputs_that_come_at_1_hz_are_asked_for_at_the_next_lower_rate() -> None:
    """ArduPilot refuses a rate above 0.8 of its loop rate, says so in a text and falls back to 1 Hz."""
    streams = StreamRequests(True)
    asked(streams, 0)
    asks: list[float] = []
    for second in range(1, 30):
        slow = not asks  # at 40 Hz it does as asked
        see(streams, second * S, 1 if slow else 40)
        asks += [interval_us for number, interval_us in asked(streams, second * S).items() if number == SERVO]
    assert asks == [1e6 / OUTPUTS_HZ[1]]


def test_what_stays_away_is_asked_for_again_and_then_seldom() -> None:
    streams = StreamRequests(True)
    asks = [at for at in range(0, 120) if SERVO in asked(streams, at * S)]
    assert asks[:ASKS] == [0, 3, 6, 9]
    assert asks[ASKS:] == list(range(29, 120, 20))


def test_what_stops_is_asked_for_again_but_the_version() -> None:
    streams = StreamRequests(True)
    asked(streams, 0)
    see(streams, S)
    assert set(asked(streams, 5 * S)) == WANTED - {VERSION}


def test_after_a_restart_all_are_asked_for() -> None:
    streams = StreamRequests(True)
    asked(streams, 0)
    see(streams, S)
    streams.reset()
    assert set(asked(streams, S)) == WANTED


def test_own_acknowledgements_are_kept_from_the_host() -> None:
    streams = StreamRequests(True)
    mine = mav.MAV_CMD_SET_MESSAGE_INTERVAL
    assert not streams.is_own_acknowledgement(ack(mine), 0)
    count = len([number for number in asked(streams, 0) if number != VERSION])
    assert all(streams.is_own_acknowledgement(ack(mine), S) for _ in range(count))
    assert not streams.is_own_acknowledgement(ack(mine), S)
    assert streams.is_own_acknowledgement(ack(mav.MAV_CMD_REQUEST_MESSAGE), S)
    assert not streams.is_own_acknowledgement(ack(mav.MAV_CMD_COMPONENT_ARM_DISARM), S)


def test_an_answer_that_never_came_does_not_cost_the_host_its_own() -> None:
    streams = StreamRequests(True)
    asked(streams, 0)
    assert not streams.is_own_acknowledgement(ack(mav.MAV_CMD_SET_MESSAGE_INTERVAL), 10 * S)


def test_a_kind_that_the_autopilot_does_not_have_is_left_out() -> None:
    streams = StreamRequests(True)
    streams.leave_out(mav.MAVLINK_MSG_ID_FENCE_STATUS)
    streams.reset()
    assert set(asked(streams, 0)) == WANTED - {mav.MAVLINK_MSG_ID_FENCE_STATUS}
