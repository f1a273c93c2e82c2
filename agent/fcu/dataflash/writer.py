"""Writes a log without ever holding up who produces it: a bounded queue, and a thread that empties it into the file."""

from __future__ import annotations

import os
import re
import threading
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Callable

CAPACITY_BYTES = 1 << 20  # half a minute of a boat's log
PERIOD_S = 1.0
_CHUNK_BYTES = 1 << 16
_RESERVE = 8  # one part in so many is kept for what comes rarely and matters
_PATIENCE_S = 5.0

# Named here so that a test can put a slow or a full disk in their place.
_write = os.write
_sync = os.fsync
Opener = Callable[[], tuple[Path, int]]
LAST = "LASTLOG.TXT"
MOST_LOGS = 100  # ArduPilot keeps up to 500, on a card of its own
MOST_LOG_BYTES = 4 << 30
LOG_NAME = re.compile(r"(\d{8,})\.BIN", re.IGNORECASE)
_FLAGS = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)


class LogWriter:
    """One log file. The disk is touched by its own thread alone, from the opening on.

    Once a second what has been queued is written and synced, so that a killed process or a cut supply costs the last
    second. When the disk does not keep up, records are dropped and counted. After a write error nothing queued is
    lost: it is tried again every second, from the byte it stopped at, so that the file stays a sequence of records.

    With `lossless`, for a clock that stands still meanwhile, `put` waits for room instead; a disk in trouble is waited
    for once.

    dropped, dropped_bytes: refused by `put`, or still unwritten when `close` gave up. errors: failed attempts to open
    or write. problem: what the last attempt failed of, empty when it did not. path: of the file, None until it is open.
    """

    def __init__(
        self,
        opener: Opener,
        lossless: bool = False,
        capacity_bytes: int = CAPACITY_BYTES,
        period_s: float = PERIOD_S,
    ) -> None:
        self.dropped = 0
        self.dropped_bytes = 0
        self.errors = 0
        self.problem = ""
        self.path: Path | None = None
        self._opener = opener
        self._lossless = lossless
        self._capacity = capacity_bytes
        self._ordinary = capacity_bytes - capacity_bytes // _RESERVE
        self._period_s = period_s
        # Each counter has one thread that changes it, and deque's ends are atomic: no lock is ever waited for.
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
        """Queue one record, an important one into the reserve too; False when it was dropped."""
        size = len(record)
        limit = self._capacity if important else self._ordinary
        if self._accepted - self._written + size > limit and not self._wait_for_room(size, limit):
            self.dropped += 1
            self.dropped_bytes += size
            return False
        self._accepted += size
        self._queue.append(record)
        return True

    @property
    def accepted_bytes(self) -> int:
        """What the file holds once all is written."""
        return self._accepted

    @property
    def unwritten_bytes(self) -> int:
        """Accepted, but not in the file yet."""
        return self._accepted - self._written

    def close(self, last: bytes = b"", timeout_s: float = 2.0) -> bool:
        """Write what is queued, and `last`, and close; False when that did not succeed in the time given.

        A thread that hangs in the disk is left behind; it keeps no process alive.
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
            self.dropped_bytes += self.unwritten_bytes
        return ended

    def _ended(self, timeout_s: float) -> bool:
        self._thread.join(timeout_s)
        return not self._thread.is_alive() and self.unwritten_bytes == 0

    def _wait_for_room(self, size: int, limit: int) -> bool:
        """Only where waiting is allowed."""
        while self._lossless and not self.problem and size <= limit:
            self._room.clear()
            if self._accepted - self._written + size <= limit:
                return True
            self._wake.set()
            self._lossless = self._room.wait(_PATIENCE_S)
        return self._accepted - self._written + size <= limit

    # The thread

    def _run(self) -> None:
        closing = False
        while not closing:
            self._wake.wait(self._period_s)
            self._wake.clear()
            closing = self._closing  # before emptying: what was queued before closing is then seen
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
                self._batch = memoryview(self._next_batch())
            count = _write(self._descriptor, self._batch)
            self._batch = self._batch[count:]
            if not self._batch:
                self._batch_records = 0
            self._written += count
            self._room.set()
            changed = True
        if changed:
            _sync(self._descriptor)

    def _next_batch(self) -> bytes:
        batch = bytearray()
        while self._queue and len(batch) < _CHUNK_BYTES:
            batch += self._queue.popleft()
            self._batch_records += 1
        return bytes(batch)


"""Opens the file of a new log; returns its path and descriptor. Raises OSError."""


def numbered_log_opener(directory: Path) -> Opener:
    """`00000001.BIN` and so on; a number is never used twice as long as LASTLOG.TXT or the newest log is kept.

    The oldest logs go when there are `MOST_LOGS` with the new one, or they have more than `MOST_LOG_BYTES`.
    """

    def open_next() -> tuple[Path, int]:
        directory.mkdir(parents=True, exist_ok=True)
        _remove_oldest(directory)
        number = max(_numbers(directory), default=0) + 1
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
    """This file; what it held is replaced, by every log anew."""

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


def _numbers(directory: Path) -> Iterator[int]:
    for entry in directory.iterdir():
        match = LOG_NAME.fullmatch(entry.name)
        if match:
            yield int(match.group(1))
    try:
        with (directory / LAST).open("rb") as file:
            yield int(file.read(16))
    except (OSError, ValueError):
        return
