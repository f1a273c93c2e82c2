"""The instants of a world's frames: whole microseconds, at a rate that may change at any frame."""

from __future__ import annotations

_SURPLUS_S = 1e-9
"""ArduPilot adds each step to its clock in whole microseconds, cut off: a step that is meant to be one more than its
binary fraction says would lose it. So each is told longer by this, and its clock keeps to ours."""


class FrameTimes:
    """Frame k after a change of rate is at its instant + k / rate, cut to microseconds."""

    def __init__(self, start_us: int) -> None:
        self._base_us = start_us
        self._rate_hz = 1
        self._index = 0
        self._total = 0
        self.last_us = start_us

    def set_rate(self, rate_hz: int) -> None:
        """From the last frame on."""
        if rate_hz != self._rate_hz:
            self._rate_hz, self._base_us, self._index = rate_hz, self.last_us, 0

    def up_to(self, end_us: int, most: int) -> list[tuple[int, float]]:
        """The next frames that are not after `end_us`, at most so many: instant in us, and the seconds to tell."""
        base_us, rate_hz, index, total = self._base_us, self._rate_hz, self._index, self._total
        found: list[tuple[int, float]] = []
        while len(found) < most:
            at_us = base_us + (index + 1) * 1_000_000 // rate_hz
            if at_us > end_us:
                break
            index += 1
            total += 1
            found.append((at_us, at_us * 1e-6 + total * _SURPLUS_S))
        if found:
            self._index, self._total, self.last_us = index, total, found[-1][0]
        return found
