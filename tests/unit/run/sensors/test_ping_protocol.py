"""Frames of the sonar's protocol: the maker's own parser as truth, and bytes that are none."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xitl_cli.run.sensors import ping_protocol as wire
from xitl_cli.run.sensors.ping_protocol import PingFrame, PingFramer, pack_frame

REQUEST = PingFrame(wire.GENERAL_REQUEST, 0, 0, wire.ack(wire.PROTOCOL_VERSION))


def test_a_frame_is_as_the_specification_says() -> None:
    """B R, length 2, message 6, from 0 to 0, payload 5; the sum of these bytes is 66 + 82 + 2 + 6 + 5 = 161."""
    assert pack_frame(REQUEST) == bytes([0x42, 0x52, 2, 0, 6, 0, 0, 0, 5, 0, 161, 0])


def test_frames_are_found_in_pieces_and_among_noise() -> None:
    framer = PingFramer()
    data = b"UUBUBB" + pack_frame(REQUEST) + b"BRx" + pack_frame(REQUEST)
    found = [frame for byte in data for frame in framer.feed(bytes([byte]))]
    assert found[0] == REQUEST
    found += framer.feed(bytes(2000))  # what "BRx" began turns out to be none
    found += framer.feed(pack_frame(REQUEST))
    assert found.count(REQUEST) == 3


def test_a_damaged_frame_is_counted_and_the_next_is_found() -> None:
    framer = PingFramer()
    damaged = bytearray(pack_frame(REQUEST))
    damaged[8] ^= 1
    assert framer.feed(bytes(damaged) + pack_frame(REQUEST)) == [REQUEST]
    assert (framer.bad, framer.skipped) == (1, len(damaged))


def test_a_length_that_cannot_be_holds_nothing_up() -> None:
    framer = PingFramer()
    assert framer.feed(b"BR\xff\xff\x06\x00\x00\x00" + pack_frame(REQUEST)) == [REQUEST]


@pytest.mark.medium
@given(st.lists(st.binary(max_size=64), max_size=12))
def test_no_bytes_raise(chunks: list[bytes]) -> None:
    framer = PingFramer()
    for chunk in chunks:
        framer.feed(b"BR" + chunk)
        framer.feed(chunk)


@pytest.mark.parametrize("samples", [0, 200, 1200])
def test_the_makers_parser_reads_what_is_packed(samples: int) -> None:
    pingmessage = pytest.importorskip("brping.pingmessage")
    state = wire.TransducerCommand(1, 2, 399, 1000, 40000, 850, samples, 1)
    scan = wire.AutoTransmitCommand(1, 2, 1000, 40000, 850, samples, 350, 50, 10, 100)
    data = bytes(number % 251 for number in range(samples))
    for message, payload in (
        (wire.DEVICE_DATA, wire.device_data(state, data)),
        (wire.AUTO_DEVICE_DATA, wire.auto_device_data(state, scan, data)),
    ):
        parser = pingmessage.PingParser()
        states = [parser.parse_byte(byte) for byte in pack_frame(PingFrame(message, 2, 0, payload))]
        assert states[-1] == parser.NEW_MESSAGE
        read = parser.rx_msg
        assert read.message_id == message
        assert bytes(read.data) == data
        names = ("gain_setting", "angle", "transmit_duration", "sample_period", "transmit_frequency")
        assert [getattr(read, name) for name in names] == [2, 399, 1000, 40000, 850]
        assert read.number_of_samples == read.data_length == samples
    assert [getattr(read, name) for name in ("start_angle", "stop_angle", "num_steps", "delay")] == [350, 50, 10, 100]


def test_the_makers_commands_are_read() -> None:
    pingmessage = pytest.importorskip("brping.pingmessage")
    for message, values, read in (
        (wire.TRANSDUCER, (1, 2, 399, 500, 2000, 800, 600, 1, 0), wire.transducer_of),
        (wire.AUTO_TRANSMIT, (1, 2, 500, 2000, 800, 600, 10, 390, 4, 7), wire.auto_transmit_of),
    ):
        command = pingmessage.PingMessage(message)
        for name, value in zip(command.payload_field_names, values, strict=True):
            setattr(command, name, value)
        (frame,) = PingFramer().feed(bytes(command.pack_msg_data()))
        assert frame.message == message
        found = read(frame.payload)
        assert found is not None
        assert found._asdict() == dict(zip(command.payload_field_names, values, strict=True))
        assert read(frame.payload[:-1]) is None


def test_a_reason_stays_ascii() -> None:
    assert wire.nack(7, "100 % zu groß") == struct.pack("<H", 7) + b"100 % zu gro?"
