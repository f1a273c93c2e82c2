"""A link that passes on what others said leaves their names on it, as a MAVLink router does."""

from __future__ import annotations

import io

from pymavlink.dialects.v20 import common

from agent.wire import dialect as mav
from agent.wire.codec import Packer, decode
from agent.wire.link import Link
from agent.wire.memory import memory_pair


def heard_from(system_id: int, component_id: int, count: int) -> list[object]:
    packer = Packer(system_id, component_id)
    return [decode(packer.pack(mav.MAVLink_heartbeat_message(11, 0, 0, 0, 4, 3))) for _ in range(count)]


def test_pymavlink_sees_each_sender_with_a_sequence_of_its_own() -> None:
    here, there = memory_pair()
    link = Link(here, 255, 190)
    link.send(mav.MAVLink_system_time_message(0, 0))
    link.pass_on(*heard_from(1, 1, 3), *heard_from(1, 191, 2))
    link.send(mav.MAVLink_system_time_message(0, 0))
    reader = common.MAVLink(io.BytesIO())
    messages = [message for chunk in there.receive() for message in reader.parse_buffer(chunk) or ()]
    seen = [(m.get_srcSystem(), m.get_srcComponent(), m.get_seq()) for m in messages]
    assert seen == [(255, 190, 0), (1, 1, 0), (1, 1, 1), (1, 1, 2), (1, 191, 0), (1, 191, 1), (255, 190, 1)]
    assert link.counters.sent == 7


def test_the_receiver_counts_no_loss_between_senders() -> None:
    here, there = memory_pair()
    link, other = Link(here, 255, 190), Link(there, 1, 191)
    for _ in range(3):
        link.send(mav.MAVLink_system_time_message(0, 0))
        link.pass_on(*heard_from(1, 1, 1))
    assert len(other.receive()) == 6
    assert other.counters.lost == 0
