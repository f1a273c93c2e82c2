"""Files that a person names: regular ones, read whole within bounds. A device or a pipe may never end."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MOST_BYTES = 16 << 20


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """What is in the file. Raises OSError, whose `strerror` says what is wrong, for one that cannot be read whole."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))  # without it a pipe waits for its writer
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "is no regular file", str(path))
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"has more than {most >> 20} MiB", str(path))
    return data


def read_text(path: Path, most: int = MOST_BYTES) -> str:
    """The same as UTF-8 text with lines that end in a newline. Raises UnicodeDecodeError too."""
    return read_bytes(path, most).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
