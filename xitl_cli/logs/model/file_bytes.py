"""The bytes of a file: all of them, in memory or mapped where it is large; or in pieces, where it may be larger."""

from __future__ import annotations

import contextlib
import mmap
import os
import stat
from pathlib import Path

import numpy as np

from xitl_cli.logs.model.errors import LogError

LARGE = 64 << 20
"""Bytes from which on a file is mapped: until there, reading it is no slower."""


class FileBytes:
    """data: (N,) uint8, read-only, as the file was when it was opened.

    What is read may be cut short or written anew meanwhile, as by a run that begins again. A mapped file must stay as
    long as it is: the system ends a process that reads what is gone. Raises LogError.
    """

    def __init__(self, path: Path) -> None:
        self._map: mmap.mmap | None = None
        try:
            with path.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                if size > LARGE:
                    self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
                content = file.read(size) if self._map is None else self._map
        except OSError as error:
            raise LogError(f"{path}: cannot be read ({error.strerror}); check the path") from error
        self.data = np.frombuffer(content, np.uint8)

    def forget(self, start: int, stop: int) -> None:
        """Release the memory of these bytes where the file is mapped."""
        if self._map is not None and hasattr(mmap, "MADV_DONTNEED"):
            self._map.madvise(mmap.MADV_DONTNEED, start, min(stop, len(self.data)) - start)

    def close(self) -> None:
        self.data = np.empty(0, np.uint8)
        if self._map is not None:
            with contextlib.suppress(BufferError):  # a table is still held; the mapping goes with it
                self._map.close()


_WINDOW = 1 << 16


class FileReader:
    """Reads pieces of a file. size: when it was opened; what a recorder adds later is not seen."""

    def __init__(self, path: Path) -> None:
        try:
            self._file = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
        except OSError as error:
            raise LogError(f"{path}: cannot be read ({error.strerror}); check the path") from error
        status = os.fstat(self._file)
        if stat.S_ISDIR(status.st_mode):
            self.close()
            raise LogError(f"{path}: cannot be read (it is a directory); name a file in it")
        self.size = status.st_size
        self._window = b""
        self._window_at = 0

    def read(self, place: int, size: int) -> bytes:
        """`size` bytes from `place`; fewer at the end of the file, none outside of it or on a disk error."""
        end = min(place + size, self.size)
        if place < 0 or end <= place:
            return b""
        parts = []
        while place < end:
            try:
                os.lseek(self._file, place, os.SEEK_SET)
                part = os.read(self._file, min(end - place, 1 << 30))
            except OSError:
                break
            if not part:
                break
            parts.append(part)
            place += len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def peek(self, place: int, size: int) -> bytes:
        """As `read`, buffered, for a few bytes of many records in turn."""
        begin = place - self._window_at
        if begin < 0 or begin + size > len(self._window):
            if size > _WINDOW:
                return self.read(place, size)
            self._window, self._window_at, begin = self.read(place, _WINDOW), place, 0
        return self._window[begin : begin + size]

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
