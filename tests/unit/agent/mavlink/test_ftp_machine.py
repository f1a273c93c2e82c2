"""State machine of MAVLink FTP: two stations read files over an unreliable line, and a slow disk changes them."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any, NamedTuple

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import precondition, rule

from agent.mavlink import ftp
from agent.mavlink.ftp import DATA_BYTES, FtpPacket
from agent.mavlink.ftp_server import IDLE_NS
from agent.wire import dialect as mav
from tests.doubles.ftp_vehicle import crc32
from tests.doubles.unreliable_line import VEHICLE, Address, ProtocolMachine, StationRequest

FOLDER = "/APM/LOGS"
SIZES = (0, 1, DATA_BYTES, 3 * DATA_BYTES, 1000, 4000)
MOST_FILES = 30
BUSY = (ftp.INVALID_SESSION, ftp.NO_SESSION)


class DiskLog(NamedTuple):
    name: str
    size: int
    modified_s: int = 0


class OpenLog:
    """Its content is that of the moment of opening. The disk answers each `late` + 1-th question."""

    def __init__(self, disk: SlowDisk, content: bytes) -> None:
        self._disk, self._content = disk, content

    @property
    def size(self) -> int:
        return len(self._content)

    def read(self, offset: int, count: int) -> bytes | None:
        return self._content[offset : offset + count] if self._disk.is_ready() else None


class SlowDisk:
    """Takes the place of the stored logs."""

    def __init__(self) -> None:
        self.late = 0
        self.contents: dict[str, bytes] = {}
        self._asked = 0

    def is_ready(self) -> bool:
        self._asked += 1
        return self._asked % (self.late + 1) == 0

    def logs(self) -> Sequence[DiskLog] | None:
        return [DiskLog(name, len(content)) for name, content in self.contents.items()] if self.is_ready() else None

    def open_log(self, index: int) -> OpenLog:
        return OpenLog(self, list(self.contents.values())[index])


class FileTask(StationRequest):
    """One request after the other, each with a new number. A repeated request keeps its number.

    After a refusal for want of a session the station begins again.
    """

    def __init__(self, path: str, session: int, sequence: int) -> None:
        super().__init__()
        self.path, self.session, self.sequence = path, session, sequence
        self.refusal: int | None = None
        self.result: Any = None
        self.contents: set[Any] = set()  # what the task may find
        self.packet = FtpPacket(0, 0, 0, 0)
        self.begin()

    def begin(self) -> None:
        raise NotImplementedError

    def ask_for(self, operation: int, data: bytes = b"", size: int | None = None, offset: int = 0) -> None:
        self.sequence = (self.sequence + 1) & 0xFFFF
        count = len(data) if size is None else size
        self.packet = FtpPacket(self.sequence, self.session, operation, count, 0, offset, data)
        self.ask(mav.MAVLink_file_transfer_protocol_message(0, *VEHICLE, self.packet.pack()))

    def is_answer(self, message: Any) -> bool:
        if message.get_msgId() != mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL:
            return False
        answer = FtpPacket.from_payload(bytes(message.payload))
        ahead = (answer.sequence - self.packet.sequence) & 0xFFFF
        in_burst = self.packet.operation == ftp.BURST and 1 <= ahead <= 1000
        return answer.requested == self.packet.operation and (ahead == 1 or in_burst)

    def answered(self, message: Any, now_ns: int) -> None:
        answer = FtpPacket.from_payload(bytes(message.payload))
        if (answer.sequence - self.sequence) & 0xFFFF < 0x8000:  # a burst has taken further numbers
            self.sequence = answer.sequence
        if answer.operation == ftp.ACK:
            self.accept(answer)
        elif answer.data[0] in BUSY:
            self.begin()
        elif answer.data[0] == ftp.END_OF_FILE:
            self.end_of_file(answer)
        else:
            self.refusal, self.done = answer.data[0], True

    def accept(self, answer: FtpPacket) -> None:
        raise NotImplementedError

    def end_of_file(self, answer: FtpPacket) -> None:
        raise NotImplementedError


class ReadFile(FileTask):
    """Opens, reads, closes. `burst`: asks for the first missing byte until the file is whole."""

    def __init__(self, path: str, session: int, sequence: int, burst: bool, chunk: int) -> None:
        self.burst, self.chunk = burst, chunk
        super().__init__(path, session, sequence)

    def begin(self) -> None:
        self.pieces: dict[int, bytes] = {}
        self.size: int | None = None
        self.ask_for(ftp.OPEN, self.path.encode())

    def accept(self, answer: FtpPacket) -> None:
        if answer.requested == ftp.TERMINATE:
            self.result, self.done = b"".join(self.pieces[offset] for offset in sorted(self.pieces)), True
            return
        if answer.requested == ftp.OPEN:
            self.session, self.size = answer.session, int.from_bytes(answer.data, "little")
        else:
            assert answer.session == self.session
            assert 0 < len(answer.data) <= self.chunk
            self.pieces[answer.offset] = answer.data
            if self.burst and not answer.ends_burst and self.missing() < self.size:
                return
        self.next_request()

    def missing(self) -> int:
        offset = 0
        while offset in self.pieces:
            offset += len(self.pieces[offset])
        return offset

    def next_request(self) -> None:
        missing = self.missing()
        if missing >= self.size:
            self.ask_for(ftp.TERMINATE)
        else:
            self.ask_for(ftp.BURST if self.burst else ftp.READ, size=self.chunk, offset=missing)

    def end_of_file(self, answer: FtpPacket) -> None:
        assert self.burst
        assert answer.offset == self.size
        self.next_request()

    def attempt(self) -> Any:
        """A burst that broke off continues at the first missing byte."""
        if self.packet.operation == ftp.BURST and self.attempts > 1 and self.missing() != self.packet.offset:
            self.next_request()
            self.attempts = 1
        return self.request


class ListFolder(FileTask):
    def begin(self) -> None:
        self.names: list[bytes] = []
        self.ask_for(ftp.LIST, self.path.encode())

    def accept(self, answer: FtpPacket) -> None:
        assert answer.data.endswith(b"\0")
        assert answer.offset == len(self.names)
        self.names += answer.data.split(b"\0")[:-1]
        self.ask_for(ftp.LIST, self.path.encode(), offset=len(self.names))

    def end_of_file(self, answer: FtpPacket) -> None:
        self.result, self.done = tuple(name.decode() for name in self.names), True


class AskOnce(FileTask):
    """CHECKSUM of a file, a reset of all sessions, or a change, which the vehicle refuses."""

    def __init__(self, path: str, session: int, sequence: int, operation: int) -> None:
        self.operation = operation
        super().__init__(path, session, sequence)

    def begin(self) -> None:
        self.ask_for(self.operation, self.path.encode() if self.operation != ftp.RESET else b"")

    def accept(self, answer: FtpPacket) -> None:
        self.result, self.done = bytes(answer.data), True


class FtpMachine(ProtocolMachine):
    """The model is the bytes of each file. A file that is read is as it was when it was opened."""

    def __init__(self) -> None:
        super().__init__()
        self.disk = SlowDisk()
        self.channel.hub.logs = self.disk
        self.random = random.Random(3)
        for number in range(MOST_FILES):
            self.disk.contents[f"{number + 1:08d}.BIN"] = self.random.randbytes(SIZES[number % len(SIZES)])
        self.opened: dict[tuple[Address, int], int] = {}  # time of the last request of each session
        self.waiting: dict[tuple[Address, int], bytes] = {}  # requests without an answer, by the number of the answer
        self.latest_answer: dict[Address, tuple[bytes, bytes]] = {}
        self.sequence = 0

    def listing(self) -> tuple[str, ...]:
        return tuple(f"F{name}\t{len(content)}" for name, content in self.disk.contents.items())

    # -- the disk

    @rule(late=st.integers(0, 3))
    def the_disk_is_busy(self, late: int) -> None:
        self.disk.late = late

    @rule(number=st.integers(1, len(SIZES)), size=st.sampled_from(SIZES))
    def a_file_changes(self, number: int, size: int) -> None:
        self.disk.contents[f"{number:08d}.BIN"] = self.random.randbytes(size)
        for task in self.tasks.values():
            self._note(task)

    def _note(self, task: FileTask) -> None:
        if isinstance(task, ListFolder):
            task.contents.add(self.listing())
        else:
            task.contents.add(self.disk.contents.get(task.path.rpartition("/")[2]))

    # -- tasks

    @precondition(ProtocolMachine.free)
    @rule(
        number=st.integers(0, 1),
        file=st.integers(1, len(SIZES) + 1).map(lambda number: number if number <= len(SIZES) else MOST_FILES + 1),
        session=st.integers(0, 2),
        sequence=st.sampled_from([0, 64030]),
        burst=st.booleans(),
        chunk=st.sampled_from([80, DATA_BYTES]),
    )
    def read(self, number: int, file: int, session: int, sequence: int, burst: bool, chunk: int) -> None:
        self._start(number, ReadFile(f"{FOLDER}/{file:08d}.BIN", session, self._fresh(sequence), burst, chunk))

    @precondition(ProtocolMachine.free)
    @rule(
        number=st.integers(0, 1),
        file=st.integers(1, len(SIZES) + 1).map(lambda number: number if number <= len(SIZES) else MOST_FILES + 1),
        operation=st.sampled_from([ftp.LIST, ftp.LIST, ftp.CHECKSUM, ftp.RESET, ftp.REMOVE_FILE, ftp.CREATE]),
    )
    def ask(self, number: int, file: int, operation: int) -> None:
        if operation == ftp.LIST:
            self._start(number, ListFolder(FOLDER, 0, self._fresh(0)))
        else:
            self._start(number, AskOnce(f"{FOLDER}/{file:08d}.BIN", 1, self._fresh(0), operation))

    def _fresh(self, sequence: int) -> int:
        """A number that no earlier request has, in steps larger than a burst."""
        self.sequence += 1500
        return (sequence + self.sequence) & 0xFFFF

    def _start(self, number: int, task: FileTask) -> None:
        self._note(task)
        self.begin(number, task)

    def foreign_requests(self, target: tuple[int, int]) -> list[Any]:
        packets = (
            FtpPacket(7, 0, ftp.RESET, 0),
            FtpPacket(9, 0, ftp.LIST, 1, data=b"/"),
            FtpPacket(11, 0, ftp.OPEN, 26, data=f"{FOLDER}/00000001.BIN".encode()),
        )
        return [mav.MAVLink_file_transfer_protocol_message(0, *target, packet.pack()) for packet in packets]

    # -- the model

    def served(self, message: Any, replies: list[Any]) -> None:
        """A repetition of the latest request has the same answer. Only a session that is idle or ended is unknown."""
        assert len(replies) <= 1
        if (message.target_system, message.target_component) != VEHICLE:
            return
        client, payload = (message.get_srcSystem(), message.get_srcComponent()), bytes(message.payload)
        request = FtpPacket.from_payload(payload)
        self.waiting[client, (request.sequence + 1) & 0xFFFF] = payload
        answers = [bytes(reply.payload) for reply in replies]
        known, answer = self.latest_answer.get(client, (b"", b""))
        if known == payload:
            assert answers == [answer]
        elif answers:
            self._follow(client, answers[0])
        if (client, request.session) in self.opened:
            self.opened[client, request.session] = self.now_ns

    def polled(self, messages: list[Any]) -> None:
        files = [message for message in messages if message.get_type() == "FILE_TRANSFER_PROTOCOL"]
        assert len(files) == len(messages) <= 20
        for message in files:
            client, payload = (message.target_system, message.target_component), bytes(message.payload)
            assert client in self.stations
            if FtpPacket.from_payload(payload).requested != ftp.BURST:
                self._follow(client, payload)

    def _follow(self, client: Address, payload: bytes) -> None:
        answer = FtpPacket.from_payload(payload)
        request = self.waiting[client, answer.sequence]
        asked = FtpPacket.from_payload(request)
        assert (answer.requested, answer.operation in (ftp.ACK, ftp.NAK)) == (asked.operation, True)
        self.latest_answer[client] = request, payload
        if answer.operation == ftp.NAK:
            if answer.data[0] == ftp.INVALID_SESSION:
                used_ns = self.opened.pop((client, asked.session), None)
                assert used_ns is None or self.now_ns - used_ns >= IDLE_NS
        elif asked.operation == ftp.OPEN:
            self.opened[client, answer.session] = self.now_ns
        elif asked.operation == ftp.TERMINATE:
            self.opened.pop((client, asked.session), None)
        elif asked.operation == ftp.RESET:
            self.opened = {key: used_ns for key, used_ns in self.opened.items() if key[0] != client}

    def finished(self, task: Any) -> None:
        if isinstance(task, AskOnce) and task.operation not in (ftp.CHECKSUM, ftp.RESET):
            assert task.refusal == ftp.FILE_PROTECTED
        elif isinstance(task, AskOnce) and task.operation == ftp.RESET:
            assert task.result == b""
        elif None in task.contents:
            assert task.refusal == ftp.FILE_NOT_FOUND
        elif isinstance(task, AskOnce):
            assert task.result in {crc32(content).to_bytes(4, "little") for content in task.contents}
        elif isinstance(task, ListFolder):
            assert len(task.contents) > 1 or task.result in task.contents
        else:
            assert task.result in task.contents


TestFtpMachine = pytest.mark.medium(FtpMachine.TestCase)
TestFtpMachine.settings = settings(max_examples=200, stateful_step_count=30)
