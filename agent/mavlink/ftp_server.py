"""MAVLink FTP (mavlink.io/en/services/ftp.html), server on the vehicle: lists, checksums and reads. It never writes.

If the standard is ambiguous, it answers as ArduPilot does. The client chooses its session number, and a burst ends with
the refusal END_OF_FILE. A repeated request is answered again but not executed again.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Generator, Sequence
from typing import Any, Callable, NamedTuple, Optional, Protocol

from agent.mavlink import ftp
from agent.mavlink.exchange import Messages, Target
from agent.mavlink.ftp import DATA_BYTES, FtpPacket, checksum
from agent.wire import dialect as mav

PER_POLL = 20
MOST_SESSIONS = 8
MOST_WAITING = 16  # requests that wait for the disk
MOST_CLIENTS = 8
IDLE_NS = 3_000_000_000  # a session that has been silent for this time can be replaced
BURST_PACKETS = 500
CHECKSUM_BYTES = 1 << 16  # per poll

_CHANGES = frozenset((
    ftp.CREATE, ftp.WRITE, ftp.OPEN_TO_WRITE, ftp.TRUNCATE, ftp.RENAME,
    ftp.MAKE_DIRECTORY, ftp.REMOVE_DIRECTORY, ftp.REMOVE_FILE,
))  # fmt: skip
_ANSWERS = (ftp.ACK, ftp.NAK)


class ServedFile(Protocol):
    """A file as it was when it was opened."""

    @property
    def size(self) -> int:
        """Size in bytes."""

    def read(self, offset: int, count: int) -> bytes | None:
        """Return `count` bytes, fewer at the end, none after it. None while waiting for the disk. Raises OSError."""


class Files(Protocol):
    """Served files. No method blocks: None means that the disk has not answered yet."""

    def entries(self, path: str) -> Sequence[str] | None:
        """Return `Fname<TAB>size` of each file of a folder and `Dname` of each folder. Raises OSError."""

    def open(self, path: str) -> ServedFile | None:
        """Open a file by its path. Raises OSError."""


def _error_data(error: OSError) -> bytes:
    """Return the data of a refusal for a disk error."""
    if isinstance(error, (FileNotFoundError, NotADirectoryError, IsADirectoryError)):
        return bytes((ftp.FILE_NOT_FOUND,))
    return bytes((ftp.FAIL_ERRNO, (error.errno or errno.EIO) & 0xFF))


class _RefusedError(Exception):
    def __init__(self, *data: int) -> None:
        super().__init__(data)
        self.data = bytes(data)


class _Burst(NamedTuple):
    sequence: int
    offset: int
    chunk: int
    left: int


class _Session:
    """An open file of a client. burst: the remaining packets of a burst."""

    def __init__(self, client: Target, number: int, file: ServedFile, now_ns: int) -> None:
        self.client = client
        self.number = number
        self.file = file
        self.used_ns = now_ns
        self.burst: _Burst | None = None


_Steps = Generator[None, None, FtpPacket]
"""An answer in progress, one step per poll."""
_Attempt = Callable[[], Optional[FtpPacket]]
"""Return the answer, None if it is not ready."""


class FtpServer:
    """Serves `files` to the clients of one link. At most MOST_SESSIONS files are open.

    `poll` continues bursts, at most PER_POLL messages each time, and answers requests that waited for the disk.
    dropped: requests that arrived while MOST_WAITING others waited for the disk.
    """

    def __init__(self, files: Files) -> None:
        self.dropped = 0
        self._files = files
        self._sessions: list[_Session] = []
        self._waiting: deque[tuple[Target, bytes, _Attempt]] = deque()
        self._answered: dict[Target, tuple[bytes, FtpPacket]] = {}
        self.handlers: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: self._on_request,
        }
        self._at_once: dict[int, Callable[[Target, FtpPacket, int], FtpPacket]] = {
            ftp.NONE: lambda client, packet, now_ns: _reply(packet),
            ftp.TERMINATE: self._terminate,
            ftp.RESET: self._reset,
            ftp.BURST: self._begin_burst,
        }
        self._in_steps: dict[int, Callable[[Target, FtpPacket, int], _Steps]] = {
            ftp.LIST: self._list,
            ftp.OPEN: self._open,
            ftp.READ: self._read,
            ftp.CHECKSUM: self._checksum,
        }

    def poll(self, now_ns: int, most: int = PER_POLL) -> Messages:
        """Return the messages that are due, at most `most`."""
        messages: Messages = []
        for _ in range(min(len(self._waiting), most)):
            messages += self._try(*self._waiting.popleft())
        for session in self._sessions:
            while session.burst is not None and len(messages) < most:
                packet = self._next_of_burst(session, session.burst, now_ns)
                if packet is None:
                    break
                messages.append(_message(session.client, packet))
        return messages

    # -- requests

    def _on_request(self, message: Any, now_ns: int) -> Messages:
        client = (message.get_srcSystem(), message.get_srcComponent())
        request = bytes(message.payload)
        packet = FtpPacket.from_payload(request)
        known, answer = self._answered.get(client, (b"", None))
        if answer is not None and known == request:
            return [_message(client, answer)]
        if packet.operation in _ANSWERS or any(entry[:2] == (client, request) for entry in self._waiting):
            return []
        if len(self._waiting) >= MOST_WAITING:
            self.dropped += 1
            return []
        in_steps = self._in_steps.get(packet.operation)
        if in_steps is not None:
            return self._try(client, request, _stepping(in_steps(client, packet, now_ns)))
        at_once = self._at_once.get(packet.operation, self._refuse)
        return self._try(client, request, lambda: at_once(client, packet, now_ns))

    def _try(self, client: Target, request: bytes, attempt: _Attempt) -> Messages:
        """Attempt to answer. An unfinished request waits for the next poll."""
        packet = FtpPacket.from_payload(request)
        try:
            answer = attempt()
        except _RefusedError as refusal:
            answer = _reply(packet, refusal.data, operation=ftp.NAK, offset=packet.offset)
        except OSError as error:
            answer = _reply(packet, _error_data(error), operation=ftp.NAK, offset=packet.offset)
        if answer is None:
            self._waiting.append((client, request, attempt))
            return []
        if packet.operation == ftp.BURST and answer.operation == ftp.ACK:  # begun; a repeated request restarts it
            return []
        self._answered.pop(client, None)
        if len(self._answered) >= MOST_CLIENTS:
            del self._answered[next(iter(self._answered))]
        self._answered[client] = (request, answer)
        return [_message(client, answer)]

    def _refuse(self, client: Target, packet: FtpPacket, now_ns: int) -> FtpPacket:
        raise _RefusedError(ftp.FILE_PROTECTED if packet.operation in _CHANGES else ftp.UNKNOWN_COMMAND)

    def _terminate(self, client: Target, packet: FtpPacket, now_ns: int) -> FtpPacket:
        """End a session. An ended session is also acknowledged."""
        self._sessions = [other for other in self._sessions if (other.client, other.number) != (client, packet.session)]
        return _reply(packet)

    def _reset(self, client: Target, packet: FtpPacket, now_ns: int) -> FtpPacket:
        """End the client's sessions, and those that a waiting request would open."""
        self._waiting = deque(entry for entry in self._waiting if entry[0] != client)
        self._sessions = [other for other in self._sessions if other.client != client]
        return _reply(packet)

    def _list(self, client: Target, packet: FtpPacket, now_ns: int) -> _Steps:
        path = _path(packet)
        while (entries := self._files.entries(path)) is None:
            yield
        data = b""
        for entry in entries[packet.offset :]:
            line = entry.encode("utf-8", "replace") + b"\0"
            if len(data) + len(line) > DATA_BYTES:
                break
            data += line
        if not data:
            raise _RefusedError(ftp.END_OF_FILE)
        return _reply(packet, data, offset=packet.offset)

    def _open(self, client: Target, packet: FtpPacket, now_ns: int) -> _Steps:
        path = _path(packet)
        while (file := self._files.open(path)) is None:
            yield
        number = packet.session
        self._drop_idle(client, number, now_ns)
        taken = {session.number for session in self._sessions if session.client == client}
        if number in taken:
            number = next(free for free in range(256) if free not in taken)
        self._sessions.append(_Session(client, number, file, now_ns))
        size = min(file.size, 0xFFFFFFFF).to_bytes(4, "little")
        return _reply(packet, size)._replace(session=number)

    def _drop_idle(self, client: Target, number: int, now_ns: int) -> None:
        """Make room for a session with this number, by ending silent ones."""
        idle = [session for session in self._sessions if not 0 <= now_ns - session.used_ns < IDLE_NS]
        ended = [session for session in idle if (session.client, session.number) == (client, number)]
        if not ended and len(self._sessions) >= MOST_SESSIONS:
            if not idle:
                raise _RefusedError(ftp.NO_SESSION)
            ended = [min(idle, key=lambda session: session.used_ns)]
        self._sessions = [session for session in self._sessions if session not in ended]

    def _session(self, client: Target, packet: FtpPacket, now_ns: int) -> _Session:
        for session in self._sessions:
            if (session.client, session.number) == (client, packet.session):
                session.used_ns = now_ns
                return session
        raise _RefusedError(ftp.INVALID_SESSION)

    def _read(self, client: Target, packet: FtpPacket, now_ns: int) -> _Steps:
        session = self._session(client, packet, now_ns)
        if packet.size > DATA_BYTES:
            raise _RefusedError(ftp.INVALID_SIZE)
        while (data := session.file.read(packet.offset, packet.size)) is None:
            yield
        if not data:
            raise _RefusedError(ftp.END_OF_FILE)
        return _reply(packet, data, offset=packet.offset)

    def _checksum(self, client: Target, packet: FtpPacket, now_ns: int) -> _Steps:
        path = _path(packet)
        while (file := self._files.open(path)) is None:
            yield
        value = offset = 0
        while offset < file.size:
            chunk = file.read(offset, min(CHECKSUM_BYTES, file.size - offset))
            if chunk == b"":  # the file became shorter
                break
            if chunk:
                value = checksum(chunk, value)
                offset += len(chunk)
            if offset < file.size:
                yield
        return _reply(packet, value.to_bytes(4, "little"))

    # -- bursts

    def _begin_burst(self, client: Target, packet: FtpPacket, now_ns: int) -> FtpPacket:
        session = self._session(client, packet, now_ns)
        if packet.size > DATA_BYTES:
            raise _RefusedError(ftp.INVALID_SIZE)
        sequence = (packet.sequence + 1) & 0xFFFF
        session.burst = _Burst(sequence, packet.offset, packet.size or DATA_BYTES, BURST_PACKETS)
        return _reply(packet)

    def _next_of_burst(self, session: _Session, burst: _Burst, now_ns: int) -> FtpPacket | None:
        """Return the next packet, None while waiting for the disk."""
        sequence, offset, chunk, left = burst
        try:
            data = session.file.read(offset, chunk)
        except OSError as error:
            session.burst = None
            refusal = _error_data(error)
            return FtpPacket(sequence, session.number, ftp.NAK, len(refusal), ftp.BURST, offset, refusal)
        if data is None:
            return None
        session.used_ns = now_ns
        if not data:
            session.burst = None
            return FtpPacket(sequence, session.number, ftp.NAK, 1, ftp.BURST, offset, bytes((ftp.END_OF_FILE,)))
        end = offset + len(data)
        session.burst = _Burst((sequence + 1) & 0xFFFF, end, chunk, left - 1) if left > 1 else None
        ends = left == 1 or len(data) < chunk
        return FtpPacket(sequence, session.number, ftp.ACK, len(data), ftp.BURST, offset, data, ends)


def _stepping(steps: _Steps) -> _Attempt:
    def step() -> FtpPacket | None:
        try:
            next(steps)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
        return None

    return step


def _path(packet: FtpPacket) -> str:
    """Return the path of a request. Raises _RefusedError for an invalid size."""
    if not 0 < packet.size <= DATA_BYTES or packet.data[:1] == b"\0":
        raise _RefusedError(ftp.INVALID_SIZE)
    return packet.data.partition(b"\0")[0].decode("utf-8", "replace")


def _reply(packet: FtpPacket, data: bytes = b"", operation: int = ftp.ACK, offset: int = 0) -> FtpPacket:
    sequence = (packet.sequence + 1) & 0xFFFF
    return FtpPacket(sequence, packet.session, operation, len(data), packet.operation, offset, data)


def _message(client: Target, packet: FtpPacket) -> Any:
    return mav.MAVLink_file_transfer_protocol_message(0, *client, packet.pack())
