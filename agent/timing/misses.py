"""Deadlines that were missed, one by one, until somebody asks."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

MOST_KEPT = 64


class Miss(NamedTuple):
    """A task that came late by a cycle or more, or took longer than it had.

    cycle, due_ns: the cycle that was due, counted from 0 in periods since the start, and when. start_ns, end_ns: of the
    run it got. skipped: cycles that were due after it before it started; they are never made up for. All on the
    executor's clock.
    """

    task: str
    cycle: int
    due_ns: int
    start_ns: int
    end_ns: int
    skipped: int


class Misses:
    """The misses nobody has taken yet, at most `MOST_KEPT`: the first ones, as they tell how it began.

    unreported: misses for which there was no room.
    """

    def __init__(self) -> None:
        self.unreported = 0
        self._kept: deque[Miss] = deque()

    def __len__(self) -> int:
        return len(self._kept)

    def note(self, miss: Miss) -> None:
        """Keep it, if there is room."""
        if len(self._kept) < MOST_KEPT:
            self._kept.append(miss)
        else:
            self.unreported += 1

    def take(self, most: int) -> list[Miss]:
        """The oldest ones, at most so many."""
        kept = self._kept
        return [kept.popleft() for _ in range(min(most, len(kept)))]

    def clear(self) -> None:
        """As at the start."""
        self.unreported = 0
        self._kept.clear()
