"""A board's console: its output so far, from its file, and an attached terminal."""

from __future__ import annotations

import os
import re
import select
import socket
import sys
import termios
import tty
from pathlib import Path

from xitl_cli.errors import UserError

_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b[()][A-Z0-9]|\x1b[=>78]|[\x00-\x08\x0b-\x1f]")


class ConsoleFile:
    """The file to which the emulator writes its console."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def text(self) -> str:
        """Return all output without cursor control sequences; empty if there is none."""
        try:
            return _CONTROL.sub("", self._path.read_bytes().decode("utf-8", "replace").replace("\r\n", "\n"))
        except OSError:
            return ""

    def last_line(self) -> str:
        """Return the last line that is not empty."""
        lines = [line.strip() for line in self.text().splitlines() if line.strip()]
        return lines[-1] if lines else ""


LEAVE = b"\x1d"  # Ctrl-]


def attach(path: Path, log: Path) -> None:
    """Attach this terminal to the console until Ctrl-], the end of the input or of the emulator. Raises UserError."""
    connection = socket.socket(socket.AF_UNIX)
    try:
        connection.connect(str(path))
    except OSError as error:
        raise UserError(f"{path}: the console does not answer ({error.strerror}); is it open elsewhere?") from None
    source, sink = sys.stdin.fileno(), sys.stdout.fileno()
    os.write(sink, log.read_bytes()[-2000:])
    kept = termios.tcgetattr(source) if os.isatty(source) else None
    try:
        if kept is not None:
            tty.setraw(source)
        with connection:
            while True:
                for ready in select.select([connection, source], [], [])[0]:
                    data = connection.recv(4096) if ready is connection else os.read(source, 4096)
                    if not data or (ready is source and LEAVE in data):
                        return
                    if ready is connection:
                        os.write(sink, data)
                    else:
                        connection.sendall(data)
    finally:
        if kept is not None:
            termios.tcsetattr(source, termios.TCSADRAIN, kept)
