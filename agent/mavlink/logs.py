"""The log messages of MAVLink, the vehicle's side: LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_REQUEST_END, LOG_ERASE.

Logs are read, never deleted: what a run has recorded is not for a link without a password to erase.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Callable, Protocol

from agent.mavlink.exchange import Messages
from agent.mavlink.ftp_server import ServedFile
from agent.wire import dialect as mav

PER_POLL = 20
MOST_PARTS = 256  # that are asked for and not sent yet
DATA_BYTES = 90


class ListedLog(Protocol):
    """A log by its place in the list."""

    @property
    def size(self) -> int:
        """Bytes."""

    @property
    def modified_s(self) -> int:
        """When it was written last, seconds since 1970."""


class Logs(Protocol):
    """The logs there are, oldest first. Nothing here waits: None while the disk is asked."""

    def logs(self) -> Sequence[ListedLog] | None:
        """All of them."""

    def open_log(self, index: int) -> ServedFile | None:
        """One by its place in that list. Raises OSError, or IndexError for one that there is not."""


class LogServer:
    """Serves `logs` to one link, numbered from 1. `refused` says a sentence to the station.

    `poll` sends what was asked for, PER_POLL messages each time at most. dropped: requests for parts while MOST_PARTS
    others waited.
    """

    def __init__(self, logs: Logs, refused: Callable[[str], Messages]) -> None:
        self.dropped = 0
        self._logs = logs
        self._refused = refused
        self._listing: tuple[int, int] | None = None  # first and last number still to be told
        self._number = 0
        self._file: ServedFile | None = None
        self._parts: deque[tuple[int, int]] = deque()  # offset and how much
        self.handlers: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_LOG_REQUEST_LIST: self._on_list,
            mav.MAVLINK_MSG_ID_LOG_REQUEST_DATA: self._on_data,
            mav.MAVLINK_MSG_ID_LOG_REQUEST_END: self._on_end,
            mav.MAVLINK_MSG_ID_LOG_ERASE: self._on_erase,
        }

    def poll(self, most: int = PER_POLL) -> Messages:
        """What is due, `most` messages at most."""
        messages = self._entries(most) if self._listing is not None else []
        while self._parts and len(messages) < most:
            message = self._next_piece()
            if message is None:
                break
            messages.append(message)
        return messages

    # -- list

    def _on_list(self, m: Any, now_ns: int) -> Messages:
        self._listing = (m.start, m.end)
        return []

    def _entries(self, most: int) -> Messages:
        logs = self._logs.logs()
        if logs is None or self._listing is None:
            return []
        count = min(len(logs), 0xFFFF)
        if not count:
            self._listing = None
            return [mav.MAVLink_log_entry_message(0, 0, 0, 0, 0)]
        first, last = max(self._listing[0], 1), min(self._listing[1], count)
        end = min(last, first + most - 1)
        self._listing = (end + 1, last) if end < last else None
        return [self._entry(number, logs[number - 1], count) for number in range(first, end + 1)]

    @staticmethod
    def _entry(number: int, log: ListedLog, count: int) -> Any:
        time_s, size = (min(max(value, 0), 0xFFFFFFFF) for value in (log.modified_s, log.size))
        return mav.MAVLink_log_entry_message(number, count, count, time_s, size)

    # -- data

    def _on_data(self, m: Any, now_ns: int) -> Messages:
        """Parts of one log may be asked for one behind the other; another log ends that."""
        if m.id != self._number:
            self._end()
            self._number = m.id
        if len(self._parts) < MOST_PARTS:
            self._parts.append((m.ofs, max(m.count, 1)))
        else:
            self.dropped += 1
        return []

    def _next_piece(self) -> Any | None:
        """LOG_DATA, of no bytes behind the end of a log and where there is none; None while the disk is waited for."""
        offset, left = self._parts[0]
        try:
            if self._file is None:
                self._file = self._logs.open_log(self._number - 1)
            data = None if self._file is None else self._file.read(offset, min(left, DATA_BYTES))
        except (OSError, IndexError):
            data = b""
        if data is None:
            return None
        self._parts.popleft()
        if len(data) == DATA_BYTES and left > DATA_BYTES:
            self._parts.appendleft((offset + DATA_BYTES, left - DATA_BYTES))
        padded = list(data.ljust(DATA_BYTES, b"\0"))
        return mav.MAVLink_log_data_message(self._number, offset & 0xFFFFFFFF, len(data), padded)

    def _on_end(self, m: Any, now_ns: int) -> Messages:
        self._end()
        return []

    def _end(self) -> None:
        self._number, self._file = 0, None
        self._parts.clear()

    def _on_erase(self, m: Any, now_ns: int) -> Messages:
        return self._refused("LOG_ERASE refused: logs are read, not deleted, over MAVLink; delete the files")
