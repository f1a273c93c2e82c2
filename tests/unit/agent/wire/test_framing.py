"""Frames found in bytes, with every loss counted; kinds that the dialect does not have."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages import FRAMES, garbage_free_of_frames, imu
from python39 import strict_zip

from agent.wire import dialect
from agent.wire import dialect as mav
from agent.wire.codec import Packer, decode
from agent.wire.framing import LARGEST_FRAME, Framer
from agent.wire.link import Link
from agent.wire.memory import memory_pair

FLUSH = bytes(LARGEST_FRAME)  # completes whatever a damaged frame in a stream claims


def adds_up(framer: Framer) -> bool:
    counters = framer.counters
    return counters.bytes_in == counters.bytes_good + counters.bytes_dropped + framer.held_bytes


def frame_of(message: Any) -> bytes:
    return Packer(1, 1).pack(message)


@pytest.mark.medium
@given(st.lists(st.one_of(st.binary(max_size=600), garbage_free_of_frames()), max_size=6), st.booleans())
def test_any_bytes(chunks: list[bytes], stream: bool) -> None:
    framer = Framer(stream)
    for chunk in chunks:
        for frame in framer.feed(chunk):
            decode(frame)
        assert adds_up(framer)
        assert framer.held_bytes < LARGEST_FRAME
    assert (framer.counters.dropped > 0) >= (framer.counters.bytes_dropped > 0)


@pytest.mark.medium
@given(st.lists(st.tuples(garbage_free_of_frames(), FRAMES), min_size=1, max_size=5))
def test_every_good_frame_in_a_datagram_of_garbage_is_found(parts: list[tuple[bytes, bytes]]) -> None:
    framer = Framer(stream=False)
    found = framer.feed(b"".join(garbage + frame for garbage, frame in parts))
    assert found == [frame for _, frame in parts]
    assert framer.counters.bytes_dropped == sum(len(garbage) for garbage, _ in parts)
    assert adds_up(framer)


@pytest.mark.medium
@given(st.lists(st.tuples(garbage_free_of_frames(), FRAMES), min_size=1, max_size=5), st.data())
def test_every_good_frame_in_a_stream_of_garbage_is_found(
    parts: list[tuple[bytes, bytes]], data: st.DataObject
) -> None:
    framer = Framer(stream=True)
    stream = b"".join(garbage + frame for garbage, frame in parts) + FLUSH
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    found = []
    for start, end in strict_zip([0, *cuts], [*cuts, len(stream)]):
        found += framer.feed(stream[start:end])
        assert adds_up(framer)
    assert found == [frame for _, frame in parts]


@pytest.mark.medium
@given(st.lists(FRAMES, min_size=1, max_size=6), st.data())
def test_mutated_and_truncated_frames_are_dropped_and_counted(frames: list[bytes], data: st.DataObject) -> None:
    index = data.draw(st.integers(0, len(frames) - 1))
    frame = frames[index]
    if data.draw(st.booleans()):
        at, bit = data.draw(st.integers(0, len(frame) - 1)), data.draw(st.integers(0, 7))
        damaged = frame[:at] + bytes([frame[at] ^ 1 << bit]) + frame[at + 1 :]
    else:
        damaged = frame[: data.draw(st.integers(1, len(frame) - 1))]
    framer = Framer(stream=False)
    found = framer.feed(b"".join([*frames[:index], damaged, *frames[index + 1 :]]))
    assert found == frames[:index] + frames[index + 1 :]
    assert framer.counters.dropped >= 1
    assert framer.counters.bytes_dropped == len(damaged)
    assert adds_up(framer)


def counts(framer: Framer) -> tuple[int, int, int, int]:
    counters = framer.counters
    return counters.dropped_bad_crc, counters.dropped_unknown, counters.dropped_truncated, counters.dropped_noise


def flipped(frame: bytes, at: int) -> bytes:
    return frame[:at] + bytes([frame[at] ^ 0xFF]) + frame[at + 1 :]


PLAIN = frame_of(imu())
LONG = frame_of(dialect.MAVLink_statustext_message(6, b"a sentence that holds \xfd\xfd\xfd in the middle"))


@pytest.mark.parametrize(
    ("damaged", "expected"),
    [
        (flipped(PLAIN, 20), (1, 0, 0, 0)),
        (flipped(PLAIN, len(PLAIN) - 1), (1, 0, 0, 0)),
        (flipped(LONG, 11), (1, 0, 0, 0)),  # 0xFD in the payload of a damaged frame is no second event
        (flipped(PLAIN, 8), (0, 1, 0, 0)),
        (PLAIN[:2] + b"\x02" + PLAIN[3:], (0, 1, 0, 0)),  # an incompatibility flag that nobody has defined
        (PLAIN[:-1], (0, 0, 1, 0)),
        (PLAIN[:5], (0, 0, 1, 0)),
        (b"\xfd", (0, 0, 1, 0)),
        (b"hello", (0, 0, 0, 1)),
        (b"\xfe\x09\x00\x01\x01\x00" + bytes(11), (0, 0, 0, 1)),  # a MAVLink 1 heartbeat
        (b"hello" + flipped(PLAIN, 20), (1, 0, 0, 1)),
        (flipped(PLAIN, 20) * 3, (3, 0, 0, 0)),
    ],
)
def test_each_kind_of_damage_has_its_counter(damaged: bytes, expected: tuple[int, int, int, int]) -> None:
    framer = Framer(stream=False)
    assert framer.feed(damaged) == []
    assert counts(framer) == expected
    assert framer.feed(PLAIN) == [PLAIN]
    assert counts(framer) == expected


@pytest.mark.parametrize("cut", [1, 12, 20, 40, len(LONG) - 1])
@pytest.mark.parametrize(("at", "expected"), [(11, (1, 0, 0, 1)), (8, (0, 1, 0, 1))])
def test_a_damaged_frame_in_a_stream_is_one_event_wherever_it_is_cut(
    cut: int, at: int, expected: tuple[int, int, int, int]
) -> None:
    stream = flipped(LONG, at) + PLAIN + FLUSH
    framer = Framer(stream=True)
    assert framer.feed(stream[:cut]) + framer.feed(stream[cut : cut + 60]) + framer.feed(stream[cut + 60 :]) == [PLAIN]
    assert counts(framer) == expected  # the flush is the noise


def test_signed_frames_are_accepted_and_kept_whole() -> None:
    from pymavlink.dialects.v20 import common

    sender = common.MAVLink(None, 3, 4)
    sender.signing.secret_key = b"k" * 32
    sender.signing.sign_outgoing = True
    frame = common.MAVLink_heartbeat_message(11, 0, 0, 5, 4, 3).pack(sender)
    framer = Framer(stream=False)
    assert framer.feed(frame + PLAIN) == [frame, PLAIN]
    message = decode(frame)
    assert (message.get_srcSystem(), message.custom_mode, message.mavlink_version) == (3, 5, 3)


def test_a_frame_longer_or_shorter_than_we_know_it() -> None:
    """Newer senders append fields; trailing zeros are cut, down to nothing for those that send an empty payload."""
    from agent.wire.crc import x25crc

    tick = dialect.MAVLink_xitl_tick_message
    for payload, expected in ((bytes([7] * 12 + [1, 2, 3]), 0x07070707), (b"", 0)):
        body = bytes([len(payload), 0, 0, 0, 1, 1]) + tick.id.to_bytes(3, "little") + payload
        checksum = x25crc(body + bytes([tick.crc_extra])).crc
        frame = b"\xfd" + body + checksum.to_bytes(2, "little")
        assert Framer(stream=False).feed(frame) == [frame]
        assert decode(frame).tick == expected


def test_texts_of_any_bytes_decode() -> None:
    message = decode(frame_of(dialect.MAVLink_statustext_message(6, b"\xff\x00\xfe")))
    assert message.text == "\N{REPLACEMENT CHARACTER}"


@pytest.mark.medium
@pytest.mark.parametrize("stream", [False, True])
def test_endless_garbage_takes_bounded_memory(stream: bool) -> None:
    rng = random.Random(5)
    framer = Framer(stream)
    for _ in range(400):
        framer.feed(bytes(rng.choices((0xFD, 0x00, 0x01, 0xD2, 0xF2), k=1000)))
        assert framer.held_bytes < LARGEST_FRAME
    assert adds_up(framer)
    assert framer.feed(FLUSH + PLAIN)[-1:] == [PLAIN]


def test_reset_counts_from_zero_and_keeps_an_unfinished_frame() -> None:
    framer = Framer(stream=True)
    framer.feed(b"noise" + PLAIN[:20])
    framer.reset_counters()
    assert framer.counters.dropped == 0
    assert framer.feed(PLAIN[20:]) == [PLAIN]
    assert framer.counters.bytes_in == framer.counters.bytes_good == len(PLAIN)


UNKNOWN = 168


def beat(packer: Packer) -> bytes:
    return packer.pack(mav.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3))


def foreign(packer: Packer, payload: bytes = b"\xfd" * 20) -> bytes:
    """A frame of another kind, full of what begins a frame."""
    known = packer.pack(mav.MAVLink_system_time_message(1, 2))
    return b"\xfd" + bytes((len(payload), 0, 0)) + known[4:7] + UNKNOWN.to_bytes(3, "little") + payload + b"\xaa\x55"


@pytest.mark.medium
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
