"""Stored logs for stations that read them. A thread lists and reads them, so that nothing else waits for the disk."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import threading
import time
from collections import deque
from pathlib import Path
from typing import Callable, NamedTuple

from agent.fcu.dataflash.writer import LOG_NAME

WINDOW_BYTES = 1 << 16
WINDOWS = 4  # kept per open log
FRESH_S = 1.0  # validity of a list


class StoredLog(NamedTuple):
    """A log at the time of the listing."""

    name: str
    """Name for stations."""
    path: Path
    size: int
    modified_s: int
    identity: tuple[int, int]
    """Device and inode of the file."""


class StoredLogs:
    """The numbered logs of a directory, or one file, oldest first. See `agent.mavlink.logs.Logs`.

    A log that is being written is included up to its present end. Only regular files are listed and read. A symbolic
    link could lead to any file of this machine, and a pipe would block the thread.
    """

    def __init__(self, directory: Path | None = None, file: Path | None = None) -> None:
        self._directory = directory
        self._file = file
        self._disk = _Disk()
        self._listed: tuple[StoredLog, ...] | None = None
        self._listed_s = -FRESH_S
        self._asked = False

    def logs(self) -> tuple[StoredLog, ...] | None:
        if time.monotonic() - self._listed_s > FRESH_S and not self._asked:
            self._asked = True
            self._disk.submit(self._list)
        return None if self._asked else self._listed

    def open_log(self, index: int) -> ServedLog | None:
        logs = self.logs()
        if logs is None:
            return None
        if not 0 <= index < len(logs):
            raise IndexError(index)
        return ServedLog(logs[index], self._disk)

    def _list(self) -> None:
        """List the logs. Runs in the thread."""
        logs: list[StoredLog] = []
        paths: list[tuple[str, Path]] = []
        try:
            if self._file is not None:
                paths = [("00000001.BIN", self._file)]
            elif self._directory is not None and self._directory.is_dir():
                numbered = [(LOG_NAME.fullmatch(path.name), path) for path in self._directory.iterdir()]
                in_order = sorted((int(match[1]), path) for match, path in numbered if match)
                paths = [(path.name.upper(), path) for _, path in in_order]
            for name, path in paths:
                try:
                    status = path.lstat()
                except FileNotFoundError:
                    continue
                if stat.S_ISREG(status.st_mode):
                    identity = (status.st_dev, status.st_ino)
                    logs.append(StoredLog(name, path, status.st_size, int(status.st_mtime), identity))
        finally:
            self._listed = tuple(logs)
            self._listed_s = time.monotonic()
            self._asked = False


def _open_listed(log: StoredLog, flags: int) -> int:
    """Open the listed file. Raises OSError for a different file, for example if a directory above has become a link."""
    descriptor = os.open(log.path, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    status = os.fstat(descriptor)
    if (status.st_dev, status.st_ino) != log.identity:
        os.close(descriptor)
        raise FileNotFoundError(errno.ENOENT, "was replaced", str(log.path))
    return descriptor


class ServedLog:
    """A log with the size of its listing. See `agent.mavlink.ftp_server.ServedFile`."""

    def __init__(self, log: StoredLog, disk: _Disk) -> None:
        self._log = log
        self._disk = disk
        self._windows: dict[int, bytes] = {}
        self._wanted: set[int] = set()
        self._error: OSError | None = None

    @property
    def size(self) -> int:
        return self._log.size

    def read(self, offset: int, count: int) -> bytes | None:
        count = min(count, self.size - offset)
        if count <= 0:
            return b""
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        first, last = offset // WINDOW_BYTES, (offset + count - 1) // WINDOW_BYTES
        windows = [self._windows.get(number) for number in range(first, last + 1)]
        for number in range(first, last + 2):  # read the next one too, because it will be requested soon
            if number not in self._windows and number not in self._wanted and number * WINDOW_BYTES < self.size:
                self._wanted.add(number)
                self._disk.submit(lambda number=number: self._load(number))  # type: ignore[misc]
        if any(window is None for window in windows):
            return None
        start = offset - first * WINDOW_BYTES
        return b"".join(window for window in windows if window is not None)[start : start + count]

    def _load(self, number: int) -> None:
        """Read a window. Runs in the thread."""
        try:
            with open(self._log.path, "rb", opener=lambda path, flags: _open_listed(self._log, flags)) as file:
                file.seek(number * WINDOW_BYTES)
                data = file.read(WINDOW_BYTES)
            windows = dict(self._windows)
            while len(windows) >= WINDOWS:
                del windows[next(iter(windows))]
            windows[number] = data
            self._windows = windows
        except OSError as error:
            self._error = error
        finally:
            self._wanted.discard(number)


class _Disk:
    """Runs work items in order in a daemon thread, which starts with the first item."""

    def __init__(self) -> None:
        self._work: deque[Callable[[], None]] = deque()
        self._there = threading.Semaphore(0)
        self._thread: threading.Thread | None = None

    def submit(self, work: Callable[[], None]) -> None:
        """Queue a work item."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="log reader", daemon=True)
            self._thread.start()
        self._work.append(work)
        self._there.release()

    def _run(self) -> None:
        if hasattr(os, "sched_setscheduler") and hasattr(os, "SCHED_OTHER"):
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # only this thread: it is not urgent
        while True:
            self._there.acquire()
            try:
                self._work.popleft()()
            except OSError:
                continue  # the waiting caller asks again
