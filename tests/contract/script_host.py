"""Runs the HIL script under a Lua interpreter, with ArduPilot's scripting interface played by a file of records."""

from __future__ import annotations

import binascii
import shutil
import struct
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "firmware_params" / "lua" / "xitl_hil.lua"
HOST = ROOT / "tests" / "doubles" / "autopilot_scripting.lua"
INTERPRETERS = ("lua5.3", "lua5.4", "lua")

IMU, INS, GNSS = b"\x01\x21\x07", b"\x31\x01\x00\x06\x01\x13\x06", b"\x49\x03\x00\xb8\x26\x18\x00"
BODIES = {  # after the header, as the driver of ArduPilot lays its packets out
    IMU: struct.Struct("<Q3f3f3f3f3fff"),
    INS: struct.Struct("<Q3f4f3fH3d3fff"),
    GNSS: struct.Struct("<QQBB3d3f3ff7fBB"),
}


def interpreter() -> str:
    """A Lua of 5.3 or later; the test is skipped when there is none."""
    for name in INTERPRETERS:
        found = shutil.which(name)
        if found:
            return found
    pytest.skip(f"needs a Lua interpreter: one of {', '.join(INTERPRETERS)}")


def raw(message: Any, sequence: int = 0, system: int = 255, component: int = 190) -> bytes:
    """A pymavlink message as ArduPilot's scripts get it: the C structure, zeros behind the payload."""
    from pymavlink.dialects.v20 import ardupilotmega as mav

    frame = bytes(message.pack(mav.MAVLink(None, system, component)))
    length = frame[1]
    header = struct.pack("<HBBBBBBB", 0, 0xFD, length, 0, 0, sequence, system, component)
    return (header + frame[7:10] + frame[10 : 10 + length]).ljust(291, b"\0")


@dataclass
class Told:
    """What a script did. frames: those for the driver, by header, unpacked. `left` is what was no good frame."""

    answers: list[bytes] = field(default_factory=list)
    frames: list[tuple[bytes, tuple[Any, ...]]] = field(default_factory=list)
    texts: list[tuple[int, str]] = field(default_factory=list)
    values: list[tuple[str, float]] = field(default_factory=list)
    periods: list[int] = field(default_factory=list)
    left: bytes = b""

    def last(self, name: str) -> float:
        """The newest number by that name."""
        return [value for key, value in self.values if key == name][-1]

    def of(self, header: bytes) -> list[tuple[Any, ...]]:
        """Frames of a kind."""
        return [body for kind, body in self.frames if kind == header]


class Script:
    """Collects what is to happen; `play` runs the script with it."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._records = b""

    def add(self, kind: bytes, content: bytes) -> Script:
        self._records += kind + struct.pack("<H", len(content)) + content
        return self

    def run(self, after_ms: int = 2) -> Script:
        return self.add(b"R", struct.pack("<I", after_ms))

    def driver(self, command: str) -> Script:
        total = 0
        for byte in command.encode():
            total ^= byte
        return self.add(b"D", f"${command}*{total:02X}\r\n".encode())

    def message(self, message: Any) -> Script:
        return self.add(b"M", raw(message))

    def connect(self) -> Script:
        """Start the script, and the driver's whole handshake."""
        self.run()
        for command in HANDSHAKE:
            self.driver(command).run()
        return self

    def play(self) -> Told:
        source, result = self._directory / "in", self._directory / "out"
        source.write_bytes(self._records)
        command = [interpreter(), str(HOST), str(SCRIPT), str(source), str(result)]
        ran = subprocess.run(command, capture_output=True, text=True)
        assert ran.returncode == 0, ran.stderr
        return _told(result.read_bytes())


HANDSHAKE = (
    "VNASY,0",
    "VNWRG,06,0,1",
    "VNWRG,06,0,2",
    "VNRRG,01",
    "VNWRG,75,3,4,01,0721",
    "VNWRG,76,3,16,31,0001,0106,0613",
    "VNWRG,77,3,160,49,0003,26B8,0018",
    "VNASY,1",
)


def _told(records: bytes) -> Told:
    told, line = Told(), b""
    while records:
        kind, (length,) = records[:1], struct.unpack_from("<H", records, 1)
        content, records = records[3 : 3 + length], records[3 + length :]
        if kind == b"D":
            line += content
        elif kind == b"T":
            told.texts.append((content[0], content[1:].decode()))
        elif kind == b"N":
            name, _, value = content.decode().partition("=")
            told.values.append((name, float(value)))
        else:
            told.periods.append(struct.unpack("<I", content)[0])
    told.left = _read_line(line, told)
    return told


def _read_line(line: bytes, told: Told) -> bytes:
    """Sentences and frames as the driver finds them, each with its checksum."""
    left = b""
    while line:
        if line[:1] == b"$" and b"\r\n" in line:
            sentence, _, line = line.partition(b"\r\n")
            body, _, checksum = sentence[1:].partition(b"*")
            total = 0
            for byte in body:
                total ^= byte
            assert int(checksum, 16) == total, sentence
            told.answers.append(body)
            continue
        header = next((header for header in BODIES if line.startswith(b"\xfa" + header)), None)
        size = 0 if header is None else 1 + len(header) + BODIES[header].size + 2
        if header is not None and len(line) >= size and binascii.crc_hqx(line[1:size], 0) == 0:
            told.frames.append((header, BODIES[header].unpack(line[1 + len(header) : size - 2])))
            line = line[size:]
        else:
            left, line = left + line[:1], line[1:]
    return left
