"""What a real autopilot sent at its simulator interface and its MAVLink port, by frame of its simulator.

Of PX4, whose frame is a HIL_SENSOR, what was sent to it is there too.
"""

from __future__ import annotations

import lzma
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

_HEAD = struct.Struct("<BIH")
OUTPUTS, MAVLINK, SENSORS, COMMANDS = 0, 1, 2, 3


@dataclass(frozen=True)
class Record:
    """`frame`: the simulator frame of it.

    kind: OUTPUTS from its simulator interface, of ArduPilot in force until the next; MAVLINK bytes from it; SENSORS to
    its simulator interface; COMMANDS, MAVLink to it.
    """

    kind: int
    frame: int
    data: bytes


class CaptureWriter:
    """Records into a compressed file. A servo packet that says the same as the last one is left out."""

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = lzma.open(path, "wb", preset=9)  # noqa: SIM115  closed by `close`
        self._outputs = b""

    def outputs(self, frame: int, packet: bytes) -> None:
        if _said(packet) != self._outputs:
            self._outputs = _said(packet)
            self.write(OUTPUTS, frame, packet)

    def mavlink(self, frame: int, data: bytes) -> None:
        self.write(MAVLINK, frame, data)

    def write(self, kind: int, frame: int, data: bytes) -> None:
        self._file.write(_HEAD.pack(kind, frame, len(data)) + data)

    def close(self) -> None:
        self._file.close()


def _said(packet: bytes) -> bytes:
    """All but the frame count."""
    return packet[:4] + packet[8:]


def read_capture(path: Path) -> Iterator[Record]:
    """The records in the order in which they were sent."""
    with lzma.open(path) as file:
        while head := file.read(_HEAD.size):
            kind, frame, length = _HEAD.unpack(head)
            yield Record(kind, frame, file.read(length))


def frame_of(packet: bytes) -> int:
    """The frame count of a servo packet."""
    return int.from_bytes(packet[4:8], "little")


def at_frame(packet: bytes, frame: int) -> bytes:
    """The same servo packet at another frame."""
    return packet[:4] + struct.pack("<I", frame) + packet[8:]
