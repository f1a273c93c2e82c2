"""MAVLink FTP (mavlink.io/en/services/ftp.html), client: checksum, folder, read, write, one operation at a time.

A repeated request keeps its sequence number, by which the vehicle recognises it and only repeats its answer. So nothing
is executed twice. The answer is also an FtpPacket: ACK or NAK, the sequence number plus one, and `requested` is the
operation.
"""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Generator
from typing import Any, Callable, Generic, NamedTuple, TypeVar

from agent.mavlink.exchange import Messages, Target, Timer
from agent.wire import dialect as mav

ANSWER_S = 0.7
TRIES = 8
BUSY_S = 4.0  # ArduPilot releases the session of a client that has been silent for 3 s
BUSY_PAUSE_S = 0.2
PAYLOAD_BYTES = 251
DATA_BYTES = 239
_HEADER = struct.Struct("<HBBBBBxI")

TERMINATE, LIST, OPEN, READ, CREATE, WRITE, MAKE_DIRECTORY, CHECKSUM = 1, 3, 4, 5, 6, 7, 9, 14
NONE, RESET, REMOVE_FILE, REMOVE_DIRECTORY, OPEN_TO_WRITE, TRUNCATE, RENAME, BURST = 0, 2, 8, 10, 11, 12, 13, 15
ACK, NAK = 128, 129
FAIL, FAIL_ERRNO, INVALID_SIZE, INVALID_SESSION, NO_SESSION, END_OF_FILE = 1, 2, 3, 4, 5, 6
UNKNOWN_COMMAND, FILE_EXISTS, FILE_PROTECTED, FILE_NOT_FOUND = 7, 8, 9, 10
_NO_SUCH_FILE = 2  # ENOENT
_BUSY = (INVALID_SESSION, NO_SESSION)
_REASONS = {
    FAIL: "the operation fails there",
    FAIL_ERRNO: "its file system fails",
    INVALID_SIZE: "the request has a wrong size",
    INVALID_SESSION: "another client uses its files",
    NO_SESSION: "other clients use its files",
    END_OF_FILE: "the file has ended",
    UNKNOWN_COMMAND: "it does not support this operation",
    FILE_EXISTS: "the file exists",
    FILE_PROTECTED: "the file is protected",
    FILE_NOT_FOUND: "there is no such file or folder",
}

Result = TypeVar("Result")


class FtpRefusedError(Exception):
    """Raised when the vehicle refuses.

    `code` is the protocol's error code; `errno` is its file system's error, 0 for none.
    """

    def __init__(self, data: bytes) -> None:
        self.code = data[0] if data else FAIL
        self.errno = data[1] if self.code == FAIL_ERRNO and len(data) > 1 else 0
        also = f" (error {self.errno})" if self.errno else ""
        super().__init__(f"{_REASONS.get(self.code, f'it answers with error {self.code}')}{also}")

    @property
    def nothing_there(self) -> bool:
        """Whether a file or folder is missing, as far as reported: some builds only report a failure."""
        return self.code in (FAIL, FILE_NOT_FOUND) or self.errno == _NO_SUCH_FILE


class FtpSilentError(Exception):
    """Raised when the vehicle did not answer TRIES times."""

    def __init__(self) -> None:
        super().__init__(
            "the vehicle does not answer MAVLink FTP; use its USB or network link, and firmware that supports it"
        )


class FtpPacket(NamedTuple):
    """Payload of FILE_TRANSFER_PROTOCOL."""

    sequence: int
    session: int
    operation: int
    size: int
    """Size of `data`, or the requested number of bytes."""
    requested: int = 0
    """Operation that is answered."""
    offset: int = 0
    data: bytes = b""
    ends_burst: bool = False
    """Whether this is the last packet of the requested burst."""

    def pack(self) -> bytes:
        """Return the bytes of the payload."""
        sequence, session, operation, size, requested, offset, _, ends_burst = self
        head = _HEADER.pack(sequence, session, operation, size, requested, ends_burst, offset)
        return (head + self.data).ljust(PAYLOAD_BYTES, b"\0")

    @classmethod
    def from_payload(cls, payload: bytes) -> FtpPacket:
        """Parse a payload of PAYLOAD_BYTES."""
        sequence, session, operation, size, requested, ends_burst, offset = _HEADER.unpack_from(payload)
        data = payload[_HEADER.size : _HEADER.size + size]
        return cls(sequence, session, operation, size, requested, offset, data, bool(ends_burst))


class FtpRequest(NamedTuple):
    """Request of an operation."""

    operation: int
    data: bytes = b""
    offset: int = 0
    session: int | None = None
    """None for the client's own session."""
    wanted: int | None = None
    """Number of bytes to read, None for other operations."""


FtpSteps = Generator[FtpRequest, FtpPacket, Result]
"""An operation on files: yields its requests, receives their answers, returns its result. FtpClient executes it."""


class FtpClient:
    """Client of the file service of `target`, for one operation at a time."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._sequence = random.randrange(1 << 16)  # a vehicle could treat a known number as a repetition
        self._session = random.randrange(1, 256)

    def start(self, steps: FtpSteps[Result]) -> FtpOperation[Result]:
        """Return an exchange that executes an operation."""
        return FtpOperation(self, steps)

    def packet(self, request: FtpRequest) -> FtpPacket:
        """Return the packet of a request, with a new sequence number."""
        sequence = self._sequence
        self._sequence = (sequence + 2) & 0xFFFF
        session = self._session if request.session is None else request.session
        size = len(request.data) if request.wanted is None else request.wanted
        return FtpPacket(sequence, session, request.operation, size, 0, request.offset, request.data)

    def message(self, packet: FtpPacket) -> Any:
        """Return FILE_TRANSFER_PROTOCOL with this payload."""
        return mav.MAVLink_file_transfer_protocol_message(0, *self._target, packet.pack())


class FtpOperation(Generic[Result]):
    """An exchange of the requests of an operation. Each request is repeated until it is answered."""

    def __init__(self, client: FtpClient, steps: FtpSteps[Result]) -> None:
        self.done = False
        self._client = client
        self._steps = steps
        self._packet: FtpPacket | None = None
        self._tries = 0
        self._timer = Timer()
        self._pause = Timer()
        self._busy = Timer()
        self._result: Result | None = None
        self._error: Exception | None = None
        self._advance(lambda: next(steps))

    @property
    def result(self) -> Result:
        """Result, once `done`. Raises FtpRefusedError or FtpSilentError if the operation failed."""
        if self._error is not None:
            raise self._error
        return self._result  # type: ignore[return-value]

    def poll(self, now_ns: int) -> Messages:
        if self._packet is None:
            if self.done or (self._pause.started and not self._pause.is_over(now_ns, BUSY_PAUSE_S)):
                return []
            if not self._busy.started:
                self._busy.start(now_ns)
            self._packet, self._tries = self._client.packet(self._request), 0
        elif not self._timer.is_over(now_ns, ANSWER_S):
            return []
        elif self._tries == TRIES:
            self._advance(lambda: self._steps.throw(FtpSilentError()))
            return self.poll(now_ns)
        self._timer.start(now_ns)
        self._tries += 1
        return [self._client.message(self._packet)]

    def handle(self, message: Any, now_ns: int) -> Messages:
        asked = self._packet
        if asked is None or message.get_msgId() != mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL:
            return []
        answer = FtpPacket.from_payload(bytes(message.payload))
        if answer.sequence != (asked.sequence + 1) & 0xFFFF or answer.requested != asked.operation:
            return []
        if answer.operation == ACK:
            self._advance(lambda: self._steps.send(answer))
        elif answer.operation == NAK:
            refusal = FtpRefusedError(answer.data)
            if refusal.code in _BUSY and not self._busy.is_over(now_ns, BUSY_S):
                self._packet = None
                self._pause.start(now_ns)
            else:
                self._advance(lambda: self._steps.throw(refusal))
        return []

    def _advance(self, step: Callable[[], FtpRequest]) -> None:
        """Continue with the next request, or end."""
        self._packet = None
        self._pause.stop()
        self._busy.stop()
        try:
            self._request = step()
        except StopIteration as end:
            self._result, self.done = end.value, True
        except (FtpRefusedError, FtpSilentError) as error:
            self._error, self.done = error, True


# -- operations


def read_checksum(path: str) -> FtpSteps[int | None]:
    """Return the checksum of a remote file, as `checksum` computes it. None for a missing file."""
    try:
        answer = yield FtpRequest(CHECKSUM, path.encode())
    except FtpRefusedError as refusal:
        if refusal.nothing_there or refusal.code == FAIL_ERRNO:
            return None
        raise
    return int.from_bytes(answer.data[:4], "little")


def has_folder(path: str) -> FtpSteps[bool]:
    """Return whether a folder exists. It may be empty."""
    try:
        yield FtpRequest(LIST, path.encode())
    except FtpRefusedError as refusal:
        if refusal.code == END_OF_FILE:  # end of a folder's list, which an empty folder returns at once
            return True
        if refusal.nothing_there or refusal.code == FAIL_ERRNO:
            return False
        raise
    return True


def make_folder(path: str) -> FtpSteps[None]:
    """Make a folder. An existing one is accepted."""
    try:
        yield FtpRequest(MAKE_DIRECTORY, path.encode())
    except FtpRefusedError:
        if not (yield from has_folder(path)):
            raise


def read_file(path: str, most: int) -> FtpSteps[bytes]:
    """Return the content of a file, at most `most` bytes. The reported size of a virtual file (@SYS/…) may be wrong."""
    session = (yield FtpRequest(OPEN, path.encode())).session
    return (yield from _closing(session, _read(session, most)))


def write_file(path: str, content: bytes, progress: Callable[[float], object] = lambda part: None) -> FtpSteps[None]:
    """Write a new file. progress: called with the completed part, 0 to 1."""
    session = (yield FtpRequest(CREATE, path.encode())).session
    yield from _closing(session, _write(session, content, progress))


def _read(session: int, most: int) -> FtpSteps[bytes]:
    content = b""
    try:
        while len(content) < most:
            answer = yield FtpRequest(READ, b"", len(content), session, wanted=DATA_BYTES)
            if not answer.data:
                break
            content += answer.data
    except FtpRefusedError as refusal:
        if refusal.code != END_OF_FILE:
            raise
    return content[:most]


def _write(session: int, content: bytes, progress: Callable[[float], object]) -> FtpSteps[None]:
    for offset in range(0, len(content), DATA_BYTES):
        chunk = content[offset : offset + DATA_BYTES]
        yield FtpRequest(WRITE, chunk, offset, session)
        progress((offset + len(chunk)) / len(content))


def _closing(session: int, steps: FtpSteps[Result]) -> FtpSteps[Result]:
    """Run the steps and then close the session, even after an error."""
    try:
        result = yield from steps
    except (FtpRefusedError, FtpSilentError):
        yield FtpRequest(TERMINATE, b"", 0, session)
        raise
    yield FtpRequest(TERMINATE, b"", 0, session)
    return result


def checksum(content: bytes, before: int = 0) -> int:
    """CRC-32 of MAVLink FTP: CRC-32 of zlib without its inversions. before: checksum of the preceding content."""
    return ~zlib.crc32(content, ~before & 0xFFFFFFFF) & 0xFFFFFFFF
