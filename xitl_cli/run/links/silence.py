"""When an agent in real time says nothing: what is said about it, and when it is too long."""

from __future__ import annotations

SAID_S = 0.5


class Silence:
    """Watches one agent. It speaks when a motor command of its comes; `limit_s` of silence is more than a run takes.

    Each silence of at least `SAID_S` is told once when it is noticed and once when it ends. longest_s: the longest.
    """

    def __init__(self, limit_s: float, now_ns: int) -> None:
        self.longest_s = 0.0
        self._limit_ns = round(limit_s * 1e9)
        self._heard_ns = now_ns
        self._said = False

    @property
    def under_way(self) -> bool:
        """Whether a silence has been told and has not ended."""
        return self._said

    def heard(self, now_ns: int) -> float | None:
        """A motor command came: the length in seconds of the silence that it ends, if that was told."""
        silent_ns, self._heard_ns = now_ns - self._heard_ns, now_ns
        if not self._said:
            return None
        self._said = False
        self.longest_s = max(self.longest_s, silent_ns * 1e-9)
        return silent_ns * 1e-9

    def noticed(self, now_ns: int) -> bool:
        """Whether a silence is to be told now, for the first time."""
        silent_ns = now_ns - self._heard_ns
        if silent_ns < SAID_S * 1e9:
            return False
        self.longest_s = max(self.longest_s, silent_ns * 1e-9)
        new, self._said = not self._said, True
        return new

    def too_long(self, now_ns: int) -> bool:
        """Whether it has lasted longer than a run takes."""
        return now_ns - self._heard_ns >= self._limit_ns
