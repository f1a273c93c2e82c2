"""The FTP server: by our own client, by packets as the standard has them, and on a line that loses."""

from __future__ import annotations

import errno
import random
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.mavlink import ftp
from agent.mavlink.ftp import FtpClient, FtpPacket, FtpRefusedError, checksum, read_checksum, read_file
from agent.mavlink.ftp_server import IDLE_NS, MOST_SESSIONS, PER_POLL, FtpServer
from agent.wire import dialect as mav
from agent.wire.codec import Packer, decode

CONTENT = random.Random(1).randbytes(5000)
CLIENT, OTHER = (255, 190), (254, 190)
CYCLE_NS = 20_000_000


class File:
    """Late answers so many reads with None before it reads."""

    def __init__(self, content: bytes, late: int) -> None:
        self._content = content
        self._late = self._left = late

    @property
    def size(self) -> int:
        return len(self._content)

    def read(self, offset: int, count: int) -> bytes | None:
        if self._left:
            self._left -= 1
            return None
        self._left = self._late
        return self._content[offset : offset + count]


class Folder:
    def __init__(self, late: int = 0) -> None:
        self._late = late
        self.opened = 0

    def entries(self, path: str) -> Sequence[str] | None:
        if path.strip("/") != "logs":
            raise FileNotFoundError(errno.ENOENT, "none")
        return [f"F{number:08d}.BIN\t{number}" for number in range(40)]

    def open(self, path: str) -> File | None:
        if path == "/broken":
            raise OSError(errno.EIO, "broken")
        if path != "/a":
            raise FileNotFoundError(errno.ENOENT, "none")
        self.opened += 1
        return File(CONTENT, self._late)


def sent(packet: FtpPacket, sender: tuple[int, int] = CLIENT) -> Any:
    return decode(Packer(*sender).pack(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, packet.pack())))


def answers(messages: list[Any]) -> list[FtpPacket]:
    return [FtpPacket.from_payload(bytes(message.payload)) for message in messages]


class Asking:
    """One request after the other, as a client sends them; `ask` polls until there is an answer."""

    def __init__(self, folder: Folder | None = None) -> None:
        self.server = FtpServer(folder or Folder())
        self.now_ns = 0
        self._sequence = 10

    def request(self, operation: int, data: bytes = b"", **fields: int) -> FtpPacket:
        self._sequence += 2
        size = fields.pop("size", len(data))
        return FtpPacket(self._sequence, fields.get("session", 0), operation, size, 0, fields.get("offset", 0), data)

    def ask(self, operation: int, data: bytes = b"", sender: tuple[int, int] = CLIENT, **fields: int) -> FtpPacket:
        packet = self.request(operation, data, **fields)
        (handler,) = self.server.handlers.values()
        found = answers(handler(sent(packet, sender), self.now_ns))
        while not found:
            self.now_ns += CYCLE_NS
            found = answers(self.server.poll(self.now_ns))
        (answer,) = found
        assert (answer.sequence, answer.requested) == (packet.sequence + 1, operation)
        return answer


def refusal(answer: FtpPacket) -> int:
    assert answer.operation == ftp.NAK
    return answer.data[0]


def carried_out(steps: Any, lose: float = 0.0, late: int = 0, seed: int = 0) -> Any:
    """By our own client."""
    server, source, now_ns = FtpServer(Folder(late)), random.Random(seed), 0
    (handler,) = server.handlers.values()
    operation = FtpClient((1, 1)).start(steps)
    while not operation.done:
        now_ns += CYCLE_NS
        replies = server.poll(now_ns)
        for request in operation.poll(now_ns):
            if source.random() >= lose:
                replies += handler(decode(Packer(255, 190).pack(request)), now_ns)
        for reply in replies:
            if source.random() >= lose:
                operation.handle(decode(Packer(1, 1).pack(reply)), now_ns)
        assert now_ns < 300e9
    return operation.result


@pytest.mark.parametrize("late", [0, 3])
@pytest.mark.parametrize("lose", [0.0, 0.2])
def test_our_client_reads_a_file_whole(lose: float, late: int) -> None:
    assert carried_out(read_file("/a", 1 << 20), lose, late) == CONTENT
    assert carried_out(read_checksum("/a"), lose, late) == checksum(CONTENT)


def test_what_is_not_there_is_refused_at_once() -> None:
    asking = Asking()
    assert refusal(asking.ask(ftp.OPEN, b"/b")) == ftp.FILE_NOT_FOUND
    assert refusal(asking.ask(ftp.LIST, b"@ROMFS")) == ftp.FILE_NOT_FOUND
    assert refusal(asking.ask(ftp.CHECKSUM, b"/b")) == ftp.FILE_NOT_FOUND
    assert refusal(asking.ask(ftp.READ, session=3, size=100)) == ftp.INVALID_SESSION
    assert refusal(asking.ask(ftp.BURST, session=3, size=100)) == ftp.INVALID_SESSION
    assert refusal(asking.ask(ftp.OPEN, b"")) == ftp.INVALID_SIZE
    assert refusal(asking.ask(ftp.OPEN, b"/a", size=250)) == ftp.INVALID_SIZE
    assert refusal(asking.ask(77)) == ftp.UNKNOWN_COMMAND
    broken = asking.ask(ftp.OPEN, b"/broken")
    assert (broken.operation, broken.data) == (ftp.NAK, bytes((ftp.FAIL_ERRNO, errno.EIO)))
    assert asking.now_ns == 0
    with pytest.raises(FtpRefusedError, match="no such file"):
        carried_out(read_file("/b", 10))


@pytest.mark.parametrize(
    "operation",
    [ftp.CREATE, ftp.WRITE, ftp.REMOVE_FILE, ftp.MAKE_DIRECTORY, ftp.REMOVE_DIRECTORY, 11, 12, 13],
)
def test_nothing_is_written(operation: int) -> None:
    assert refusal(Asking().ask(operation, b"/a")) == ftp.FILE_PROTECTED


def test_a_folder_is_listed_in_parts() -> None:
    asking, names = Asking(), []
    while (answer := asking.ask(ftp.LIST, b"/logs", offset=len(names))).operation == ftp.ACK:
        assert answer.size == len(answer.data) <= ftp.DATA_BYTES
        names += answer.data.split(b"\0")[:-1]
    assert refusal(answer) == ftp.END_OF_FILE
    assert names == [f"F{number:08d}.BIN\t{number}".encode() for number in range(40)]


def test_a_session_has_the_number_that_the_client_gives_it() -> None:
    asking = Asking()
    opened = asking.ask(ftp.OPEN, b"/a", session=7)
    assert (opened.session, int.from_bytes(opened.data, "little")) == (7, len(CONTENT))
    piece = asking.ask(ftp.READ, session=7, offset=4900, size=200)
    assert (piece.data, piece.offset, piece.size) == (CONTENT[4900:], 4900, 100)
    assert refusal(asking.ask(ftp.READ, session=7, offset=5000, size=200)) == ftp.END_OF_FILE
    assert refusal(asking.ask(ftp.READ, sender=OTHER, session=7, size=9)) == ftp.INVALID_SESSION
    assert asking.ask(ftp.TERMINATE, session=7).operation == ftp.ACK
    assert asking.ask(ftp.TERMINATE, session=7).operation == ftp.ACK
    assert refusal(asking.ask(ftp.READ, session=7, size=9)) == ftp.INVALID_SESSION


def test_sessions_are_bounded_and_the_idle_ones_give_way() -> None:
    asking = Asking()
    numbers = [asking.ask(ftp.OPEN, b"/a").session for _ in range(MOST_SESSIONS)]
    assert sorted(numbers) == list(range(MOST_SESSIONS))  # a client that leaves the number to us
    assert refusal(asking.ask(ftp.OPEN, b"/a")) == ftp.NO_SESSION
    asking.now_ns += IDLE_NS
    assert asking.ask(ftp.OPEN, b"/a", sender=OTHER).operation == ftp.ACK
    assert asking.ask(ftp.RESET).operation == ftp.ACK
    assert [asking.ask(ftp.OPEN, b"/a").operation for _ in range(MOST_SESSIONS - 1)] == [ftp.ACK] * (MOST_SESSIONS - 1)


def test_a_repeated_request_is_answered_again_and_not_carried_out_again() -> None:
    folder = Folder()
    asking = Asking(folder)
    (handler,) = asking.server.handlers.values()
    request = sent(asking.request(ftp.OPEN, b"/a", session=1))
    first, again = answers(handler(request, 0)), answers(handler(request, 0))
    assert first == again
    assert folder.opened == 1


def test_a_reset_also_ends_what_waits_for_the_disk() -> None:
    class Disk(Folder):
        ready = False

        def open(self, path: str) -> File | None:
            return super().open(path) if self.ready else None

    disk = Disk()
    asking = Asking(disk)
    (handler,) = asking.server.handlers.values()
    assert handler(sent(asking.request(ftp.OPEN, b"/a", session=3)), 0) == []
    assert handler(sent(asking.request(ftp.OPEN, b"/a", session=3), OTHER), 0) == []
    assert asking.ask(ftp.RESET).operation == ftp.ACK
    disk.ready = True
    (opened,) = asking.server.poll(0)
    assert (opened.target_system, opened.target_component) == OTHER
    assert refusal(asking.ask(ftp.READ, session=3, size=100)) == ftp.INVALID_SESSION


@pytest.mark.parametrize("chunk", [80, 239, 0])
def test_a_burst_brings_the_file_and_ends_as_ardupilots_does(chunk: int) -> None:
    asking = Asking()
    asking.ask(ftp.OPEN, b"/a", session=1)
    (handler,) = asking.server.handlers.values()
    burst = asking.request(ftp.BURST, session=1, size=chunk)
    assert handler(sent(burst), 0) == []
    found: list[FtpPacket] = []
    for _ in range(100):
        some = answers(asking.server.poll(0))
        assert len(some) <= PER_POLL
        found += some
    *pieces, end = found
    assert [piece.sequence for piece in found] == [burst.sequence + 1 + n for n in range(len(found))]
    assert b"".join(piece.data for piece in pieces) == CONTENT
    assert [piece.ends_burst for piece in pieces] == [False] * (len(pieces) - 1) + [True]
    assert (refusal(end), end.offset, end.requested) == (ftp.END_OF_FILE, len(CONTENT), ftp.BURST)


def test_a_burst_that_is_asked_for_again_begins_again() -> None:
    asking = Asking()
    asking.ask(ftp.OPEN, b"/a", session=1)
    (handler,) = asking.server.handlers.values()
    request = sent(asking.request(ftp.BURST, session=1, size=239))
    handler(request, 0)
    first = answers(asking.server.poll(0, 3))
    assert handler(request, 0) == []
    assert answers(asking.server.poll(0, 3)) == first
    asking.ask(ftp.TERMINATE, session=1)
    assert asking.server.poll(0) == []


@settings(max_examples=15)
@given(st.lists(st.tuples(st.binary(max_size=251), st.integers(0, 3)), max_size=30))
def test_no_payload_raises_and_work_is_bounded(payloads: list[tuple[bytes, int]]) -> None:
    server = FtpServer(Folder(1))
    (handler,) = server.handlers.values()
    for payload, client in payloads:
        raw = bytearray(payload.ljust(251, b"\0"))
        raw[3] %= 17  # an operation that there is
        message = mav.MAVLink_file_transfer_protocol_message(0, 1, 1, bytes(raw))
        assert len(handler(decode(Packer(client + 1, 1).pack(message)), 0)) <= 1
        assert len(server.poll(0)) <= PER_POLL
