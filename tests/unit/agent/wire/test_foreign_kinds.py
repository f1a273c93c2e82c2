"""A link to somebody who knows more kinds of messages than the dialect."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.wire import dialect as mav
from agent.wire.codec import Packer
from agent.wire.framing import Framer
from agent.wire.link import Link
from agent.wire.memory import memory_pair

UNKNOWN = 168


def beat(packer: Packer) -> bytes:
    return packer.pack(mav.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3))


def foreign(packer: Packer, payload: bytes = b"\xfd" * 20) -> bytes:
    """A frame of another kind, full of what begins a frame."""
    known = packer.pack(mav.MAVLink_system_time_message(1, 2))
    return b"\xfd" + bytes((len(payload), 0, 0)) + known[4:7] + UNKNOWN.to_bytes(3, "little") + payload + b"\xaa\x55"


@given(st.lists(st.booleans(), min_size=1, max_size=12), st.integers(1, 40))
def test_frames_of_both_come_out_however_they_are_cut(kinds: list[bool], step: int) -> None:
    packer = Packer(1, 1)
    frames = [foreign(packer) if other else beat(packer) for other in kinds]
    data, framer, found = b"".join(frames), Framer(stream=True, foreign=True), []
    for at in range(0, len(data), step):
        found += framer.feed(data[at : at + step])
    assert found == frames
    assert framer.counters.dropped == 0
    assert framer.counters.bytes_good == len(data)


@pytest.mark.parametrize("stream", [True, False])
def test_one_that_nothing_confirms_is_damage(stream: bool) -> None:
    packer = Packer(1, 1)
    framer = Framer(stream, foreign=True)
    good = beat(packer)
    assert framer.feed(foreign(packer, b"12345678") + b"noise" + good) == [good]
    assert framer.counters.dropped_unknown == 1


def test_without_the_option_it_is_dropped_as_before() -> None:
    packer = Packer(1, 1)
    framer = Framer(stream=False)
    assert framer.feed(foreign(packer, b"12345678")) == []
    assert framer.counters.dropped_unknown == 1


def test_a_link_counts_them_and_their_numbers() -> None:
    here, there = memory_pair()
    link, packer = Link(here, 255, 190, foreign=True), Packer(1, 1)
    there.send(beat(packer))
    there.send(foreign(packer))
    foreign(packer)  # lost on the way
    there.send(beat(packer))
    messages: list[Any] = link.receive()
    assert [message.get_type() for message in messages] == ["HEARTBEAT"] * 2
    counters = link.counters
    assert (link.passed, counters.received, counters.lost, counters.dropped) == (1, 2, 1, 0)
    link.reset_counters()
    assert link.passed == 0
