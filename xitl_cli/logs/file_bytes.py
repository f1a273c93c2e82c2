"""The bytes of a file: in memory, or mapped where it is large."""

from __future__ import annotations

import contextlib
import mmap
import os
from pathlib import Path

import numpy as np

LARGE = 64 << 20
"""Bytes from which on a file is mapped: until there, reading it is no slower."""


class FileBytes:
    """data: (N,) uint8, read-only, as the file was when it was opened.

    What is read may be cut short or written anew meanwhile, as by a run that begins again. A mapped file must stay as
    long as it is: the system ends a process that reads what is gone. Raises OSError.
    """

    def __init__(self, path: Path) -> None:
        self._map: mmap.mmap | None = None
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > LARGE:
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            content = file.read(size) if self._map is None else self._map
        self.data = np.frombuffer(content, np.uint8)

    def forget(self, start: int, stop: int) -> None:
        """Give the memory of these bytes back, where they can be had again."""
        if self._map is not None and hasattr(mmap, "MADV_DONTNEED"):
            self._map.madvise(mmap.MADV_DONTNEED, start, min(stop, len(self.data)) - start)

    def close(self) -> None:
        self.data = np.empty(0, np.uint8)
        if self._map is not None:
            with contextlib.suppress(BufferError):  # a table is still held; the mapping goes with it
                self._map.close()
