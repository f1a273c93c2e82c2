"""Files that a user names: regular files, read completely up to a limit. A device or a pipe may never end."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MOST_BYTES = 16 << 20


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a file. Raises OSError, with the cause in `strerror`, when it cannot be read completely."""
    return read_with_status(path, most)[0]


def read_with_status(path: Path, most: int = MOST_BYTES) -> tuple[bytes, os.stat_result]:
    """Return the content, and the status of the file that was read."""
    # A pipe would block without O_NONBLOCK, and Windows would change line ends without O_BINARY
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "is not a regular file", str(path))
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"has more than {most >> 20} MiB", str(path))
    return data, status


def read_text(path: Path, most: int = MOST_BYTES) -> str:
    """Return the content as UTF-8 text with newline line endings. Raises OSError and UnicodeDecodeError."""
    return as_text(read_bytes(path, most))


def as_text(data: bytes) -> str:
    """Return UTF-8 text with newline line endings. Raises UnicodeDecodeError."""
    return data.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
