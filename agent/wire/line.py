"""How long a line still has to carry what it was given."""

from __future__ import annotations

from time import monotonic
from typing import Callable


class Line:
    """A line that carries one thing after the other, each for a known time."""

    def __init__(self, clock_s: Callable[[], float] = monotonic) -> None:
        self._clock_s = clock_s
        self._free_at_s = 0.0

    def took(self, busy_s: float) -> None:
        """It was given something that keeps it busy for so long."""
        self._free_at_s = max(self._free_at_s, self._clock_s()) + busy_s

    def backlog_s(self) -> float:
        """Seconds until it is free, 0 when it is."""
        return max(self._free_at_s - self._clock_s(), 0.0)
