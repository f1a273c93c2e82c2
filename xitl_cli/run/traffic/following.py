"""Where a follower ought to be, and how to get there and stay: pure functions of what the two say of themselves.

The place is counted along the leader's track: an offset of [-10, 0] is 10 m back along the way that the leader took, so
that a column goes through the same water and does not cut corners, as it would 10 m behind the leader's stern. What is
ahead of the leader is straight on along its course; what is beside it is square to the track. On a straight track all
of these are the leader's axes along its course over ground.

Velocities go to the autopilot, over ground, and not places: a place that moves all the time is one that a vessel brakes
for all the time. Along the track the speed is the leader's and a share of what is to be made up, across it a line of
sight ahead on the track (Fossen 2021, eq 12.78) with an integral, since ArduRover makes a heading of the velocity and
lets the current carry it off. Where the leader lies still the place is one to go to and to keep.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from xitl_cli.run.traffic.self_report import Point, SelfReport

STEP_M = 0.5  # between two points of the track
SMOOTHED_S = 1.5  # of the leader's speed: what waves do to it is not to be followed
UNDER_WAY_MPS, STOPPED_MPS = 0.5, 0.25
GAIN_PER_S = 0.25
INTEGRAL_PER_S = 0.02
LOOKAHEAD_M = 8.0
FASTEST = 1.5  # of the mission's speed: to make up for what was lost
SLOWEST = 0.3  # of the leader's speed: with less way on there is no steering
MOVED_M = 1.5  # a place to keep that has moved by so much is another


class FormationPlace(NamedTuple):
    """A place and the unit vector along which it moves, north and east, at speed_mps."""

    pos_ne_m: Point
    along_ne: Point
    speed_mps: float


class LeaderTrack:
    """The way that a leader has taken, as long as it is needed for an offset (forward, starboard)."""

    def __init__(self, offset_frd_m: tuple[float, float]) -> None:
        self._forward_m, self._starboard_m = offset_frd_m
        self._points: deque[Point] = deque()
        self._along: Point | None = None
        self._speed_mps = 0.0
        self._report: SelfReport | None = None
        self.moving = False

    def add(self, report: SelfReport) -> None:
        """The newest of the leader; one that was heard already changes nothing."""
        before, self._report = self._report, report
        if before is not None and report.at_ns <= before.at_ns:
            return
        heading: Point = math.cos(report.yaw_rad), math.sin(report.yaw_rad)
        if before is None or self._along is None:
            north, east = report.pos_ne_m
            back_m = max(-self._forward_m, 0.0) + STEP_M
            # It is taken to have come the way it heads.
            self._points.extend(((north - back_m * heading[0], east - back_m * heading[1]), report.pos_ne_m))
            self._along, dt_s = heading, 0.0
        else:
            dt_s = (report.at_ns - before.at_ns) * 1e-9
        if math.dist(self._points[-1], report.pos_ne_m) >= STEP_M:
            self._points.append(report.pos_ne_m)
        self._forget()
        speed_mps = math.hypot(*report.vel_ne_mps)
        self._speed_mps += (speed_mps - self._speed_mps) * (1.0 - math.exp(-dt_s / SMOOTHED_S))
        self.moving = self._speed_mps > (STOPPED_MPS if self.moving else UNDER_WAY_MPS)
        if self.moving and speed_mps > STOPPED_MPS:
            smoothed = 1.0 - math.exp(-dt_s / SMOOTHED_S)
            along = [
                one + (rate / speed_mps - one) * smoothed
                for one, rate in zip(self._along, report.vel_ne_mps, strict=True)
            ]
            length = math.hypot(*along)
            self._along = (along[0] / length, along[1] / length) if length > 1e-6 else heading

    def place(self, now_ns: int) -> FormationPlace | None:
        """Where the follower ought to be now, the leader going on as it last said; None until it has said anything."""
        report = self._report
        if report is None or self._along is None:
            return None
        age_s = min(max((now_ns - report.at_ns) * 1e-9, 0.0), 1.0)
        leader = _moved(report.pos_ne_m, report.vel_ne_mps, age_s if self.moving else 0.0)
        if self._forward_m >= 0.0:
            along, pos = self._along, _moved(leader, self._along, self._forward_m)
        else:
            pos, along = self._back(leader, -self._forward_m)
        right: Point = -along[1], along[0]
        return FormationPlace(_moved(pos, right, self._starboard_m), along, self._speed_mps if self.moving else 0.0)

    def _back(self, leader: Point, way_m: float) -> tuple[Point, Point]:
        """Back along the track from the leader, and the direction there."""
        start = leader
        for end in reversed(self._points):
            length = math.dist(start, end)
            if length < 1e-6:
                continue
            along: Point = (start[0] - end[0]) / length, (start[1] - end[1]) / length
            if length >= way_m:
                return _moved(start, along, -way_m), along
            way_m -= length
            start = end
        assert self._along is not None
        return _moved(start, self._along, -way_m), self._along

    def _forget(self) -> None:
        """What lies farther back than the place."""
        needed_m, passed_m = max(-self._forward_m, 0.0) + 2.0 * STEP_M, 0.0
        newest = self._points[-1]
        for number, point in enumerate(reversed(self._points)):
            passed_m += math.dist(newest, point)
            newest = point
            if passed_m > needed_m:
                for _ in range(len(self._points) - 1 - number):
                    self._points.popleft()
                return


class FollowLaw:
    """What to ask of a follower that may be FASTEST times as fast as its mission's `speed_mps`."""

    def __init__(self, speed_mps: float) -> None:
        self._most_mps = FASTEST * speed_mps
        self._integral_mps = 0.0
        self._at_ns: int | None = None

    def velocity_ne_mps(self, place: FormationPlace, own: SelfReport, now_ns: int) -> Point:
        """Over ground, for a place that moves."""
        dt_s = 0.0 if self._at_ns is None else min((now_ns - self._at_ns) * 1e-9, 1.0)
        self._at_ns = now_ns
        age_s = min(max((now_ns - own.at_ns) * 1e-9, 0.0), 1.0)
        here = _moved(own.pos_ne_m, own.vel_ne_mps, age_s)
        ahead, right = place.along_ne, (-place.along_ne[1], place.along_ne[0])
        off = place.pos_ne_m[0] - here[0], place.pos_ne_m[1] - here[1]
        behind_m = off[0] * ahead[0] + off[1] * ahead[1]
        left_m = off[0] * right[0] + off[1] * right[1]
        least_mps = SLOWEST * place.speed_mps
        along_mps = min(max(place.speed_mps + GAIN_PER_S * behind_m, least_mps), self._most_mps)
        limit_mps = 0.4 * place.speed_mps
        if abs(left_m) < LOOKAHEAD_M:  # farther off it is a way to go, and nothing that carries it off
            grown_mps = self._integral_mps + INTEGRAL_PER_S * left_m * dt_s
            self._integral_mps = min(max(grown_mps, -limit_mps), limit_mps)
        across_mps = along_mps * left_m / LOOKAHEAD_M + self._integral_mps
        speed_mps = math.hypot(along_mps, across_mps)
        share = min(1.0, self._most_mps / speed_mps) if speed_mps > 0.0 else 0.0
        along_mps, across_mps = share * along_mps, share * across_mps
        return along_mps * ahead[0] + across_mps * right[0], along_mps * ahead[1] + across_mps * right[1]

    def rest(self) -> None:
        """The place stands still for now."""
        self._integral_mps = 0.0
        self._at_ns = None


def _moved(place: Point, direction: Point, by: float) -> Point:
    return place[0] + by * direction[0], place[1] + by * direction[1]
