"""MAVLink log messages, server on the vehicle: LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_REQUEST_END, LOG_ERASE.

Logs are read and never deleted: a link without a password must not erase the records of a run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Callable, Protocol

from agent.mavlink.exchange import Messages
from agent.mavlink.ftp_server import ServedFile
from agent.wire import dialect as mav

PER_POLL = 20
MOST_PARTS = 256  # limit of requested parts that were not sent yet
DATA_BYTES = 90


class ListedLog(Protocol):
    """A log in the list."""

    @property
    def size(self) -> int:
        """Size in bytes."""

    @property
    def modified_s(self) -> int:
        """Time of the last write, seconds since 1970."""


class Logs(Protocol):
    """Available logs, oldest first. No method blocks: None while the disk is being read."""

    def logs(self) -> Sequence[ListedLog] | None:
        """Return all logs."""

    def open_log(self, index: int) -> ServedFile | None:
        """Open a log by its index in that list. Raises OSError, or IndexError for an invalid index."""


class LogServer:
    """Serves `logs` to one link, numbered from 1.

    refused: returns the messages of a refusal.

    `poll` sends the requested data, at most PER_POLL messages each time.
    dropped: requests for parts that arrived while MOST_PARTS others waited.
    """

    def __init__(self, logs: Logs, refused: Callable[[str], Messages]) -> None:
        self.dropped = 0
        self._logs = logs
        self._refused = refused
        self._listing: tuple[int, int] | None = None  # first and last number that remain to be listed
        self._number = 0
        self._file: ServedFile | None = None
        self._parts: deque[tuple[int, int]] = deque()  # offset and size
        self.handlers: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_LOG_REQUEST_LIST: self._on_list,
            mav.MAVLINK_MSG_ID_LOG_REQUEST_DATA: self._on_data,
            mav.MAVLINK_MSG_ID_LOG_REQUEST_END: self._on_end,
            mav.MAVLINK_MSG_ID_LOG_ERASE: self._on_erase,
        }

    def poll(self, most: int = PER_POLL) -> Messages:
        """Return the messages that are due, at most `most`."""
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
        entries = []
        for number in range(first, end + 1):
            log = logs[number - 1]
            time_s, size = (min(max(value, 0), 0xFFFFFFFF) for value in (log.modified_s, log.size))
            entries.append(mav.MAVLink_log_entry_message(number, count, count, time_s, size))
        return entries

    # -- data

    def _on_data(self, m: Any, now_ns: int) -> Messages:
        """Queue a part of a log. Several parts of one log may be queued; a request for another log removes them."""
        if m.id != self._number:
            self._end()
            self._number = m.id
        if len(self._parts) < MOST_PARTS:
            self._parts.append((m.ofs, max(m.count, 1)))
        else:
            self.dropped += 1
        return []

    def _next_piece(self) -> Any | None:
        """Return a LOG_DATA, with zero bytes after the end or for an unknown log. None while waiting for the disk."""
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
        return self._refused("LOG_ERASE refused: logs cannot be deleted over MAVLink; delete the files")
