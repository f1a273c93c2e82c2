"""The mission protocol as a ground station meets it: order, losses, duplicates, time-outs, refusals."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.vehicle.autopilot import Autopilot
from agent.wire import dialect as mav

SECOND = 1_000_000_000
PLACES = [(-88000000, -639500000), (-87990000, -639500000), (-87990000, -639490000), (-88000000, -639490000)]


def sent(message: Any, system: int = 255, component: int = 190) -> Any:
    """As if it had come from that station."""
    message.get_header().srcSystem = system
    message.get_header().srcComponent = component
    return message


def item(seq: int, command: int = 16, frame: int = 6, x: int | None = None, z: float = 0.0, p2: float = 0.0, **kind):
    place = PLACES[seq % 4]
    return sent(
        mav.MAVLink_mission_item_int_message(
            1, 1, seq, frame, command, 0, 1, 0.0, p2, 0.0, math.nan, place[0] if x is None else x, place[1], z, **kind
        )
    )


def count(number: int, **kind: int) -> Any:
    return sent(mav.MAVLink_mission_count_message(1, 1, number, **kind))


def acks(messages: list[Any]) -> list[int]:
    return [message.type for message in messages if message.get_msgId() == mav.MAVLINK_MSG_ID_MISSION_ACK]


def requests(messages: list[Any]) -> list[int]:
    return [message.seq for message in messages if message.get_msgId() == mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT]


def texts(messages: list[Any]) -> str:
    return "".join(m.text for m in messages if m.get_msgId() == mav.MAVLINK_MSG_ID_STATUSTEXT)


def uploaded(number: int = 4) -> MavlinkChannel:
    channel = MavlinkChannel(Autopilot())
    channel.handle(count(number), 0)
    for seq in range(number):
        channel.handle(item(seq), 0)
    assert len(channel.autopilot.navigator.mission.items) == number
    return channel


def test_upload_and_download_give_back_the_same() -> None:
    channel = MavlinkChannel(Autopilot())
    replies = channel.handle(count(4), 0)
    assert requests(replies) == [0]
    assert (replies[0].target_system, replies[0].target_component) == (255, 190)
    for seq in range(3):
        assert requests(channel.handle(item(seq, z=5.0), 0)) == [seq + 1]
    assert acks(channel.handle(item(3, command=178, p2=2.5), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert channel.autopilot.navigator.mission.waypoints() == (1, 2)

    (reply,) = channel.handle(sent(mav.MAVLink_mission_request_list_message(1, 1)), 0)
    assert reply.count == 4
    got = [channel.handle(sent(mav.MAVLink_mission_request_int_message(1, 1, seq)), 0)[0] for seq in range(4)]
    assert [(one.x, one.y) for one in got[:3]] == PLACES[:3]
    assert [(one.command, one.frame, one.z) for one in got[:3]] == [(16, 3, 5.0)] * 3
    assert (got[3].command, got[3].param2) == (178, 2.5)
    assert [one.current for one in got] == [0, 1, 0, 0]
    assert acks(channel.handle(sent(mav.MAVLink_mission_request_int_message(1, 1, 4)), 0)) == [13]


def test_items_out_of_order_are_asked_again_and_duplicates_ignored() -> None:
    channel = MavlinkChannel(Autopilot())
    channel.handle(count(3), 0)
    assert requests(channel.handle(item(2), 0)) == [0]
    assert requests(channel.handle(item(0), 0)) == [1]
    assert channel.handle(item(0), 0) == []
    assert requests(channel.handle(item(2), 0)) == [1]
    assert requests(channel.handle(item(1), 0)) == [2]
    assert acks(channel.handle(item(2), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert acks(channel.handle(item(2), 0)) == [mav.MAV_MISSION_ACCEPTED]  # the acknowledgement was lost
    assert acks(channel.handle(item(1), 0)) == [mav.MAV_MISSION_ERROR]


@pytest.mark.parametrize("seed", range(20))
def test_upload_over_a_link_that_loses_a_third(seed: int) -> None:
    """A station that only answers requests gets its mission across; the autopilot asks again."""
    rng = random.Random(seed)
    channel = MavlinkChannel(Autopilot(), rates_hz={})
    replies = channel.handle(count(4), 0)
    done: list[int] = []
    now = 0
    while not done and now < 60 * SECOND:
        now += SECOND // 10
        wanted = [seq for seq in requests(replies) if rng.random() > 0.2]
        done = acks(replies)
        replies = channel.poll(now)
        for seq in wanted:
            if rng.random() > 0.2:
                replies += channel.handle(item(seq), now)
    assert done == [mav.MAV_MISSION_ACCEPTED]
    assert len(channel.autopilot.navigator.mission.items) == 4


def test_a_station_that_falls_silent_is_given_up_and_the_old_mission_kept() -> None:
    channel = uploaded(3)
    old = channel.autopilot.navigator.mission
    channel.handle(count(2), 0)
    channel.handle(item(0), 0)
    said: list[Any] = []
    for tick in range(1, 500):
        said += channel.poll(tick * SECOND // 50)
    assert requests(said) == [1] * 5
    assert acks(said) == [mav.MAV_MISSION_OPERATION_CANCELLED]
    assert "Mission upload cancelled: item 1 did not arrive" in texts(said)
    assert channel.autopilot.navigator.mission == old


@pytest.mark.parametrize(
    ("bad", "result", "words"),
    [
        (item(1, command=999), mav.MAV_MISSION_UNSUPPORTED, "item 1 refused: command 999 is not supported"),
        (item(1, command=0), mav.MAV_MISSION_INVALID, "item 1 refused: command 0 is not supported"),
        (item(1, frame=1), mav.MAV_MISSION_UNSUPPORTED_FRAME, "item 1 refused: frame 1"),
        (item(1, x=910000000), mav.MAV_MISSION_INVALID_PARAM5_X, "item 1 refused: position 91"),
        (item(1, z=math.nan), mav.MAV_MISSION_INVALID_PARAM7, "item 1 refused: altitude nan"),
        (item(1, command=178, p2=math.nan), mav.MAV_MISSION_INVALID_PARAM2, "parameter 2 of ChangeSpeed is nan"),
    ],
)
def test_a_bad_item_ends_the_upload(bad: Any, result: int, words: str) -> None:
    channel = uploaded(3)
    old = channel.autopilot.navigator.mission
    channel.handle(count(2), 0)
    channel.handle(item(0), 0)
    assert acks(channel.handle(bad, 0)) == [result]
    assert words in texts(channel.poll(0))
    assert channel.autopilot.navigator.mission == old


def test_home_may_be_anything() -> None:
    channel = MavlinkChannel(Autopilot())
    channel.handle(count(2), 0)
    assert requests(channel.handle(item(0, command=999, frame=77, z=math.nan), 0)) == [1]
    assert acks(channel.handle(item(1), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert channel.handle(sent(mav.MAVLink_mission_request_int_message(1, 1, 0)), 0)[0].command == 16


def test_clear_empty_too_large_and_other_plans() -> None:
    channel = uploaded(3)
    assert acks(channel.handle(count(4000), 0)) == [mav.MAV_MISSION_NO_SPACE]
    assert "Mission of 4000 items refused: at most 724 fit" in texts(channel.poll(0))
    assert acks(channel.handle(count(3, mission_type=7), 0)) == [mav.MAV_MISSION_UNSUPPORTED]
    assert acks(channel.handle(count(3, mission_type=2), 0)) == [mav.MAV_MISSION_UNSUPPORTED]
    assert acks(channel.handle(count(0, mission_type=2), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert len(channel.autopilot.navigator.mission.items) == 3
    (reply,) = channel.handle(sent(mav.MAVLink_mission_request_list_message(1, 1, 1)), 0)
    assert (reply.count, reply.mission_type) == (0, 1)
    assert acks(channel.handle(sent(mav.MAVLink_mission_clear_all_message(1, 1)), 0)) == [0]
    assert channel.autopilot.navigator.mission.items == ()
    channel = uploaded(3)
    assert acks(channel.handle(count(0), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert channel.autopilot.navigator.mission.items == ()


def test_another_station_does_not_disturb_a_transfer() -> None:
    channel = MavlinkChannel(Autopilot())
    channel.handle(count(2), 0)
    channel.handle(item(0), 0)
    assert acks(channel.handle(sent(count(5), 254), 0)) == [mav.MAV_MISSION_ERROR]
    assert acks(channel.handle(sent(item(1), 254), 0)) == [mav.MAV_MISSION_ERROR]
    assert acks(channel.handle(item(1), 0)) == [mav.MAV_MISSION_ACCEPTED]


def test_another_station_does_not_clear_away_an_upload() -> None:
    channel = uploaded(3)
    channel.handle(count(2), 0)
    channel.handle(item(0), 0)
    clear, clear_fence, clear_all = (mav.MAVLink_mission_clear_all_message(1, 1, kind) for kind in (0, 1, 255))
    assert acks(channel.handle(sent(clear, 254), 0)) == [mav.MAV_MISSION_ERROR]
    assert acks(channel.handle(sent(clear_all, 254), 0)) == [mav.MAV_MISSION_ERROR]
    assert acks(channel.handle(sent(clear_fence, 254), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert len(channel.autopilot.navigator.mission.items) == 3
    assert acks(channel.handle(item(1), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert len(channel.autopilot.navigator.mission.items) == 2


@pytest.mark.parametrize("begin", [lambda: count(3), lambda: partial(1, 2)])
def test_the_last_item_of_a_cancelled_upload_is_not_accepted_as_that_of_the_upload_before(begin: Any) -> None:
    channel = uploaded(3)
    old = channel.autopilot.navigator.mission
    channel.handle(begin(), 0)
    for tick in range(1, 10):
        channel.poll(tick * SECOND // 2)
    assert acks(channel.handle(item(2, x=-87000000), 5 * SECOND)) == [mav.MAV_MISSION_ERROR]
    assert channel.autopilot.navigator.mission == old


def test_a_part_does_not_bring_back_a_plan_that_another_link_has_replaced() -> None:
    channel = uploaded(4)
    other = MavlinkChannel(channel.autopilot, hub=channel.hub)
    channel.handle(partial(1, 2), 0)
    channel.handle(item(1), 0)
    other.handle(count(2), 0)
    for seq in range(2):
        other.handle(item(seq, x=-87000000), 0)
    new = channel.autopilot.navigator.mission
    assert acks(channel.handle(item(2), 0)) == [mav.MAV_MISSION_ERROR]
    assert channel.autopilot.navigator.mission == new
    assert "Mission items refused: the plan has changed" in texts(channel.poll(0))


def float_item(seq: int, x: float, y: float, **kind: int) -> Any:
    message = mav.MAVLink_mission_item_message(1, 1, seq, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, x, y, 0.0, **kind)
    return sent(message)


def request(seq: int, kind: int = 0) -> Any:
    return sent(mav.MAVLink_mission_request_int_message(1, 1, seq, kind))


def test_the_float_form_comes_and_goes_in_degrees() -> None:
    channel = MavlinkChannel(Autopilot())
    channel.handle(count(2), 0)
    channel.handle(float_item(0, -8.8, -63.95), 0)
    assert acks(channel.handle(float_item(1, -8.79, -63.94), 0)) == [mav.MAV_MISSION_ACCEPTED]
    (reply,) = channel.handle(sent(mav.MAVLink_mission_request_message(1, 1, 1)), 0)
    assert reply.get_type() == "MISSION_ITEM"
    assert (reply.x, reply.y) == (-8.79, -63.94)
    assert channel.handle(request(1), 0)[0].x == -87900000


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e30])
def test_a_float_item_that_is_nowhere_is_refused(bad: float) -> None:
    channel = uploaded(3)
    old = channel.autopilot.navigator.mission
    channel.handle(count(2), 0)
    channel.handle(float_item(0, bad, bad), 0)
    assert acks(channel.handle(float_item(1, bad, 0.0), 0)) == [mav.MAV_MISSION_INVALID_PARAM5_X]
    assert "Mission item 1 refused: position " in texts(channel.poll(0))
    assert channel.autopilot.navigator.mission == old


def partial(first: int, last: int, kind: int = 0) -> Any:
    return sent(mav.MAVLink_mission_write_partial_list_message(1, 1, first, last, kind))


def test_a_part_is_replaced_and_the_mission_goes_on_where_it_was() -> None:
    channel = uploaded(4)
    channel.handle(sent(mav.MAVLink_mission_set_current_message(1, 1, 3)), 0)
    old = channel.autopilot.navigator.mission.items
    assert requests(channel.handle(partial(1, 2), 0)) == [1]
    assert requests(channel.handle(item(1, x=-87000000), 0)) == [2]
    assert requests(channel.handle(item(3), 0)) == [2]
    assert channel.autopilot.navigator.mission.items == old
    assert acks(channel.handle(item(2, x=-87000001), 0)) == [mav.MAV_MISSION_ACCEPTED]
    new = channel.autopilot.navigator.mission.items
    assert [one.lat_deg for one in new[1:3]] == [-8.7, -8.7000001]
    assert (new[0], new[3]) == (old[0], old[3])
    assert channel.autopilot.navigator.progress.current == 3


@pytest.mark.parametrize(("first", "last"), [(0, 4), (2, 1), (-1, 2), (4, 4), (3, 32767)])
def test_a_part_that_is_not_there_is_refused(first: int, last: int) -> None:
    channel = uploaded(4)
    assert acks(channel.handle(partial(first, last), 0)) == [mav.MAV_MISSION_INVALID_SEQUENCE]
    assert f"Mission items {first} to {last} refused: there are 4" in texts(channel.poll(0))


def test_set_current_is_answered_and_refused_in_words() -> None:
    channel = uploaded(4)
    (reply,) = channel.handle(sent(mav.MAVLink_mission_set_current_message(1, 1, 2)), 0)
    assert (reply.get_type(), reply.seq) == ("MISSION_CURRENT", 2)
    (reply,) = channel.handle(sent(mav.MAVLink_mission_set_current_message(1, 1, 9)), 0)
    assert reply.seq == 2
    assert "mission item 9 does not exist" in texts(channel.poll(0))


def test_a_station_may_end_its_upload() -> None:
    channel = uploaded(3)
    channel.handle(count(2), 0)
    channel.handle(sent(mav.MAVLink_mission_ack_message(1, 1, mav.MAV_MISSION_OPERATION_CANCELLED)), 0)
    assert acks(channel.handle(item(0), 0)) == [mav.MAV_MISSION_ERROR]
    assert "Mission item 0 refused: no upload is under way" in texts(channel.poll(0))
    assert len(channel.autopilot.navigator.mission.items) == 3


CORNERS = [(-87000000, -640000000), (-87000000, -639000000), (-89000000, -639000000)]


def fence_item(seq: int, command: int = 5001, p1: float = 3.0, place: tuple[int, int] | None = None) -> Any:
    x, y = place or CORNERS[seq % 3]
    return sent(
        mav.MAVLink_mission_item_int_message(1, 1, seq, 0, command, 0, 1, p1, 0.0, 0.0, 0.0, x, y, 0.0, mission_type=1)
    )


def test_a_fence_goes_up_beside_the_mission_and_comes_down() -> None:
    channel = uploaded(3)
    assert requests(channel.handle(count(4, mission_type=1), 0)) == [0]
    for seq in range(3):
        channel.handle(fence_item(seq), 0)
    (ack,) = channel.handle(fence_item(3, command=5004, p1=25.0), 0)
    assert (ack.type, ack.mission_type) == (mav.MAV_MISSION_ACCEPTED, 1)
    assert len(channel.autopilot.navigator.mission.items) == 3
    (reply,) = channel.handle(sent(mav.MAVLink_mission_request_list_message(1, 1, 1)), 0)
    assert (reply.count, reply.mission_type) == (4, 1)
    got = [channel.handle(request(seq, 1), 0)[0] for seq in range(4)]
    assert [(one.command, one.param1) for one in got] == [(5001, 3.0)] * 3 + [(5004, 25.0)]
    assert [(one.x, one.y) for one in got[:3]] == CORNERS
    assert acks(channel.handle(sent(mav.MAVLink_mission_clear_all_message(1, 1, 1)), 0)) == [0]
    assert not channel.autopilot.fence.items
    assert len(channel.autopilot.navigator.mission.items) == 3


@pytest.mark.parametrize(
    ("bad", "result"),
    [
        (fence_item(0, command=16), mav.MAV_MISSION_UNSUPPORTED),
        (fence_item(0, place=(910000000, 0)), mav.MAV_MISSION_INVALID),
        (fence_item(0, p1=2.0), mav.MAV_MISSION_INVALID),
        (fence_item(0, command=5003, p1=math.nan), mav.MAV_MISSION_INVALID),
        (fence_item(0, command=5003, p1=-1.0), mav.MAV_MISSION_INVALID),
    ],
)
def test_a_fence_that_is_none_is_refused(bad: Any, result: int) -> None:
    channel = MavlinkChannel(Autopilot())
    channel.handle(count(1, mission_type=1), 0)
    assert acks(channel.handle(bad, 0)) == [result]
    assert "fence" in texts(channel.poll(0)).lower()
    assert not channel.autopilot.fence.items


def test_clear_all_kinds() -> None:
    channel = uploaded(3)
    channel.handle(count(1, mission_type=1), 0)
    channel.handle(fence_item(0, command=5003, p1=50.0), 0)
    assert channel.autopilot.fence.items
    (ack,) = channel.handle(sent(mav.MAVLink_mission_clear_all_message(1, 1, 255)), 0)
    assert (ack.type, ack.mission_type) == (0, 255)
    assert not channel.autopilot.fence.items
    assert channel.autopilot.navigator.mission.items == ()


@pytest.mark.medium
@settings(max_examples=150)
@given(st.data())
def test_any_order_and_any_loss_leave_a_valid_state(data: st.DataObject) -> None:
    """Whatever comes in whatever order: no exception, every plan is whole or the old one, and a transfer ends."""
    channel = uploaded(3)
    step = st.one_of(
        st.builds(count, st.integers(0, 5), mission_type=st.integers(0, 3)),
        st.builds(item, st.integers(0, 5), mission_type=st.integers(0, 1)),
        st.builds(fence_item, st.integers(0, 4), command=st.sampled_from([16, 5000, 5001, 5003])),
        st.builds(partial, st.integers(-1, 4), st.integers(-1, 4), st.integers(0, 2)),
        st.builds(request, st.integers(0, 6), st.integers(0, 3)),
        st.builds(
            lambda kind: sent(mav.MAVLink_mission_clear_all_message(1, 1, kind)), st.sampled_from([0, 1, 2, 255])
        ),
        st.builds(lambda seq: sent(mav.MAVLink_mission_set_current_message(1, 1, seq)), st.integers(0, 6)),
        st.builds(lambda kind: sent(mav.MAVLink_mission_ack_message(1, 1, kind)), st.integers(0, 15)),
        st.integers(0, 3 * SECOND),
    )
    now = 0
    for one in data.draw(st.lists(step, max_size=40)):
        if isinstance(one, int):
            now += one
            channel.poll(now)
        else:
            for reply in channel.handle(one, now):
                assert reply.get_type() in ANSWERS
        items = channel.autopilot.navigator.mission.items
        assert len(items) != 1
        assert 0 <= channel.autopilot.navigator.progress.current < max(len(items), 1)
    late = [m for tick in range(300) for m in channel.poll(now + tick * SECOND // 50)]
    assert len(requests(late)) <= 6
    assert requests(channel.poll(now + 20 * SECOND)) == []


ANSWERS = ("MISSION_ACK", "MISSION_REQUEST_INT", "MISSION_ITEM_INT", "MISSION_ITEM", "MISSION_COUNT", "MISSION_CURRENT")
