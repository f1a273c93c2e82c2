"""Bytes of a file: as a whole, in memory or mapped if it is large, or in pieces if it may exceed the memory."""

from __future__ import annotations

import contextlib
import mmap
import os
import stat
from pathlib import Path

import numpy as np

from xitl_cli.logs.model.errors import LogError

LARGE = 64 << 20
"""Size in bytes from which a file is mapped. Below it, reading is as fast."""


class FileBytes:
    """Contents of a whole file. `data`: (N,) uint8, read-only, as the file was when it was opened.

    A read file may be truncated or rewritten later, for example by a run that begins again. A mapped file must keep its
    size: the system ends a process that reads a truncated part. Raises LogError.
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
        """Release the memory of these bytes if the file is mapped."""
        if self._map is not None and hasattr(mmap, "MADV_DONTNEED"):
            self._map.madvise(mmap.MADV_DONTNEED, start, min(stop, len(self.data)) - start)

    def close(self) -> None:
        self.data = np.empty(0, np.uint8)
        if self._map is not None:
            with contextlib.suppress(BufferError):  # a table still uses it; the mapping is released with the table
                self._map.close()


_WINDOW = 1 << 16


class FileReader:
    """Reads pieces of a file. `size`: its size when it was opened; later additions are not visible."""

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
        """Like `read`, but buffered, for a few bytes of many consecutive records."""
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
