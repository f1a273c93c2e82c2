"""What stands between python-can's slcan and the serial port of the adapter: nothing waits, and reading is cheap.

python-can writes a line and waits until it is out, and reads byte by byte; over pyserial that is a system call each,
which a board cannot afford.
"""

from __future__ import annotations

import errno
import os
import termios
from contextlib import suppress
from typing import Any

CHUNK_BYTES = 4096


class Adapter:
    """What a bus does not tell of itself: nothing, as far as is known."""

    def has_room(self) -> bool:
        """Whether a frame would be taken."""
        return True

    def has_input(self) -> bool:
        """Whether there are frames that select() does not see."""
        return False


class SlcanPort(Adapter):
    """Takes the place of the pyserial port, with the names that python-can looks up."""

    def __init__(self, port: Any) -> None:
        self.write_timeout = None
        self._port = port
        self._descriptor: int = port.fileno()
        self._unread = b""
        self._at = 0
        self._unwritten = b""
        attributes = termios.tcgetattr(self._descriptor)
        attributes[6][termios.VMIN] = 1  # so that an empty read means that the adapter is gone
        termios.tcsetattr(self._descriptor, termios.TCSANOW, attributes)

    def has_input(self) -> bool:
        return self._at < len(self._unread)

    def has_room(self) -> bool:
        """Raises OSError when the adapter is gone."""
        if self._unwritten:
            with suppress(BlockingIOError, InterruptedError):
                self._unwritten = self._unwritten[os.write(self._descriptor, self._unwritten) :]
        return not self._unwritten

    @property
    def in_waiting(self) -> int:
        """Bytes that `read` has. Raises OSError when the adapter is gone."""
        if self._at >= len(self._unread):
            self._at, self._unread = 0, b""
            with suppress(BlockingIOError, InterruptedError):
                self._unread = os.read(self._descriptor, CHUNK_BYTES)
                if not self._unread:
                    raise OSError(errno.EIO, os.strerror(errno.EIO))
        return len(self._unread) - self._at

    def read(self, size: int = 1) -> bytes:
        """Bytes of those that `in_waiting` found."""
        at = self._at
        self._at = at + size
        return self._unread[at : at + size]

    def write(self, line: bytes) -> int:
        """Takes all of it; what the adapter does not take yet goes with the next `has_room`."""
        self._unwritten += line
        self.has_room()
        return len(line)

    def flush(self) -> None:
        """Does not wait."""

    def reset_input_buffer(self) -> None:
        """Forget what has not been read."""
        self._at, self._unread = 0, b""
        self._port.reset_input_buffer()

    def fileno(self) -> int:
        """Of the port."""
        return self._descriptor

    def close(self) -> None:
        """Close the port."""
        self._port.close()
