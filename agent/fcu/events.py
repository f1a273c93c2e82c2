"""Events: sentences for the person at the ground station."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

CRITICAL, ERROR, WARNING, NOTICE, INFO = 2, 3, 4, 5, 6  # MAV_SEVERITY
_MOST = 64


class Event(NamedTuple):
    """A sentence with a MAV_SEVERITY."""

    severity: int
    text: str


class Events:
    """Waits to be taken; when nobody does, the oldest are lost and counted."""

    def __init__(self) -> None:
        self.lost = 0
        self._waiting: deque[Event] = deque(maxlen=_MOST)

    def say(self, severity: int, text: str) -> None:
        """Queue one."""
        if len(self._waiting) == _MOST:
            self.lost += 1
        self._waiting.append(Event(severity, text))

    def take(self) -> list[Event]:
        """All since the last call, oldest first."""
        taken = list(self._waiting)
        self._waiting.clear()
        return taken
