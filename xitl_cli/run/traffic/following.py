"""A follower's place and the velocity to reach and keep it: pure functions of both vessels' reports.

The place is measured along the leader's track. An offset of [-10, 0] is 10 m back along the leader's way. A column
therefore goes through the same water and does not cut corners, as it would 10 m behind the leader's stern. Ahead of the
leader the track is straight along its course. Offsets to the side are square to the track. On a straight track these
axes are the leader's axes along its course over ground.

The autopilot gets velocities and not places, because a vessel would always brake for a moving place. The velocity
points to the intersection of the track with a circle around the vessel (pure pursuit, Coulter 1992). An integral of the
cross-track distance corrects it. ArduRover gets its heading with the velocity. An autopilot with its own track control
would oscillate against this law. The speed is the leader's, extrapolated by its acceleration as in cooperative cruise
control (Ploeg et al. 2011), plus a share of the distance to make up. In a corner it is at most half as much again as
the leader's speed there. If the leader stops, the vessel goes to the place and keeps it.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from typing import NamedTuple

from xitl_cli.run.traffic.self_report import Point, SelfReport

STEP_M = 0.5  # between two points of the track
KEPT_M = 100.0  # of the track, behind the place
SMOOTHED_S, COURSE_SMOOTHED_S = (
    0.5,
    1.5,
)  # time constants for the leader's speed and course, which filter out waves
UNDER_WAY_MPS, STOPPED_MPS = 0.5, 0.25  # limits of the speed ahead
SILENT_S = 1.5  # a leader that was silent for this time may have stopped
LEAD_S = 1.5  # extrapolation of the leader's speed: the response time of a follower
GAIN_PER_S = 0.25
INTEGRAL_PER_S = 0.02
LOOKAHEAD_M = 7.0
BRAKING_M = 4.5  # before a corner
FASTEST = 1.5  # of the mission's speed: to make up distance
SLOWEST = 0.3  # of the leader's speed: below it the vessel cannot steer
STRAIGHT = math.cos(math.radians(20.0))  # between the halves of the look-ahead; a larger bend is a corner
SLOWED = 0.75  # of the leader's speed now: a slower speed on the track counts as a corner
ABOVE_LEADER, LEAST_LIMIT_MPS = 1.5, 1.5  # factor on the leader's speed there
MOVED_M = 1.5  # a place to keep that moved this far is a new place


class TrackPoint(NamedTuple):
    """Position and speed of the leader, and its distance along the track."""

    pos_ne_m: Point
    speed_mps: float
    along_m: float


class FormationPlace(NamedTuple):
    """A follower's place, its distance along the track, its speed and its acceleration."""

    pos_ne_m: Point
    along_m: float
    speed_mps: float
    acceleration_mps2: float = 0.0


class TrackPursuit(NamedTuple):
    """Position of a vessel relative to the track with its offset to starboard."""

    along_m: float
    """Distance along the track."""
    left_m: float
    """Distance to the left of the track."""
    aim_ne_m: Point
    """Point of the track LOOKAHEAD_M ahead."""
    leader_mps: float
    """Lowest speed of the leader in a corner ahead; infinite elsewhere."""


class LeaderTrack:
    """The leader's track, as far back as an offset (forward, starboard) needs it."""

    def __init__(self, offset_frd_m: tuple[float, float]) -> None:
        self._forward_m, self._starboard_m = offset_frd_m
        self._points: deque[TrackPoint] = deque()
        self._course: Point = (1.0, 0.0)
        self._speed_mps = self._slower_mps = 0.0  # ahead; the second is filtered over twice the time
        self._report: SelfReport | None = None
        self._was_armed = False
        self.moving = False

    def add(self, report: SelfReport) -> None:
        """Add the leader's newest report; a known report changes nothing.

        Before it is first armed, the leader drifts and has no track. The track is then a straight line along its
        heading. Later, while it makes no way ahead, the track moves along with a leader that drifts or goes astern: its
        followers make way.
        """
        before, self._report = self._report, report
        if before is not None and report.at_ns <= before.at_ns:
            return
        heading: Point = math.cos(report.yaw_rad), math.sin(report.yaw_rad)
        if before is None or not self._was_armed:
            self._was_armed = report.armed
            back_m = max(-self._forward_m, 0.0) + KEPT_M
            self._points = deque(
                (TrackPoint(_moved(report.pos_ne_m, heading, -back_m), math.inf, 0.0),
                 TrackPoint(report.pos_ne_m, math.inf, back_m))
            )  # fmt: skip
            self._course = heading
            return
        rate = report.vel_ne_mps
        speed_mps = math.hypot(*rate)
        ahead_mps = rate[0] * heading[0] + rate[1] * heading[1]
        dt_s = (report.at_ns - before.at_ns) * 1e-9
        self._speed_mps += (ahead_mps - self._speed_mps) * -math.expm1(-dt_s / SMOOTHED_S)
        self._slower_mps += (ahead_mps - self._slower_mps) * -math.expm1(-0.5 * dt_s / SMOOTHED_S)
        self.moving = self._speed_mps > (STOPPED_MPS if self.moving else UNDER_WAY_MPS)
        last = self._points[-1]
        step_m = math.dist(last.pos_ne_m, report.pos_ne_m)
        if step_m >= STEP_M and self.moving:
            self._points.append(TrackPoint(report.pos_ne_m, speed_mps, last.along_m + step_m))
            # Drop the track that lies farther back than the place and a follower that has fallen behind.
            needed_m = self._points[-1].along_m - max(-self._forward_m, 0.0) - KEPT_M
            while len(self._points) > 2 and self._points[1].along_m <= needed_m:
                self._points.popleft()
        elif step_m >= STEP_M:
            north_m, east_m = report.pos_ne_m[0] - last.pos_ne_m[0], report.pos_ne_m[1] - last.pos_ne_m[1]
            self._points = deque(
                point._replace(pos_ne_m=(point.pos_ne_m[0] + north_m, point.pos_ne_m[1] + east_m))
                for point in self._points
            )
        if self.moving and speed_mps > STOPPED_MPS:
            smoothed = -math.expm1(-dt_s / COURSE_SMOOTHED_S)
            course = [old + (way / speed_mps - old) * smoothed for old, way in zip(self._course, rate, strict=True)]
            length = math.hypot(*course)
            self._course = (course[0] / length, course[1] / length) if length > 1e-6 else self._course

    def place(self, now_ns: int) -> FormationPlace | None:
        """Return the follower's place now, with the leader extrapolated from its last report; None without a report.

        A leader that was silent for SILENT_S is assumed to be at its last position.
        """
        report = self._report
        if report is None:
            return None
        moves = self.moving and (now_ns - report.at_ns) * 1e-9 < SILENT_S
        last = self._points[-1]
        leader_along_m = last.along_m
        if moves:
            place = report.carried_on(now_ns).pos_ne_m
            off = place[0] - last.pos_ne_m[0], place[1] - last.pos_ne_m[1]
            leader_along_m += max(off[0] * self._course[0] + off[1] * self._course[1], 0.0)
        along_m = leader_along_m + self._forward_m
        pos, _ = self._at(along_m)
        if not moves:
            return FormationPlace(pos, along_m, 0.0)
        # During a steady change the two filters lag by their times, so they differ by the change in one time constant.
        return FormationPlace(pos, along_m, self._speed_mps, (self._speed_mps - self._slower_mps) / SMOOTHED_S)

    def pursuit(self, pos_ne_m: Point) -> TrackPursuit:
        """Return a vessel's position relative to the track. A report is required."""
        nearest_m2, along_m, left_m = math.inf, 0.0, 0.0
        end = self._points[-1]
        ahead = TrackPoint(_moved(end.pos_ne_m, self._course, KEPT_M), math.inf, end.along_m + KEPT_M)
        points = [*self._points, ahead]
        for point, following in pairwise(points):
            length = following.along_m - point.along_m
            way = _unit(point.pos_ne_m, following.pos_ne_m, length)
            start = _moved(point.pos_ne_m, (-way[1], way[0]), self._starboard_m)
            off = pos_ne_m[0] - start[0], pos_ne_m[1] - start[1]
            gone_m = min(max(off[0] * way[0] + off[1] * way[1], 0.0), length)
            beside = off[0] - gone_m * way[0], off[1] - gone_m * way[1]
            square = beside[0] * beside[0] + beside[1] * beside[1]
            if square <= nearest_m2:  # of equally near places, the one farther on
                nearest_m2, along_m = square, point.along_m + gone_m
                left_m = way[1] * beside[0] - way[0] * beside[1]
        here, middle, aim = (self._at(along_m + share * LOOKAHEAD_M)[0] for share in (0.0, 0.5, 1.0))
        way, further = _unit(here, middle, math.dist(here, middle)), _unit(middle, aim, math.dist(middle, aim))
        slowest_mps = math.inf
        if way[0] * further[0] + way[1] * further[1] < STRAIGHT:
            first_m, last_m = along_m - STEP_M, along_m + BRAKING_M
            speeds_mps = [point.speed_mps for point in points if first_m <= point.along_m <= last_m]
            slowest_mps = min(speeds_mps, default=math.inf)
        return TrackPursuit(along_m, left_m, aim, slowest_mps)

    def _at(self, along_m: float) -> tuple[Point, Point]:
        """Return the place of the track with its offset to starboard, and the direction there."""
        last = self._points[-1]
        pos, way = _moved(last.pos_ne_m, self._course, along_m - last.along_m), self._course
        if along_m < last.along_m:
            newer = last
            for point in reversed(self._points):
                if point.along_m <= along_m or point is self._points[0]:
                    way = _unit(point.pos_ne_m, newer.pos_ne_m, newer.along_m - point.along_m)
                    pos = _moved(point.pos_ne_m, way, along_m - point.along_m)
                    if newer is not point:
                        break
                newer = point
        return _moved(pos, (-way[1], way[0]), self._starboard_m), way


class FollowLaw:
    """Velocity for a follower that may reach FASTEST times its mission's `speed_mps`."""

    def __init__(self, speed_mps: float) -> None:
        self._most_mps = FASTEST * speed_mps
        self._integral_mps = 0.0
        self._at_ns: int | None = None

    def velocity_ne_mps(self, place: FormationPlace, pursuit: TrackPursuit, own: SelfReport) -> Point:
        """Return the velocity over ground for a moving place. own: the follower's state now."""
        dt_s = 0.0 if self._at_ns is None else min((own.at_ns - self._at_ns) * 1e-9, 1.0)
        self._at_ns = own.at_ns
        behind_m = place.along_m - pursuit.along_m
        most_mps = self._most_mps
        if pursuit.leader_mps < SLOWED * place.speed_mps:
            most_mps = min(most_mps, max(ABOVE_LEADER * pursuit.leader_mps, LEAST_LIMIT_MPS))
        least_mps = SLOWEST * place.speed_mps
        wanted_mps = place.speed_mps + LEAD_S * max(place.acceleration_mps2, 0.0) + GAIN_PER_S * behind_m
        speed_mps = min(max(wanted_mps, least_mps), max(most_mps, least_mps))
        aim = pursuit.aim_ne_m
        way = _unit(own.pos_ne_m, aim, math.dist(own.pos_ne_m, aim))
        limit_mps = 0.4 * speed_mps
        if abs(pursuit.left_m) < LOOKAHEAD_M:  # a larger distance is a way to go and not a drift
            self._integral_mps += INTEGRAL_PER_S * pursuit.left_m * dt_s
        self._integral_mps = min(max(self._integral_mps, -limit_mps), limit_mps)
        # A distance to the left is corrected to the right.
        right_mps = self._integral_mps
        ahead_mps = math.sqrt(speed_mps * speed_mps - right_mps * right_mps)
        return ahead_mps * way[0] - right_mps * way[1], ahead_mps * way[1] + right_mps * way[0]

    def rest(self) -> None:
        """Reset the law while the place does not move."""
        self._integral_mps = 0.0
        self._at_ns = None


def _moved(place: Point, direction: Point, by: float) -> Point:
    return place[0] + by * direction[0], place[1] + by * direction[1]


def _unit(start: Point, end: Point, length: float) -> Point:
    if length < 1e-9:
        return 1.0, 0.0
    return (end[0] - start[0]) / length, (end[1] - start[1]) / length
