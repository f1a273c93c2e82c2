"""Two pseudo-terminals and a thread that carries bytes between them: lines and buses without hardware."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from abc import ABC, abstractmethod
from contextlib import suppress

from xitl_cli.errors import UserError

TICK_S = 0.001


class PtyPair(ABC):
    """Two devices, `devices`. Subclasses say what becomes of the bytes, about every millisecond.

    Raises UserError, which begins with `where`, when there are no pseudo-terminals.
    """

    def __init__(self, where: str) -> None:
        self._masters: list[int] = []
        self._slaves: list[int] = []
        try:
            for _ in range(2):
                master, slave = os.openpty()
                self._masters.append(master)
                self._slaves.append(slave)  # kept open, so that the line is not hung up while nobody has it
                tty.setraw(slave)
                os.set_blocking(master, False)
        except OSError as error:
            self._give_back()
            raise UserError(f"{where}: no pseudo-terminal can be had ({error.strerror}); mount /dev/pts") from error
        self.devices = (os.ttyname(self._slaves[0]), os.ttyname(self._slaves[1]))
        self._stop_reader, self._stop_writer = os.pipe()
        self._closed = False
        self._thread = threading.Thread(target=self._carry, name=where, daemon=True)
        self._thread.start()

    @abstractmethod
    def _room(self, end: int) -> int:
        """How many bytes are wanted from an end, 0 for none."""

    @abstractmethod
    def _take(self, end: int, data: bytes, now_s: float) -> None:
        """Bytes that an end has sent."""

    @abstractmethod
    def _due(self, now_s: float) -> list[tuple[int, bytes]]:
        """(end, bytes) that have arrived by now."""

    @abstractmethod
    def _busy(self) -> bool:
        """Whether bytes are under way."""

    def _carry(self) -> None:
        while True:
            wanted = [end for end in (0, 1) if self._room(end) > 0]
            sources = [self._masters[end] for end in wanted]
            ready, _, _ = select.select([*sources, self._stop_reader], (), (), TICK_S if self._busy() else None)
            if self._stop_reader in ready:
                return
            now_s = time.monotonic()
            for end in wanted:
                if self._masters[end] in ready:
                    with suppress(OSError):
                        self._take(end, os.read(self._masters[end], self._room(end)), now_s)
            for end, data in self._due(now_s):
                with suppress(OSError):  # what a full or absent receiver does not take is lost, as on a real line
                    os.write(self._masters[end], data)

    def close(self) -> None:
        """Stop, and take the devices away. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        os.write(self._stop_writer, b"x")
        self._thread.join()
        os.close(self._stop_reader)
        os.close(self._stop_writer)
        self._give_back()

    def _give_back(self) -> None:
        for descriptor in (*self._masters, *self._slaves):
            with suppress(OSError):
                os.close(descriptor)
