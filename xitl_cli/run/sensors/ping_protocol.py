"""The protocol of Blue Robotics' sonars: frames, and the messages of a Ping360.

    'B' 'R'  length u16  message u16  source u8  destination u8  payload  checksum u16, the sum of all bytes before it

From the maker's public specification of the protocol; numbers are little endian.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

ACK, NACK, GENERAL_REQUEST, DEVICE_INFORMATION, PROTOCOL_VERSION = 1, 2, 6, 4, 5
COMMON_SET_DEVICE_ID = 100
SET_DEVICE_ID, DEVICE_DATA, AUTO_DEVICE_DATA = 2000, 2300, 2301
RESET, TRANSDUCER, AUTO_TRANSMIT, MOTOR_OFF = 2600, 2601, 2602, 2903

TICK_S = 25e-9  # unit of a sample period
MOST_PAYLOAD = 1300  # the longest message of a device has 1220

_START = b"BR"
_HEAD = struct.Struct("<2sHHBB")
_SUM = struct.Struct("<H")
_NUMBER = struct.Struct("<H")
_TRANSDUCER = struct.Struct("<BBHHHHHBB")
_AUTO_TRANSMIT = struct.Struct("<BBHHHHHHBB")
_DEVICE_DATA = struct.Struct("<BBHHHHHH")
_AUTO_DEVICE_DATA = struct.Struct("<BBHHHHHHBBHH")


class PingFrame(NamedTuple):
    """One message. Destination 0 is any device."""

    message: int
    source: int
    destination: int
    payload: bytes


class TransducerCommand(NamedTuple):
    """TRANSDUCER: turn the head and optionally ping. Units are those of the wire format."""

    mode: int
    gain_setting: int
    angle: int
    """Angle of the head in gradians."""
    transmit_duration: int
    """Microseconds."""
    sample_period: int
    """Ticks of 25 ns."""
    transmit_frequency: int
    """Kilohertz."""
    number_of_samples: int
    transmit: int
    """1 to ping, 0 only to turn the head."""
    reserved: int = 0


class AutoTransmitCommand(NamedTuple):
    """AUTO_TRANSMIT: scan a sector clockwise and back. Units are those of TransducerCommand."""

    mode: int
    gain_setting: int
    transmit_duration: int
    sample_period: int
    transmit_frequency: int
    number_of_samples: int
    start_angle: int
    """Start of the sector in gradians. The scan goes clockwise to `stop_angle` and back."""
    stop_angle: int
    """End of the sector in gradians."""
    num_steps: int
    delay: int
    """Additional milliseconds between pings."""


def pack_frame(frame: PingFrame) -> bytes:
    """Return the bytes of a frame."""
    head = _HEAD.pack(_START, len(frame.payload), frame.message, frame.source, frame.destination)
    body = head + frame.payload
    return body + _SUM.pack(sum(body) & 0xFFFF)


def number_in(payload: bytes) -> int | None:
    """Return the u16 at the start of a request or an ack, or None when the payload is too short."""
    return int(_NUMBER.unpack_from(payload)[0]) if len(payload) >= _NUMBER.size else None


def transducer_of(payload: bytes) -> TransducerCommand | None:
    """Return the command, or None for a payload of another length."""
    return TransducerCommand(*_TRANSDUCER.unpack(payload)) if len(payload) == _TRANSDUCER.size else None


def auto_transmit_of(payload: bytes) -> AutoTransmitCommand | None:
    """Return the command, or None for a payload of another length."""
    return AutoTransmitCommand(*_AUTO_TRANSMIT.unpack(payload)) if len(payload) == _AUTO_TRANSMIT.size else None


def ack(message: int) -> bytes:
    """Return the payload of an ACK of a message."""
    return _NUMBER.pack(message)


def nack(message: int, reason: str) -> bytes:
    """Return the payload of a NACK of a message, with the reason in words."""
    return _NUMBER.pack(message) + reason.encode("ascii", "replace")


def device_data(state: TransducerCommand, data: bytes) -> bytes:
    """Return the payload of a DEVICE_DATA."""
    return _DEVICE_DATA.pack(*state[:7], len(data)) + data


def auto_device_data(state: TransducerCommand, scan: AutoTransmitCommand, data: bytes) -> bytes:
    """Return the payload of an AUTO_DEVICE_DATA."""
    return _AUTO_DEVICE_DATA.pack(*state[:6], *scan[6:], state.number_of_samples, len(data)) + data


class PingFramer:
    """Finds frames in a stream of bytes. skipped: bytes outside frames. bad: frames with a wrong checksum."""

    def __init__(self) -> None:
        self.skipped = 0
        self.bad = 0
        self._held = b""

    def feed(self, data: bytes) -> list[PingFrame]:
        """Return the frames that are complete now."""
        held = self._held + data
        frames: list[PingFrame] = []
        place = 0
        while True:
            start = held.find(_START, place)
            if start < 0:
                start = len(held) - held.endswith(_START[:1])
            start = max(start, place)
            self.skipped += start - place
            place = start
            if len(held) - place < _HEAD.size:
                break
            _, length, message, source, destination = _HEAD.unpack_from(held, place)
            end = place + _HEAD.size + length
            if length > MOST_PAYLOAD:
                self.skipped += 1
                place += 1
            elif len(held) < end + _SUM.size:
                break
            elif sum(held[place:end]) & 0xFFFF != _SUM.unpack_from(held, end)[0]:
                self.bad += 1
                self.skipped += 1
                place += 1
            else:
                frames.append(PingFrame(message, source, destination, held[place + _HEAD.size : end]))
                place = end + _SUM.size
        self._held = held[place:]
        return frames
