"""Writes a log without ever blocking its producer: a bounded queue, and a thread that writes it to the file."""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections import deque
from pathlib import Path
from typing import Callable

CAPACITY_BYTES = 1 << 20  # half a minute of a boat's log
PERIOD_S = 1.0
_CHUNK_BYTES = 1 << 16
_RESERVE = 8  # this part of the queue is reserved for rare and important records
_PATIENCE_S = 5.0

# Defined here so that a test can substitute a slow or full disk.
_write = os.write
_sync = os.fsync
Opener = Callable[[], tuple[Path, int]]
LAST = "LASTLOG.TXT"
MOST_LOGS = 100  # ArduPilot keeps up to 500, on a separate card
MOST_LOG_BYTES = 4 << 30
LOG_NAME = re.compile(r"(\d{8,})\.BIN", re.IGNORECASE)
_FLAGS = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)


class LogWriter:
    """One log file. Only its own thread accesses the disk, including the opening.

    Once a second the queue is written and synced, so that a killed process or a power failure costs the last second.
    When the disk is too slow, records are dropped and counted. After a write error no queued record is lost. The write
    is retried every second from the byte at which it stopped, so that the file remains a sequence of records.

    lossless: `put` waits for room, for a clock that stops meanwhile. It waits only once for a faulty disk.
    """

    def __init__(
        self,
        opener: Opener,
        lossless: bool = False,
        capacity_bytes: int = CAPACITY_BYTES,
        period_s: float = PERIOD_S,
    ) -> None:
        self.dropped = 0
        """Number of records that `put` refused, or that were unwritten when `close` gave up."""
        self.errors = 0
        """Number of failed attempts to open or write."""
        self.problem = ""
        """Error of the last attempt, empty after a success."""
        self.path: Path | None = None
        """Path of the file, None until it is open."""
        self._opener = opener
        self._lossless = lossless
        self._capacity = capacity_bytes
        self._ordinary = capacity_bytes - capacity_bytes // _RESERVE
        self._period_s = period_s
        # Only one thread changes each counter, and the ends of a deque are atomic. So no lock is needed.
        self._queue: deque[bytes] = deque()
        self._accepted = 0
        self._written = 0
        self._batch = memoryview(b"")
        self._batch_records = 0
        self._descriptor = -1
        self._wake = threading.Event()
        self._wake.set()  # open the file at once
        self._room = threading.Event()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="log writer", daemon=True)
        self._thread.start()

    def put(self, record: bytes, important: bool = False) -> bool:
        """Queue a record. An important one may use the reserve. Return False when it was dropped."""
        size = len(record)
        limit = self._capacity if important else self._ordinary
        if self._accepted - self._written + size > limit and not self._wait_for_room(size, limit):
            self.dropped += 1
            return False
        self._accepted += size
        self._queue.append(record)
        return True

    @property
    def accepted_bytes(self) -> int:
        """Size of the file once all records are written."""
        return self._accepted

    @property
    def unwritten_bytes(self) -> int:
        """Accepted bytes that are not in the file yet."""
        return self._accepted - self._written

    def close(self, last: bytes = b"", timeout_s: float = 2.0) -> bool:
        """Write the queue and `last`, and close the file. Return False when this did not finish in time.

        A thread that is blocked by the disk is abandoned. It does not keep the process alive.
        """
        if self._closing:
            return self._ended(timeout_s)
        if last:
            self._accepted += len(last)
            self._queue.append(last)
        self._closing = True
        self._wake.set()
        ended = self._ended(timeout_s)
        if not ended:
            self.dropped += self._batch_records + len(self._queue)
        return ended

    def _ended(self, timeout_s: float) -> bool:
        self._thread.join(timeout_s)
        return not self._thread.is_alive() and self.unwritten_bytes == 0

    def _wait_for_room(self, size: int, limit: int) -> bool:
        """Wait for room, only if lossless."""
        while self._lossless and not self.problem and size <= limit:
            self._room.clear()
            if self._accepted - self._written + size <= limit:
                return True
            self._wake.set()
            self._lossless = self._room.wait(_PATIENCE_S)
        return self._accepted - self._written + size <= limit

    # -- the writer thread

    def _run(self) -> None:
        closing = False
        while not closing:
            self._wake.wait(self._period_s)
            self._wake.clear()
            closing = self._closing  # read before emptying, so that everything queued before closing is written
            try:
                self._empty()
                self.problem = ""
            except OSError as error:
                self.errors += 1
                self.problem = f"{error.strerror or error} ({error.filename or self.path or 'log'})"
            self._room.set()
        if self._descriptor >= 0:
            os.close(self._descriptor)

    def _empty(self) -> None:
        if self._descriptor < 0:
            self.path, self._descriptor = self._opener()
        changed = False
        while self._batch or self._queue:
            if not self._batch:
                batch = bytearray()
                while self._queue and len(batch) < _CHUNK_BYTES:
                    batch += self._queue.popleft()
                    self._batch_records += 1
                self._batch = memoryview(bytes(batch))
            count = _write(self._descriptor, self._batch)
            self._batch = self._batch[count:]
            if not self._batch:
                self._batch_records = 0
            self._written += count
            self._room.set()
            changed = True
        if changed:
            _sync(self._descriptor)


# Openers: each opens the file of a new log and returns its path and descriptor. They raise OSError.


def numbered_log_opener(directory: Path) -> Opener:
    """Open `00000001.BIN` and so on. No number is reused while LASTLOG.TXT or the newest log exists.

    The oldest logs are removed when there are `MOST_LOGS` including the new one, or more than `MOST_LOG_BYTES`.
    """

    def open_next() -> tuple[Path, int]:
        directory.mkdir(parents=True, exist_ok=True)
        _remove_oldest(directory)
        names = (LOG_NAME.fullmatch(path.name) for path in directory.iterdir())
        numbers = [int(name[1]) for name in names if name]
        with contextlib.suppress(OSError, ValueError), (directory / LAST).open("rb") as file:
            numbers.append(int(file.read(16)))
        number = max(numbers, default=0) + 1
        while True:
            path = directory / f"{number:08d}.BIN"
            try:
                descriptor = os.open(path, _FLAGS | os.O_EXCL, 0o644)
                break
            except FileExistsError:
                number += 1
        try:
            (directory / LAST).write_bytes(b"%d\r\n" % number)
        except OSError:
            os.close(descriptor)
            path.unlink()
            raise
        return path, descriptor

    return open_next


def fixed_log_opener(path: Path) -> Opener:
    """Open this file. Each new log replaces its content."""

    def open_it() -> tuple[Path, int]:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path, os.open(path, _FLAGS | os.O_TRUNC, 0o644)

    return open_it


def _remove_oldest(directory: Path) -> None:
    logs = sorted(path for path in directory.iterdir() if LOG_NAME.fullmatch(path.name))
    sizes = [path.stat().st_size for path in logs]
    total = sum(sizes)
    for number, (path, size) in enumerate(zip(logs, sizes)):
        if len(logs) - number < MOST_LOGS and total <= MOST_LOG_BYTES:
            return
        path.unlink()
        total -= size
