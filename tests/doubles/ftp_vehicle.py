"""A vehicle with files, by pymavlink's codec: sessions and repetitions are as at ArduPilot's server."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

ACK, NAK = 128, 129
FAIL, FAIL_ERRNO, INVALID_SESSION, FILE_EXISTS, FILE_NOT_FOUND = 1, 2, 4, 8, 10


@dataclass
class FtpVehicle:
    """files: contents by path. lose: every so many requests and answers are lost. busy: a session that is not ours.

    late: before each answer comes that to the request before. no_card: its file system fails. spoil: what it writes
    comes out damaged. done: operations that it carried out.
    """

    folders: set[str] = field(default_factory=set)
    files: dict[str, bytes] = field(default_factory=dict)
    lose: int = 0
    busy: int = 0
    no_card: bool = False
    spoil: bool = False
    deaf: bool = False
    late: bool = False
    done: list[int] = field(default_factory=list)
    _open: tuple[int, str] | None = None
    _last: tuple[int, int, bytes] | None = None
    _count: int = 0

    @property
    def latest(self) -> bytes | None:
        """Its latest answer."""
        return None if self._last is None else self._last[2]

    def answer(self, request: bytes) -> bytes | None:
        """The payload of its answer, None for silence."""
        sequence, session, operation, size, _, _, offset = struct.unpack_from("<HBBBBBxI", request)
        data = request[12 : 12 + size]
        self._count += 2
        if self.deaf or (self.lose and self._count % self.lose == 0):
            return None
        if self._last is not None and self._last[:2] == (sequence, session):
            return self._last[2]
        kind, content = self._carry_out(operation, session, offset, data)
        head = struct.pack("<HBBBBBxI", (sequence + 1) & 0xFFFF, session, kind, len(content), operation, 0, offset)
        reply = (head + content).ljust(251, b"\0")
        self._last = (sequence, session, reply)
        return None if self.lose and (self._count + 1) % self.lose == 0 else reply

    def _carry_out(self, operation: int, session: int, offset: int, data: bytes) -> tuple[int, bytes]:
        self.done.append(operation)
        path = str(PurePosixPath("/", data.decode("latin-1"))) if operation in (3, 6, 9, 14) else ""
        if operation == 1:
            self._open = None
            return ACK, b""
        if self.busy > 0:
            self.busy -= 1
            return NAK, bytes([INVALID_SESSION])
        if operation == 3:
            inside = [name for name in self.folders if str(PurePosixPath(name).parent) == path]
            if path not in self.folders:
                return NAK, bytes([FILE_NOT_FOUND])
            return (ACK, b"D" + inside[0].encode() + b"\0") if inside else (NAK, bytes([6]))
        if operation == 9:
            if self.no_card:
                return NAK, bytes([FAIL_ERRNO, 30])
            if path in self.folders:
                return NAK, bytes([FILE_EXISTS])
            self.folders.add(path)
            return ACK, b""
        if operation == 14:
            if path not in self.files:
                return NAK, bytes([FAIL])
            return ACK, struct.pack("<I", crc32(self.files[path]))
        if operation == 6:
            if str(PurePosixPath(path).parent) not in self.folders:
                return NAK, bytes([FILE_NOT_FOUND])
            self.files[path] = b""
            self._open = (session, path)
            return ACK, b""
        if operation == 7 and self._open is not None and self._open[0] == session:
            held = self.files[self._open[1]]
            data = b"?" + data[1:] if self.spoil else data
            self.files[self._open[1]] = held[:offset].ljust(offset, b"\0") + data + held[offset + len(data) :]
            return ACK, b""
        return NAK, bytes([FAIL])


def crc32(content: bytes) -> int:
    """By the table of CRC-32 bit by bit: no start value, no inversion."""
    total = 0
    for byte in content:
        total ^= byte
        for _ in range(8):
            total = total >> 1 ^ (0xEDB88320 if total & 1 else 0)
    return total


@contextmanager
def listening(vehicle: FtpVehicle) -> Iterator[str]:
    """At a TCP port, for one client after the other."""
    stop = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.02)
        thread = threading.Thread(target=_serve, args=(server, vehicle, stop))
        thread.start()
        try:
            yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        finally:
            stop.set()
            thread.join()


def _serve(server: socket.socket, vehicle: FtpVehicle, stop: threading.Event) -> None:
    while not stop.is_set():
        try:
            peer, _ = server.accept()
        except TimeoutError:
            continue
        with peer, suppress(ConnectionError):  # the client went with an answer unread
            peer.settimeout(0.004)
            _talk(peer, vehicle, stop)


def _talk(peer: socket.socket, vehicle: FtpVehicle, stop: threading.Event) -> None:
    codec: Any = mav.MAVLink(None, 1, 1)
    codec.robust_parsing = True
    beats = 0
    while not stop.is_set():
        if beats % 10 == 0:
            peer.sendall(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_SURFACE_BOAT, 3, 1, 0, 3, 3).pack(codec))
        beats += 1
        try:
            data = peer.recv(65536)
        except TimeoutError:
            continue
        if not data:
            return
        for message in codec.parse_buffer(bytearray(data)) or []:
            if message.get_type() == "FILE_TRANSFER_PROTOCOL":
                before, reply = vehicle.latest, vehicle.answer(bytes(message.payload))
                for payload in (before if vehicle.late else None, reply):
                    if payload is not None:
                        peer.sendall(mav.MAVLink_file_transfer_protocol_message(0, 254, 191, payload).pack(codec))
