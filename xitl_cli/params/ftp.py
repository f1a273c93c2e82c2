"""Files on a vehicle, by MAVLink FTP: checksum, folder, read, write. One request at a time, repeated till answered.

The protocol is that of mavlink.io/en/services/ftp.html. A repeated request keeps its sequence number, by which the
vehicle knows it again and only repeats its answer; so nothing is done twice.
"""

from __future__ import annotations

import random
import struct
import time
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

from agent.wire import dialect
from xitl_cli.errors import UserError
from xitl_cli.params.vehicle import Vehicle

ANSWER_S = 0.7
TRIES = 8
BUSY_S = 4.0  # ArduPilot gives up the session of a client that has been silent for 3 s
PAYLOAD_BYTES = 251
DATA_BYTES = 239
_HEADER = struct.Struct("<HBBBBBxI")  # sequence, session, operation, size, answered operation, burst, offset

TERMINATE, LIST, OPEN, READ, CREATE, WRITE, MAKE_DIRECTORY, CHECKSUM = 1, 3, 4, 5, 6, 7, 9, 14
_ACK, _NAK = 128, 129
FAIL, FAIL_ERRNO, INVALID_SESSION, NO_SESSION, FILE_EXISTS, FILE_NOT_FOUND = 1, 2, 4, 5, 8, 10
_NO_MORE = 6  # how a folder's list ends, that of an empty one at once
_NO_SUCH_FILE = 2  # ENOENT
_BUSY = (INVALID_SESSION, NO_SESSION)
_REASONS = {
    FAIL: "it fails there",
    FAIL_ERRNO: "its file system fails",
    3: "the request has a wrong size",
    INVALID_SESSION: "another client is busy with its files",
    NO_SESSION: "other clients are busy with its files",
    _NO_MORE: "the file has ended",
    7: "it does not know this operation",
    FILE_EXISTS: "it exists",
    9: "it is protected",
    FILE_NOT_FOUND: "there is no such file or folder",
}


class RefusedError(Exception):
    """The vehicle said no. `code` is of the protocol, `errno` of its file system, where that failed."""

    def __init__(self, data: bytes) -> None:
        self.code = data[0] if data else FAIL
        self.errno = data[1] if self.code == FAIL_ERRNO and len(data) > 1 else 0
        also = f" (error {self.errno})" if self.errno else ""
        super().__init__(f"{_REASONS.get(self.code, f'it answers with error {self.code}')}{also}")

    @property
    def nothing_there(self) -> bool:
        """Whether a file or folder is missing, as far as it says: some builds only say that it failed."""
        return self.code in (FAIL, FILE_NOT_FOUND) or self.errno == _NO_SUCH_FILE


class _Answer(NamedTuple):
    session: int
    data: bytes


def checksum(content: bytes) -> int:
    """CRC-32 as MAVLink FTP has it: that of zlib without its inversions."""
    return ~zlib.crc32(content, 0xFFFFFFFF) & 0xFFFFFFFF


class Files:
    """The files of one vehicle. Raises UserError when it does not answer, RefusedError when it says no."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._sequence = random.randrange(1 << 16)  # a vehicle could take a known one for a repetition
        self._session = random.randrange(1, 256)

    def checksum(self, path: str) -> int | None:
        """Of a file there; None when there is none."""
        try:
            data = self._ask(CHECKSUM, path.encode()).data
        except RefusedError as refusal:
            if refusal.nothing_there or refusal.code == FAIL_ERRNO:
                return None
            raise
        return int.from_bytes(data[:4], "little")

    def has_folder(self, path: str) -> bool:
        """Whether there is such a folder, an empty one too."""
        try:
            self._ask(LIST, path.encode())
        except RefusedError as refusal:
            if refusal.code == _NO_MORE:
                return True
            if refusal.nothing_there or refusal.code == FAIL_ERRNO:
                return False
            raise
        return True

    def make_folder(self, path: str) -> None:
        """One that is there is fine."""
        try:
            self._ask(MAKE_DIRECTORY, path.encode())
        except RefusedError:
            if not self.has_folder(path):
                raise

    def read(self, path: str, most: int) -> bytes:
        """What is in a file, `most` bytes at most: the size that a made-up file (@SYS/…) tells is not its own."""
        session = self._ask(OPEN, path.encode()).session
        content = b""
        try:
            while len(content) < most:
                data = self._ask(READ, b"", len(content), session, wanted=DATA_BYTES).data
                if not data:
                    break
                content += data
        except RefusedError as refusal:
            if refusal.code != _NO_MORE:
                raise
        finally:
            self._ask(TERMINATE, b"", 0, session)
        return content[:most]

    def write(self, path: str, content: bytes, progress: Callable[[float], None] = lambda done: None) -> None:
        """Write a file anew; `progress` hears what part is done."""
        session = self._ask(CREATE, path.encode()).session
        try:
            for offset in range(0, len(content), DATA_BYTES):
                chunk = content[offset : offset + DATA_BYTES]
                self._ask(WRITE, chunk, offset, session)
                progress((offset + len(chunk)) / len(content))
        finally:
            self._ask(TERMINATE, b"", 0, session)

    def _ask(
        self, operation: int, data: bytes, offset: int = 0, session: int | None = None, wanted: int | None = None
    ) -> _Answer:
        """`wanted`: bytes to read, where that is asked for."""
        deadline_s = time.monotonic() + BUSY_S
        while True:
            try:
                return self._ask_once(operation, data, offset, self._session if session is None else session, wanted)
            except RefusedError as refusal:
                if refusal.code not in _BUSY or time.monotonic() > deadline_s:
                    raise
            time.sleep(0.2)

    def _ask_once(self, operation: int, data: bytes, offset: int, session: int, wanted: int | None) -> _Answer:
        sequence = self._sequence
        expected = (sequence + 1) & 0xFFFF
        self._sequence = (sequence + 2) & 0xFFFF
        header = _HEADER.pack(sequence, session, operation, len(data) if wanted is None else wanted, 0, 0, offset)
        payload = (header + data).ljust(PAYLOAD_BYTES, b"\0")
        message = dialect.MAVLink_file_transfer_protocol_message(0, *self._vehicle.target, payload)
        for _ in range(TRIES):
            self._vehicle.send(message)
            deadline_s = time.monotonic() + ANSWER_S
            while time.monotonic() < deadline_s:
                for answer in self._vehicle.receive(0.05):
                    found = _answer(answer, expected, operation)
                    if found is not None:
                        return found
        raise UserError(
            "the vehicle does not answer to MAVLink FTP; use its USB or network link, and firmware that has it"
        )


def _answer(message: Any, sequence: int, operation: int) -> _Answer | None:
    """The answer, if it is the one; RefusedError if it is a no."""
    if message.get_msgId() != dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL:
        return None
    payload = bytes(message.payload)
    number, session, kind, size, answered, _, _ = _HEADER.unpack_from(payload)
    if number != sequence or answered != operation:
        return None
    data = payload[_HEADER.size : _HEADER.size + size]
    if kind == _NAK:
        raise RefusedError(data)
    return _Answer(session, data) if kind == _ACK else None
