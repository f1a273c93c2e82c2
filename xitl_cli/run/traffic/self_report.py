"""What a vessel says of itself: its autopilot's estimate, or the script of one without an autopilot."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

Point = tuple[float, float]


class SelfReport(NamedTuple):
    """At simulation time at_ns, in the local frame; yaw rate positive to starboard.

    accurate: its place is good to 10 m, by what it knows itself. armed: it may move by itself.
    """

    at_ns: int
    pos_ne_m: Point
    vel_ne_mps: Point
    yaw_rad: float
    yaw_rate_radps: float = 0.0
    accurate: bool = True
    armed: bool = True


ReportSource = Callable[[], SelfReport | None]
"""The newest of a vessel, None until there is one."""
