"""Targets given from outside in GUIDED: a place, a velocity, a course or a turn rate."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.fcu.control.guidance import GuidanceGains, wrapped
from agent.fcu.control.station import Passage

POSITION, VELOCITY, COURSE, TURN = range(4)
_MOST_MPS = 100.0
_MOST_RADPS = 10.0


class GuidedTarget(NamedTuple):
    """What was asked for; the fields count for the kinds that have them.

    POSITION: a place. VELOCITY: over ground, with `heading_rad` when a heading was asked for too. COURSE: `heading_rad`
    and `speed_mps`. TURN: `turn_rate_radps` and `speed_mps`. Speeds are over ground, negative astern.
    """

    kind: int
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    north_mps: float = 0.0
    east_mps: float = 0.0
    heading_rad: float | None = None
    turn_rate_radps: float = 0.0
    speed_mps: float = 0.0


class Guided:
    """The target in force, None when there is none: then the vessel stays where it is."""

    def __init__(self) -> None:
        self.target: GuidedTarget | None = None
        self.passage: Passage | None = None  # the way to a place, or to where the vessel has to stop
        self.course = CourseOverGround()
        self._stamp_ns = 0

    def take(self, target: GuidedTarget, now_ns: int) -> None:
        """A new target takes the place of the old one; the same place again changes nothing."""
        if target == self.target and target.kind == POSITION:
            return
        self.passage = Passage(target.lat_deg, target.lon_deg) if target.kind == POSITION else None
        if target.kind != VELOCITY:
            self.course = CourseOverGround()
        self.target = target
        self._stamp_ns = now_ns

    def drop(self) -> None:
        """No target."""
        self.target = None
        self.passage = None
        self.course = CourseOverGround()

    def is_stale(self, now_ns: int, timeout_ns: int) -> bool:
        """Whether a target that has to be repeated was not."""
        target = self.target
        return target is not None and target.kind != POSITION and not 0 <= now_ns - self._stamp_ns <= timeout_ns


class CourseOverGround:
    """Finds the heading that makes good a course: line of sight along a line that moves with the target.

    The distance off the line is summed up from the velocity, so that a target repeated many times a second does not
    start it again; a new direction keeps what still counts.
    """

    def __init__(self) -> None:
        self._course_rad: float | None = None
        self._cross_m = 0.0
        self._integral_s = 0.0

    def heading_rad(
        self, gains: GuidanceGains, course_rad: float, vel_ne_mps: tuple[float, float], dt_s: float
    ) -> float:
        """The heading for a course, rad."""
        if self._course_rad is not None and course_rad != self._course_rad:
            kept = math.cos(course_rad - self._course_rad)
            self._cross_m *= kept
            self._integral_s *= kept
        self._course_rad = course_rad
        side_mps = vel_ne_mps[1] * math.cos(course_rad) - vel_ne_mps[0] * math.sin(course_rad)
        ahead_m, kappa_mps = gains.lookahead_m, gains.kappa_mps
        # What lies more than a look-ahead off is not made good any more.
        self._cross_m = min(max(self._cross_m + side_mps * dt_s, -ahead_m), ahead_m)
        aim_m = self._cross_m + kappa_mps * self._integral_s
        if kappa_mps > 0.0:
            limit_s = ahead_m / kappa_mps
            grown_s = self._integral_s + dt_s * ahead_m * self._cross_m / (ahead_m * ahead_m + aim_m * aim_m)
            self._integral_s = min(max(grown_s, -limit_s), limit_s)
        return wrapped(course_rad - math.atan(aim_m / ahead_m))


def place_problem(lat_deg: float, lon_deg: float) -> str:
    """Why a vessel cannot be sent to a place, or nothing."""
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        return f"position {lat_deg:g}, {lon_deg:g} is not on Earth; use degrees"
    return "position 0, 0 is not set" if lat_deg == 0.0 and lon_deg == 0.0 else ""


def velocity_target(
    north_mps: float, east_mps: float, yaw_rad: float | None, yaw_rate_radps: float | None
) -> GuidedTarget | str:
    """The target that a velocity with a heading or a turn rate asks for, or why it cannot be."""
    speed_mps = math.hypot(north_mps, east_mps)
    if not speed_mps <= _MOST_MPS:
        return f"velocity {north_mps:g}, {east_mps:g} m/s; use at most {_MOST_MPS:g}"
    if yaw_rad is not None:
        if not math.isfinite(yaw_rad):
            return f"heading {yaw_rad:g} is not one; use radians"
        along_mps = north_mps * math.cos(yaw_rad) + east_mps * math.sin(yaw_rad)
        return GuidedTarget(
            VELOCITY, north_mps=north_mps, east_mps=east_mps, heading_rad=wrapped(yaw_rad), speed_mps=along_mps
        )
    if yaw_rate_radps is not None:
        return turn_target(yaw_rate_radps, speed_mps)
    return GuidedTarget(VELOCITY, north_mps=north_mps, east_mps=east_mps, speed_mps=speed_mps)


def course_target(heading_rad: float, speed_mps: float) -> GuidedTarget | str:
    """A heading and a speed, or why not."""
    if not (math.isfinite(heading_rad) and abs(speed_mps) <= _MOST_MPS):
        return f"heading {heading_rad:g} rad, speed {speed_mps:g} m/s; use numbers, and at most {_MOST_MPS:g} m/s"
    return GuidedTarget(COURSE, heading_rad=wrapped(heading_rad), speed_mps=speed_mps)


def turn_target(turn_rate_radps: float, speed_mps: float) -> GuidedTarget | str:
    """A turn rate and a speed, or why not."""
    if not (abs(turn_rate_radps) <= _MOST_RADPS and abs(speed_mps) <= _MOST_MPS):
        return (
            f"turn rate {turn_rate_radps:g} rad/s, speed {speed_mps:g} m/s; use at most {_MOST_RADPS:g}, {_MOST_MPS:g}"
        )
    return GuidedTarget(TURN, turn_rate_radps=turn_rate_radps, speed_mps=speed_mps)
