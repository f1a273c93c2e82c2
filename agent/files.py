"""Files that a person names: regular ones, read whole within bounds. A device or a pipe may never end."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MOST_BYTES = 16 << 20


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """What is in the file. Raises OSError, whose `strerror` says what is wrong, for one that cannot be read whole."""
    return read_with_status(path, most)[0]


def read_with_status(path: Path, most: int = MOST_BYTES) -> tuple[bytes, os.stat_result]:
    """The same, with the status of the file that was read."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))  # without it a pipe waits for its writer
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "is no regular file", str(path))
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"has more than {most >> 20} MiB", str(path))
    return data, status


def read_text(path: Path, most: int = MOST_BYTES) -> str:
    """The same as UTF-8 text with lines that end in a newline. Raises UnicodeDecodeError too."""
    return as_text(read_bytes(path, most))


def as_text(data: bytes) -> str:
    """UTF-8 text with lines that end in a newline. Raises UnicodeDecodeError."""
    return data.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
