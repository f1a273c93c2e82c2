"""Ports of the loopback address for a test's own programs."""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
from pathlib import Path

_RANGE = range(16_000, 32_000)  # Linux gives 32768 and more to whoever asks for any; xitl's own usual ones are lower
_NEXT = Path(tempfile.gettempdir()) / f"xitl-test-ports-{os.getuid()}"


def free_port(count: int = 1) -> int:
    """The first of `count` in a row that are free, for TCP and for UDP.

    No other process of the tests is given them while it may matter: between here and the program that opens them
    some time goes by.
    """
    with _NEXT.open("a+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.seek(0)
        first = int(file.read() or _RANGE.start)
        for _ in range(len(_RANGE) // count):
            if first + count > _RANGE.stop:
                first = _RANGE.start
            if all(map(_is_free, range(first, first + count))):
                break
            first += count
        else:
            raise AssertionError(f"no {count} free ports in a row from {_RANGE.start} to {_RANGE.stop}")
        file.seek(0)
        file.truncate()
        file.write(str(first + count))
    return first


def _is_free(port: int) -> bool:
    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                return False
    return True


def unread_bytes(port: int) -> int:
    """What has come to a UDP port and was not taken by its program yet, as Linux counts it."""
    lines = Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]
    fields = [line.split() for line in lines]
    return sum(int(each[4].partition(":")[2], 16) for each in fields if int(each[1].partition(":")[2], 16) == port)
