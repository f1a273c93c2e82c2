"""The mission protocol as a ground station meets it: order, losses, duplicates, time-outs, refusals."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest

from agent.fcu.autopilot import Autopilot
from agent.fcu.services import Services
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


def uploaded(number: int = 4) -> Services:
    services = Services(Autopilot())
    services.handle(count(number), 0)
    for seq in range(number):
        services.handle(item(seq), 0)
    assert len(services.autopilot.mission.items) == number
    return services


def test_upload_and_download_give_back_the_same() -> None:
    services = Services(Autopilot())
    replies = services.handle(count(4), 0)
    assert requests(replies) == [0]
    assert (replies[0].target_system, replies[0].target_component) == (255, 190)
    for seq in range(3):
        assert requests(services.handle(item(seq, z=5.0), 0)) == [seq + 1]
    assert acks(services.handle(item(3, command=178, p2=2.5), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert services.autopilot.mission.waypoints() == (1, 2)

    (reply,) = services.handle(sent(mav.MAVLink_mission_request_list_message(1, 1)), 0)
    assert reply.count == 4
    got = [services.handle(sent(mav.MAVLink_mission_request_int_message(1, 1, seq)), 0)[0] for seq in range(4)]
    assert [(one.x, one.y) for one in got[:3]] == PLACES[:3]
    assert [(one.command, one.frame, one.z) for one in got[:3]] == [(16, 3, 5.0)] * 3
    assert (got[3].command, got[3].param2) == (178, 2.5)
    assert [one.current for one in got] == [0, 1, 0, 0]
    assert acks(services.handle(sent(mav.MAVLink_mission_request_int_message(1, 1, 4)), 0)) == [13]


def test_items_out_of_order_are_asked_again_and_duplicates_ignored() -> None:
    services = Services(Autopilot())
    services.handle(count(3), 0)
    assert requests(services.handle(item(2), 0)) == [0]
    assert requests(services.handle(item(0), 0)) == [1]
    assert services.handle(item(0), 0) == []
    assert requests(services.handle(item(2), 0)) == [1]
    assert requests(services.handle(item(1), 0)) == [2]
    assert acks(services.handle(item(2), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert acks(services.handle(item(2), 0)) == [mav.MAV_MISSION_ACCEPTED]  # the acknowledgement was lost
    assert acks(services.handle(item(1), 0)) == [mav.MAV_MISSION_ERROR]


@pytest.mark.parametrize("seed", range(20))
def test_upload_over_a_link_that_loses_a_third(seed: int) -> None:
    """A station that only answers requests gets its mission across; the autopilot asks again."""
    rng = random.Random(seed)
    services = Services(Autopilot(), rates_hz={})
    replies = services.handle(count(4), 0)
    done: list[int] = []
    now = 0
    while not done and now < 60 * SECOND:
        now += SECOND // 10
        wanted = [seq for seq in requests(replies) if rng.random() > 0.2]
        done = acks(replies)
        replies = services.telemetry(now)
        for seq in wanted:
            if rng.random() > 0.2:
                replies += services.handle(item(seq), now)
    assert done == [mav.MAV_MISSION_ACCEPTED]
    assert len(services.autopilot.mission.items) == 4


def test_a_station_that_falls_silent_is_given_up_and_the_old_mission_kept() -> None:
    services = uploaded(3)
    old = services.autopilot.mission
    services.handle(count(2), 0)
    services.handle(item(0), 0)
    said: list[Any] = []
    for tick in range(1, 500):
        said += services.telemetry(tick * SECOND // 50)
    assert requests(said) == [1] * 5
    assert acks(said) == [mav.MAV_MISSION_OPERATION_CANCELLED]
    assert "Mission upload given up: item 1 did not come" in texts(said)
    assert services.autopilot.mission == old


@pytest.mark.parametrize(
    ("bad", "result", "words"),
    [
        (item(1, command=21), mav.MAV_MISSION_UNSUPPORTED, "item 1 refused: command 21 is not supported"),
        (item(1, frame=1), mav.MAV_MISSION_UNSUPPORTED_FRAME, "item 1 refused: frame 1"),
        (item(1, x=910000000), mav.MAV_MISSION_INVALID, "item 1 refused: position 91"),
        (item(1, z=math.nan), mav.MAV_MISSION_INVALID, "item 1 refused: altitude nan"),
        (item(1, command=178, p2=math.nan), mav.MAV_MISSION_INVALID, "item 1 refused: speed nan"),
    ],
)
def test_a_bad_item_ends_the_upload(bad: Any, result: int, words: str) -> None:
    services = uploaded(3)
    old = services.autopilot.mission
    services.handle(count(2), 0)
    services.handle(item(0), 0)
    assert acks(services.handle(bad, 0)) == [result]
    assert words in texts(services.telemetry(0))
    assert services.autopilot.mission == old


def test_home_may_be_anything() -> None:
    services = Services(Autopilot())
    services.handle(count(2), 0)
    assert requests(services.handle(item(0, command=999, frame=77, z=math.nan), 0)) == [1]
    assert acks(services.handle(item(1), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert services.handle(sent(mav.MAVLink_mission_request_int_message(1, 1, 0)), 0)[0].command == 16


def test_clear_empty_too_large_and_other_plans() -> None:
    services = uploaded(3)
    assert acks(services.handle(count(4000), 0)) == [mav.MAV_MISSION_NO_SPACE]
    assert acks(services.handle(count(3, mission_type=1), 0)) == [mav.MAV_MISSION_UNSUPPORTED]
    assert len(services.autopilot.mission.items) == 3
    (reply,) = services.handle(sent(mav.MAVLink_mission_request_list_message(1, 1, 1)), 0)
    assert (reply.count, reply.mission_type) == (0, 1)
    assert acks(services.handle(sent(mav.MAVLink_mission_clear_all_message(1, 1)), 0)) == [0]
    assert services.autopilot.mission.items == ()
    services = uploaded(3)
    assert acks(services.handle(count(0), 0)) == [mav.MAV_MISSION_ACCEPTED]
    assert services.autopilot.mission.items == ()


def test_another_station_does_not_disturb_a_transfer() -> None:
    services = Services(Autopilot())
    services.handle(count(2), 0)
    services.handle(item(0), 0)
    assert acks(services.handle(sent(count(5), 254), 0)) == [mav.MAV_MISSION_ERROR]
    assert acks(services.handle(sent(item(1), 254), 0)) == [mav.MAV_MISSION_ERROR]
    assert acks(services.handle(item(1), 0)) == [mav.MAV_MISSION_ACCEPTED]
