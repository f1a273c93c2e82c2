"""Where a log goes: the next number in a directory, as ArduPilot names them, or a given file."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Callable

Opener = Callable[[], tuple[Path, int]]
"""Opens the file of a new log; returns its path and descriptor. Raises OSError."""

LAST = "LASTLOG.TXT"
_NAME = re.compile(r"(\d{8,})\.BIN", re.IGNORECASE)
_FLAGS = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)


def in_directory(directory: Path) -> Opener:
    """`00000001.BIN` and so on; a number is never used twice as long as LASTLOG.TXT or the newest log is kept."""

    def open_next() -> tuple[Path, int]:
        directory.mkdir(parents=True, exist_ok=True)
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


def at(path: Path) -> Opener:
    """This file; what it held is replaced, by every log anew."""

    def open_it() -> tuple[Path, int]:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path, os.open(path, _FLAGS | os.O_TRUNC, 0o644)

    return open_it


def _numbers(directory: Path) -> Iterator[int]:
    for entry in directory.iterdir():
        match = _NAME.fullmatch(entry.name)
        if match:
            yield int(match.group(1))
    try:
        yield int((directory / LAST).read_bytes()[:16])
    except (OSError, ValueError):
        return
