"""Frames of MAVLink 1, both ways, against pymavlink's own codec of that version."""

from __future__ import annotations

import random
from io import BytesIO
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v10 import ardupilotmega as old
from pymavlink.dialects.v20 import ardupilotmega as new
from python39 import strict_zip

from agent.wire import dialect
from agent.wire.codec import MessageRefusedError, Packer, came_as_mavlink1, decode
from agent.wire.framing import Framer
from agent.wire.link import Link
from agent.wire.memory import memory_pair


def client(codec: Any) -> Any:
    return codec.MAVLink(BytesIO(), srcSystem=255, srcComponent=190)


def heartbeat(codec: Any, sender: Any) -> bytes:
    return bytes(codec.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(sender))


def ours(number: int) -> Any:
    kind = dialect.mavlink_map[number]
    source = random.Random(number)
    values = []
    for type_name, order in strict_zip(kind.fieldtypes, kind.orders):
        length = kind.array_lengths[order]
        if type_name == "char":
            values.append(b"xyz")
        else:
            values.append([source.randrange(100) for _ in range(length)] if length else source.randrange(1, 100))
    return kind(*values)


NUMBERS = [number for number in dialect.mavlink_map if number <= 255 and number in old.mavlink_map]


@pytest.mark.parametrize("number", NUMBERS)
def test_what_we_send_is_what_the_old_codec_reads(number: int) -> None:
    packer = Packer(1, 1)
    packer.mavlink1 = True
    frame = packer.pack(ours(number))
    (message,) = client(old).parse_buffer(frame)
    assert message.get_msgId() == number
    for name in message.fieldnames:
        assert getattr(message, name) == pytest.approx(getattr(ours(number), name)), name


def test_what_the_old_codec_sends_is_read() -> None:
    sent = old.MAVLink_mission_count_message(1, 1, 7).pack(client(old))
    framer = Framer(stream=True, mavlink1=True)
    (frame,) = framer.feed(b"noise" + sent)
    message = decode(frame)
    assert (message.count, message.mission_type, message.get_srcSystem()) == (7, 0, 255)
    assert came_as_mavlink1(message)
    assert framer.counters.bytes_good == len(sent)
    assert Framer(stream=True).feed(sent) == []
    (frame,) = framer.feed(bytes(new.MAVLink_mission_count_message(1, 1, 7).pack(client(new))))
    assert not came_as_mavlink1(decode(frame))


@pytest.mark.medium
@given(st.lists(st.booleans(), min_size=1, max_size=8), st.integers(1, 40), st.binary(max_size=12))
def test_frames_of_both_versions_come_out_however_they_are_cut(versions: list[bool], size: int, noise: bytes) -> None:
    data = b"".join(heartbeat(*(old, client(old)) if one else (new, client(new))) for one in versions)
    framer = Framer(stream=True, mavlink1=True)
    found = [f for at in range(0, len(data), size) for f in framer.feed(data[at : at + size])]
    assert [came_as_mavlink1(decode(frame)) for frame in found] == versions
    framer.feed(noise)
    counters = framer.counters
    assert counters.bytes_in == counters.bytes_good + counters.bytes_dropped + framer.held_bytes


@pytest.mark.medium
@given(st.binary(max_size=300), st.booleans())
def test_no_bytes_raise(data: bytes, stream: bool) -> None:
    framer = Framer(stream, mavlink1=True)
    for frame in framer.feed(data + b"\xfe\x09"):
        decode(frame)
    counters = framer.counters
    assert counters.bytes_in == counters.bytes_good + counters.bytes_dropped + framer.held_bytes


def test_a_link_answers_in_the_version_that_it_hears() -> None:
    here, there = memory_pair()
    link = Link(here, 1, 1, mavlink1=True)
    beat = dialect.MAVLink_heartbeat_message(11, 3, 1, 4, 3, 3)

    def version() -> int:
        link.send(beat)
        return b"".join(there.receive(0.0))[0]

    assert version() == 0xFD
    there.send(heartbeat(old, client(old)))
    link.receive()
    assert version() == 0xFE
    with pytest.raises(MessageRefusedError, match="PARAM_ERROR: the other end uses MAVLink 1"):
        link.send(dialect.MAVLink_param_error_message(1, 1, b"X", -1, 1))
    there.send(heartbeat(new, client(new)))
    link.receive()
    assert version() == 0xFD
    there.send(heartbeat(old, client(old)))  # one that can do both: it stays with the newer
    link.receive()
    assert version() == 0xFD
