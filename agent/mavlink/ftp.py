"""MAVLink FTP (mavlink.io/en/services/ftp.html), the client's side: checksum, folder, read, write, one at a time.

A repeated request keeps its sequence number, by which the vehicle knows it again and only repeats its answer; so
nothing is done twice. The answer is an FtpPacket too: ACK or NAK, sequence one higher, `requested` the operation.
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
BUSY_S = 4.0  # ArduPilot gives up the session of a client that has been silent for 3 s
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
    FAIL: "it fails there",
    FAIL_ERRNO: "its file system fails",
    INVALID_SIZE: "the request has a wrong size",
    INVALID_SESSION: "another client is busy with its files",
    NO_SESSION: "other clients are busy with its files",
    END_OF_FILE: "the file has ended",
    UNKNOWN_COMMAND: "it does not know this operation",
    FILE_EXISTS: "it exists",
    FILE_PROTECTED: "it is protected",
    FILE_NOT_FOUND: "there is no such file or folder",
}

Result = TypeVar("Result")


class FtpRefusedError(Exception):
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


class FtpSilentError(Exception):
    """The vehicle did not answer TRIES times."""

    def __init__(self) -> None:
        super().__init__(
            "the vehicle does not answer to MAVLink FTP; use its USB or network link, and firmware that has it"
        )


class FtpPacket(NamedTuple):
    """The payload of FILE_TRANSFER_PROTOCOL.

    size: of `data`, or how much is asked for; requested: the operation that is answered; ends_burst: no more comes of
    the burst that was asked for.
    """

    sequence: int
    session: int
    operation: int
    size: int
    requested: int = 0
    offset: int = 0
    data: bytes = b""
    ends_burst: bool = False

    def pack(self) -> bytes:
        """The bytes of the payload."""
        sequence, session, operation, size, requested, offset, _, ends_burst = self
        head = _HEADER.pack(sequence, session, operation, size, requested, ends_burst, offset)
        return (head + self.data).ljust(PAYLOAD_BYTES, b"\0")

    @classmethod
    def from_payload(cls, payload: bytes) -> FtpPacket:
        """Read a payload of PAYLOAD_BYTES."""
        sequence, session, operation, size, requested, ends_burst, offset = _HEADER.unpack_from(payload)
        data = payload[_HEADER.size : _HEADER.size + size]
        return cls(sequence, session, operation, size, requested, offset, data, bool(ends_burst))


class FtpRequest(NamedTuple):
    """What an operation asks. session: None for the client's own; wanted: bytes to read, where that is asked for."""

    operation: int
    data: bytes = b""
    offset: int = 0
    session: int | None = None
    wanted: int | None = None


FtpSteps = Generator[FtpRequest, FtpPacket, Result]
"""An operation on files: yields its requests, gets their answers, returns its result. FtpClient carries it out."""


class FtpClient:
    """The file service of `target`, for one operation at a time."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._sequence = random.randrange(1 << 16)  # a vehicle could take a known one for a repetition
        self._session = random.randrange(1, 256)

    def start(self, steps: FtpSteps[Result]) -> FtpOperation[Result]:
        """An exchange that carries an operation out."""
        return FtpOperation(self, steps)

    def packet(self, request: FtpRequest) -> FtpPacket:
        """A request with a sequence number of its own."""
        sequence = self._sequence
        self._sequence = (sequence + 2) & 0xFFFF
        session = self._session if request.session is None else request.session
        size = len(request.data) if request.wanted is None else request.wanted
        return FtpPacket(sequence, session, request.operation, size, 0, request.offset, request.data)

    def message(self, packet: FtpPacket) -> Any:
        """FILE_TRANSFER_PROTOCOL with that payload."""
        return mav.MAVLink_file_transfer_protocol_message(0, *self._target, packet.pack())


class FtpOperation(Generic[Result]):
    """An exchange of the requests of an operation, each repeated until it is answered."""

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
        """What came of it, once `done`. Raises FtpRefusedError or FtpSilentError where it failed."""
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
        """To the next request, or to the end."""
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
    """Of a file there, as `checksum` of its content; None when there is none."""
    try:
        answer = yield FtpRequest(CHECKSUM, path.encode())
    except FtpRefusedError as refusal:
        if refusal.nothing_there or refusal.code == FAIL_ERRNO:
            return None
        raise
    return int.from_bytes(answer.data[:4], "little")


def has_folder(path: str) -> FtpSteps[bool]:
    """Whether there is such a folder, an empty one too."""
    try:
        yield FtpRequest(LIST, path.encode())
    except FtpRefusedError as refusal:
        if refusal.code == END_OF_FILE:  # how a folder's list ends, that of an empty one at once
            return True
        if refusal.nothing_there or refusal.code == FAIL_ERRNO:
            return False
        raise
    return True


def make_folder(path: str) -> FtpSteps[None]:
    """Make a folder; one that is there is fine."""
    try:
        yield FtpRequest(MAKE_DIRECTORY, path.encode())
    except FtpRefusedError:
        if not (yield from has_folder(path)):
            raise


def read_file(path: str, most: int) -> FtpSteps[bytes]:
    """What is in a file, `most` bytes at most: the size that a made-up file (@SYS/…) tells is not its own."""
    session = (yield FtpRequest(OPEN, path.encode())).session
    return (yield from _closing(session, _read(session, most)))


def write_file(path: str, content: bytes, progress: Callable[[float], object] = lambda part: None) -> FtpSteps[None]:
    """Write a file anew; `progress` hears what part is done."""
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
    """The steps, and the end of the session behind them, however they end."""
    try:
        result = yield from steps
    except (FtpRefusedError, FtpSilentError):
        yield FtpRequest(TERMINATE, b"", 0, session)
        raise
    yield FtpRequest(TERMINATE, b"", 0, session)
    return result


def checksum(content: bytes, before: int = 0) -> int:
    """CRC-32 as MAVLink FTP has it, that of zlib without its inversions; `before` is that of what comes before."""
    return ~zlib.crc32(content, ~before & 0xFFFFFFFF) & 0xFFFFFFFF
