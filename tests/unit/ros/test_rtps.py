"""The wire of DDS: what is written is read again, and bytes from outside raise nothing."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xitl_cli.ros import rtps
from xitl_cli.ros.rtps_services import Received

PREFIX, OTHER = bytes(range(12)), bytes(range(12, 24))
READER, WRITER = b"\0\0\1\4", b"\0\0\1\3"


def only_part(packet: bytes) -> tuple[bytes, rtps.Submessage]:
    found = rtps.read_packet(packet)
    assert found is not None
    assert found.prefix == PREFIX
    (part,) = found.parts
    return part


def test_data_is_read_as_written() -> None:
    payload, related = b"\0\1\0\0\1", (rtps.PID_RELATED, bytes(24))
    written = rtps.data(READER, WRITER, 2**33 + 5, payload, [related])
    destination, part = only_part(rtps.packet(PREFIX, [written], OTHER))
    assert destination == OTHER
    assert (part.reader, part.writer, part.first) == (READER, WRITER, 2**33 + 5)
    assert part.inline == dict([related])
    assert part.payload == payload + b"\0\0\0"


def test_what_is_missing_is_the_bits_of_an_acknack() -> None:
    _, part = only_part(rtps.packet(PREFIX, [rtps.acknack(READER, WRITER, 7, [7, 9, 40], 1)]))
    assert (part.first, part.numbers, part.final) == (7, (7, 9, 40), False)
    _, part = only_part(rtps.packet(PREFIX, [rtps.acknack(READER, WRITER, 7, [], 2)]))
    assert (part.first, part.numbers, part.final) == (7, (), True)


def test_an_acknack_is_laid_out_as_the_standard_has_it() -> None:
    """DDSI-RTPS 2.3, 9.4.2.6: the example 1234/12:00110 is base 1234, 12 bits, 1236 and 1237 missing."""
    body = rtps.acknack(READER, WRITER, 1234, [1236, 1237], 3)
    assert body[:4] == struct.pack("<BBH", rtps.ACKNACK, 1, 28)
    assert struct.unpack("<iIII", body[12:28]) == (0, 1234, 4, 0b0011 << 28)


def test_a_heartbeat_is_read_as_written() -> None:
    _, part = only_part(rtps.packet(PREFIX, [rtps.heartbeat(READER, WRITER, 1, 5, 9)]))
    assert (part.kind, part.first, part.last, part.final) == (rtps.HEARTBEAT, 1, 5, False)


def test_parameters_are_read_in_either_byte_order() -> None:
    little = rtps.PARAMETERS_LE + rtps.parameters([(rtps.PID_TOPIC, rtps.text("rq/armRequest"))])
    assert rtps.read_text(rtps.read_parameters(little)[rtps.PID_TOPIC][0]) == "rq/armRequest"
    big = b"\0\2\0\0" + struct.pack(">HHI4s", rtps.PID_TOPIC, 8, 4, b"abc\0") + struct.pack(">HH", 1, 0)
    assert rtps.read_text(rtps.read_parameters(big)[rtps.PID_TOPIC][0], rtps.number_order(big)) == "abc"


def test_a_locator_is_of_udp_over_ipv4() -> None:
    assert rtps.read_locator(rtps.locator("192.0.2.7", 7410)) == ("192.0.2.7", 7410)
    shared_memory = struct.pack("<iI16x", 16, 7410)
    assert rtps.read_locator(shared_memory) is None


@given(st.binary(max_size=200))
def test_bytes_from_outside_raise_nothing(noise: bytes) -> None:
    rtps.read_packet(noise)
    rtps.read_packet(b"RTPS\2\3\1\x0f" + PREFIX + noise)
    for kind in (rtps.DATA, rtps.HEARTBEAT, rtps.ACKNACK, rtps.GAP):
        rtps.read_packet(b"RTPS\2\3\1\x0f" + PREFIX + struct.pack("<BBH", kind, 7, len(noise)) + noise)


@pytest.mark.parametrize("order", [(1, 2, 3, 4), (4, 3, 2, 1), (2, 2, 1, 4)])
def test_samples_are_had_once_and_missing_ones_are_known(order: tuple[int, ...]) -> None:
    received = Received()
    assert [received.add(number) for number in order].count(True) == len(set(order))
    base, missing = received.missing(5)
    assert missing == sorted({1, 2, 3, 4, 5} - set(order))
    assert base == missing[0]
    received.skip_to(5)
    assert received.missing(5) == (5, [5])
