"""How long an answer may take: in lockstep simulation time runs many times faster than a line and a process can."""

from __future__ import annotations

import time

WALL_SHARE = 0.25
"""Of the seconds of simulation time, so many have to have passed on the wall too."""


class Patience:
    """From `start` on; over when both clocks say so. In real time that is the one of the simulation."""

    def __init__(self) -> None:
        self._sim_ns: int | None = None
        self._wall_s = 0.0

    @property
    def started(self) -> bool:
        """Whether anything is waited for."""
        return self._sim_ns is not None

    def start(self, sim_ns: int) -> None:
        """Wait from now on."""
        self._sim_ns, self._wall_s = sim_ns, time.monotonic()

    def stop(self) -> None:
        """Nothing is waited for any more."""
        self._sim_ns = None

    def is_over(self, sim_ns: int, seconds: float) -> bool:
        """Whether `seconds` have passed since the start; False without one."""
        if self._sim_ns is None or sim_ns - self._sim_ns < seconds * 1e9:
            return False
        return time.monotonic() - self._wall_s >= seconds * WALL_SHARE
