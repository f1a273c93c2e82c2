"""Distance and speed of a vessel of a fleet, by the truth, and its state at the end."""

from __future__ import annotations

import math
from typing import Any

from xitl_cli.run.core.node import ControlNode, RunNode, RunStep


class TrackNode(RunNode):
    """Adds up the distance over ground at each exchange, while the vessel is not held."""

    def __init__(self, control: ControlNode) -> None:
        self._control = control
        self._place: tuple[float, float] | None = None
        self._path_m = 0.0
        self._speed_mps = self._most_mps = 0.0
        self._heading_deg = 0.0
        self._first_ns = self._now_ns = 0

    def exchange(self, step: RunStep) -> None:
        motion = step.motion
        north_m, east_m, _ = motion.pos_ned_m[0].tolist()
        north_mps, east_mps, _ = motion.vel_ned_mps[0].tolist()
        rotation = motion.rot_ned_frd[0]
        if self._place is None or step.held:
            self._first_ns = step.now_ns
        else:
            self._path_m += math.dist(self._place, (north_m, east_m))
        self._place, self._now_ns = (north_m, east_m), step.now_ns
        self._speed_mps = math.hypot(north_mps, east_mps)
        self._most_mps = max(self._most_mps, self._speed_mps)
        self._heading_deg = math.degrees(math.atan2(rotation[1, 0], rotation[0, 0])) % 360.0

    def report(self) -> dict[str, Any]:
        """Return `track`: mode, place, heading and speed at the end; path and speeds over ground of the whole run."""
        progress, length_s = self._control.progress, (self._now_ns - self._first_ns) * 1e-9
        north_m, east_m = self._place or (None, None)
        return {
            "track": {
                "mode": progress.mode,
                "armed": progress.armed,
                "north_m": north_m,
                "east_m": east_m,
                "heading_deg": self._heading_deg,
                "speed_mps": self._speed_mps,
                "path_m": self._path_m,
                "speed_mean_mps": self._path_m / length_s if length_s > 0.0 else None,
                "speed_max_mps": self._most_mps,
            }
        }
