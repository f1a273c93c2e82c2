"""The last second of true motion, to hold late news against."""

from __future__ import annotations

from collections import deque

from sim_core.kinematics import Kinematics

KEPT_S = 1.0


class TruthHistory:
    """Motion at every physics step, found again by its instant."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = 1e9 / rate_hz
        self._motions: deque[Kinematics] = deque(maxlen=max(round(KEPT_S * rate_hz), 1))
        self._newest_ns = 0

    def add(self, stamp_ns: int, motion: Kinematics) -> None:
        """The motion after the step that ended at `stamp_ns`."""
        self._newest_ns = stamp_ns
        self._motions.append(motion)

    def at(self, stamp_ns: int) -> Kinematics | None:
        """The motion nearest to an instant, None when it is older than what is kept; a future one gets the newest."""
        back = max(round((self._newest_ns - stamp_ns) / self._period_ns), 0)
        return self._motions[-1 - back] if back < len(self._motions) else None
