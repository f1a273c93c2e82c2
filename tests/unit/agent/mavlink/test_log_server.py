"""LOG_REQUEST_LIST, LOG_REQUEST_DATA and the rest, as ArduPilot's stations use them."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any, NamedTuple

from agent.mavlink.logs import DATA_BYTES, MOST_PARTS, PER_POLL, LogServer
from agent.wire import dialect as mav
from agent.wire.codec import Packer, decode

CONTENTS = [random.Random(number).randbytes(size) for number, size in enumerate((1000, 0, 90, 5001))]


class Log(NamedTuple):
    size: int
    modified_s: int


class File:
    def __init__(self, content: bytes) -> None:
        self._content = content

    @property
    def size(self) -> int:
        return len(self._content)

    def read(self, offset: int, count: int) -> bytes | None:
        return self._content[offset : offset + count]


class Disk:
    """Owes its list and its files once each."""

    def __init__(self, contents: list[bytes]) -> None:
        self._contents = contents
        self._owed = {"list", *range(len(contents))}

    def logs(self) -> Sequence[Log] | None:
        if "list" in self._owed:
            self._owed.remove("list")
            return None
        return [Log(len(content), 1_700_000_000 + number) for number, content in enumerate(self._contents)]

    def open_log(self, index: int) -> File | None:
        if not 0 <= index < len(self._contents):
            raise IndexError(index)
        if index in self._owed:
            self._owed.remove(index)
            return None
        return File(self._contents[index])


def served(contents: list[bytes] = CONTENTS) -> LogServer:
    return LogServer(Disk(contents), lambda text: [mav.MAVLink_statustext_message(4, text.encode()[:50])])


def ask(server: LogServer, message: Any) -> list[Any]:
    message = decode(Packer(255, 190).pack(message))
    replies = server.handlers[message.get_msgId()](message, 0)
    for _ in range(40):
        some = server.poll()
        assert len(some) <= PER_POLL
        replies += some
    return [decode(Packer(1, 1).pack(reply)) for reply in replies]


def data(replies: list[Any]) -> bytes:
    return b"".join(bytes(reply.data[: reply.count]) for reply in replies)


def test_all_logs_are_listed() -> None:
    entries = ask(served(), mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    assert [(e.id, e.num_logs, e.last_log_num, e.size, e.time_utc) for e in entries] == [
        (number + 1, 4, 4, len(content), 1_700_000_000 + number) for number, content in enumerate(CONTENTS)
    ]
    part = ask(served(), mav.MAVLink_log_request_list_message(1, 1, 2, 3))
    assert [entry.id for entry in part] == [2, 3]
    assert ask(served(), mav.MAVLink_log_request_list_message(1, 1, 9, 12)) == []


def test_no_logs_are_one_empty_entry() -> None:
    (entry,) = ask(served([]), mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    assert (entry.id, entry.num_logs, entry.size) == (0, 0, 0)  # as ArduRover 4.7-dev answers


def test_a_log_comes_whole_and_its_end_is_told() -> None:
    for number, content in enumerate(CONTENTS, start=1):
        replies = ask(served(), mav.MAVLink_log_request_data_message(1, 1, number, 0, 0xFFFFFFFF))
        assert data(replies) == content
        assert replies[-1].count < DATA_BYTES
        assert [reply.ofs for reply in replies] == [90 * n for n in range(len(replies))]


def test_parts_may_be_asked_for_one_behind_the_other() -> None:
    server = served()
    for offset in (4500, 90, 0):
        message = decode(Packer(255, 190).pack(mav.MAVLink_log_request_data_message(1, 1, 4, offset, 90)))
        assert server.handlers[message.get_msgId()](message, 0) == []
    replies = ask(server, mav.MAVLink_log_request_data_message(1, 1, 4, 4950, 90))
    assert [(reply.ofs, reply.count) for reply in replies] == [(4500, 90), (90, 90), (0, 90), (4950, 51)]
    assert data(replies) == CONTENTS[3][4500:4590] + CONTENTS[3][90:180] + CONTENTS[3][:90] + CONTENTS[3][4950:]


def test_what_is_not_there_is_answered_at_once() -> None:
    for number, offset in ((9, 0), (0, 0), (1, 5000)):
        (reply,) = ask(served(), mav.MAVLink_log_request_data_message(1, 1, number, offset, 90))
        assert (reply.id, reply.count) == (number, 0)


def test_an_end_ends_it_and_requests_are_bounded() -> None:
    server = served()
    for _ in range(MOST_PARTS + 3):
        message = decode(Packer(255, 190).pack(mav.MAVLink_log_request_data_message(1, 1, 1, 0, 1 << 30)))
        server.handlers[message.get_msgId()](message, 0)
    assert server.dropped == 3
    assert ask(server, mav.MAVLink_log_request_end_message(1, 1)) == []


def test_nothing_is_erased() -> None:
    (text,) = ask(served(), mav.MAVLink_log_erase_message(1, 1))
    assert text.text.startswith("LOG_ERASE refused")
