"""Guidance (LC): from a leg and an estimate to a desired heading and speed over ground.

Integral line of sight (Børhaug, Pavlov and Pettersen 2008; Fossen 2021, eq 12.108): the integral finds the crab angle
that holds the leg in a cross current or wind without being told of either.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.fcu.geodetic import LocalProjection
from agent.fcu.parameters import Parameters

_GRAVITY_MPS2 = 9.80665
_CRAB_LIMIT = math.tan(math.radians(50.0))  # no more than this from the integral
_LEAST_SPEED_MPS = 0.3  # slower, and the integral would learn from standing still
_BRAKING_LAG_S = 0.6  # from the wish to slow down to slowing down: propellers and speed loop
# Speed against how far the bow is off: the leg's up to 20 degrees, WP_SPEED_MIN from 60 to 90, none from 120; a vessel
# that cannot turn on the spot keeps WP_SPEED_MIN on and goes round.
_FULL_RAD, _SLOW_RAD = math.radians(20.0), math.radians(60.0)
_TURNING_RAD, _PIVOT_RAD = math.radians(90.0), math.radians(120.0)
BOW_OR_STERN, BOW, STERN = 0, 1, 2  # LOIT_TYPE


class GuidanceGains(NamedTuple):
    """Parameters of the guidance, in SI units. pivots: whether the vessel can turn without way on."""

    lookahead_m: float
    kappa_mps: float
    radius_m: float
    speed_min_mps: float
    deceleration_mps2: float
    lateral_acceleration_mps2: float
    turn_rate_radps: float
    turn_radius_m: float
    loiter_radius_m: float
    loiter_per_s: float
    loiter_type: int
    pivots: bool = True

    @classmethod
    def from_parameters(cls, p: Parameters, pivots: bool = True) -> GuidanceGains:
        """From the table."""
        return cls(
            lookahead_m=p["LOS_LOOKAHEAD"],
            kappa_mps=p["LOS_KAPPA"],
            radius_m=p["WP_RADIUS"],
            speed_min_mps=p["WP_SPEED_MIN"],
            deceleration_mps2=p["ATC_DECEL_MAX"],
            lateral_acceleration_mps2=p["ATC_TURN_MAX_G"] * _GRAVITY_MPS2,
            turn_rate_radps=math.radians(p["ATC_STR_RAT_MAX"]),
            turn_radius_m=p["TURN_RADIUS"],
            loiter_radius_m=p["LOIT_RADIUS"],
            loiter_per_s=p["LOIT_SPEED_GAIN"],
            loiter_type=int(p["LOIT_TYPE"]),
            pivots=pivots,
        )


class GuidanceInput(NamedTuple):
    """What is steered by. `speed_mps` is over ground; `wanted_mps` what is asked for, or may be used at most."""

    gains: GuidanceGains
    frame: LocalProjection
    pos_ne_m: tuple[float, float]
    yaw_rad: float
    speed_mps: float
    wanted_mps: float
    dt_s: float

    @property
    def here(self) -> tuple[float, float]:
        """Latitude and longitude."""
        return self.frame.to_geodetic(*self.pos_ne_m)


class GuidanceLeg(NamedTuple):
    """A straight line from start to end, metres north and east of the origin; precomputed by `leg`.

    `turn_rad` is the change of course at the end, in [-pi, pi], None when there is nothing after it.
    """

    start_north_m: float
    start_east_m: float
    end_north_m: float
    end_east_m: float
    course_rad: float
    length_m: float
    turn_rad: float | None


class GuidanceState(NamedTuple):
    """The integral of the cross-track error as Fossen defines it, s."""

    integral_s: float = 0.0


class GuidanceOutput(NamedTuple):
    """Cross-track is positive to the right of the leg; `reached` asks for the next leg."""

    heading_rad: float
    speed_mps: float
    cross_track_m: float
    distance_m: float
    bearing_rad: float
    reached: bool


def make_leg(start: tuple[float, float], end: tuple[float, float], after: tuple[float, float] | None) -> GuidanceLeg:
    """The leg between two (north, east) points; `after` is where the next leg goes. A leg of no length heads north."""
    north_m, east_m = end[0] - start[0], end[1] - start[1]
    course_rad = math.atan2(east_m, north_m)
    turn_rad: float | None = None
    if after is not None:
        turn_rad = 0.0
        if after != end:
            turn_rad = wrap_angle(math.atan2(after[1] - end[1], after[0] - end[0]) - course_rad)
    return GuidanceLeg(start[0], start[1], end[0], end[1], course_rad, math.hypot(north_m, east_m), turn_rad)


def follow_leg(
    gains: GuidanceGains,
    state: GuidanceState,
    line: GuidanceLeg,
    pos_ne_m: tuple[float, float],
    yaw_rad: float,
    speed_mps: float,
    desired_speed_mps: float,
    dt_s: float,
) -> tuple[GuidanceState, GuidanceOutput]:
    """One step: `speed_mps` is the measured speed over ground, `desired_speed_mps` that of the leg."""
    cos_course, sin_course = math.cos(line.course_rad), math.sin(line.course_rad)
    north_m, east_m = pos_ne_m[0] - line.start_north_m, pos_ne_m[1] - line.start_east_m
    along_m = north_m * cos_course + east_m * sin_course
    cross_m = east_m * cos_course - north_m * sin_course
    to_go_m = line.length_m - along_m
    distance_m = math.hypot(to_go_m, cross_m)
    bearing_rad = math.atan2(line.end_east_m - pos_ne_m[1], line.end_north_m - pos_ne_m[0])

    lookahead_m, kappa_mps = gains.lookahead_m, gains.kappa_mps
    aim_m = cross_m + kappa_mps * state.integral_s
    heading_rad = line.course_rad - math.atan(aim_m / lookahead_m)
    integral_s = state.integral_s
    if kappa_mps > 0.0 and speed_mps > _LEAST_SPEED_MPS:
        integral_s += dt_s * lookahead_m * cross_m / (lookahead_m * lookahead_m + aim_m * aim_m)
        limit_s = _CRAB_LIMIT * lookahead_m / kappa_mps
        integral_s = min(max(integral_s, -limit_s), limit_s)

    allowed_mps = min(desired_speed_mps, _approach_speed_mps(gains, line.turn_rad, to_go_m, desired_speed_mps))
    allowed_mps = _turning_speed_mps(gains, abs(wrap_angle(heading_rad - yaw_rad)), allowed_mps)
    reached = distance_m <= gains.radius_m or to_go_m <= 0.0
    output = GuidanceOutput(wrap_angle(heading_rad), allowed_mps, cross_m, distance_m, bearing_rad, reached)
    return GuidanceState(integral_s), output


def turned_about(output: GuidanceOutput) -> GuidanceOutput:
    """The same way, stern first."""
    return output._replace(heading_rad=wrap_angle(output.heading_rad + math.pi), speed_mps=-output.speed_mps)


def carry_integral(state: GuidanceState, turn_rad: float) -> GuidanceState:
    """The integral for the next leg: the same crosswise push, seen from a course `turn_rad` further on."""
    return GuidanceState(state.integral_s * math.cos(turn_rad))


def wrap_angle(angle_rad: float) -> float:
    """The same angle in [-pi, pi]."""
    return math.remainder(angle_rad, 2.0 * math.pi)


def _approach_speed_mps(gains: GuidanceGains, turn_rad: float | None, to_go_m: float, desired_mps: float) -> float:
    """Speed that leaves room to slow down for what comes at the end of the leg.

    A corner is a circular arc that touches both legs WP_RADIUS from it: radius WP_RADIUS / tan(turn/2), taken within
    the turn rate and the lateral acceleration allowed. The last waypoint is approached at WP_SPEED_MIN.
    """
    corner_mps = gains.speed_min_mps
    if turn_rad is not None:
        tangent = math.tan(0.5 * min(abs(turn_rad), math.radians(179.0)))
        if tangent * desired_mps <= 1e-6 * gains.radius_m:
            return desired_mps
        arc_m = gains.radius_m / tangent
        within_mps = min(gains.turn_rate_radps * arc_m, math.sqrt(gains.lateral_acceleration_mps2 * arc_m))
        corner_mps = max(corner_mps, within_mps)
    room_m = max(0.0, to_go_m - gains.radius_m - _BRAKING_LAG_S * desired_mps)
    return math.sqrt(corner_mps * corner_mps + 2.0 * gains.deceleration_mps2 * room_m)


def _turning_speed_mps(gains: GuidanceGains, off_rad: float, allowed_mps: float) -> float:
    """Speed with the bow `off_rad` from the desired heading."""
    slow_mps = min(gains.speed_min_mps, allowed_mps)
    if off_rad <= _FULL_RAD:
        return allowed_mps
    if off_rad <= _SLOW_RAD:
        return slow_mps + (allowed_mps - slow_mps) * (_SLOW_RAD - off_rad) / (_SLOW_RAD - _FULL_RAD)
    if not gains.pivots:
        return slow_mps
    return slow_mps * min(1.0, max(0.0, (_PIVOT_RAD - off_rad) / (_PIVOT_RAD - _TURNING_RAD)))


class StationKeeping:
    """Keeps within LOIT_RADIUS of a place, as ArduRover's boats do: drift near it, beyond that drive back.

    ArduRover starts back at the radius and so stays a little outside of it in a current; here it is at half the radius.
    A vessel that cannot turn on the spot drifts as it lies, and goes round with way on.
    """

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg
        self._heading_rad: float | None = None

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        """Heading and speed, negative astern, no faster than wanted."""
        gains, frame, pos_ne_m, yaw_rad, _, most_mps, _ = now
        north_m, east_m = frame.to_local(self.lat_deg, self.lon_deg)
        north_m, east_m = north_m - pos_ne_m[0], east_m - pos_ne_m[1]
        distance_m = math.hypot(north_m, east_m)
        bearing_rad = math.atan2(east_m, north_m)
        heading_rad = yaw_rad if self._heading_rad is None or not gains.pivots else self._heading_rad
        speed_mps = 0.0
        adrift_m = distance_m - 0.5 * gains.loiter_radius_m
        if adrift_m > 0.0:
            heading_rad = bearing_rad
            speed_mps = min(gains.loiter_per_s * adrift_m, most_mps)
            behind = abs(wrap_angle(bearing_rad - yaw_rad)) > 0.5 * math.pi
            if gains.loiter_type == STERN or (gains.loiter_type == BOW_OR_STERN and behind):
                heading_rad, speed_mps = wrap_angle(bearing_rad + math.pi), -speed_mps
            off = min(abs(wrap_angle(heading_rad - yaw_rad)) / (0.5 * math.pi), 1.0)
            speed_mps *= 1.0 - 0.5 * off
            if not gains.pivots:
                steerage_mps = off * min(gains.speed_min_mps, most_mps)
                speed_mps = math.copysign(max(abs(speed_mps), steerage_mps), speed_mps)
        self._heading_rad = heading_rad
        return GuidanceOutput(heading_rad, speed_mps, 0.0, distance_m, bearing_rad, False)


class PointTransit:
    """A straight way to a place from wherever the vessel is, then station keeping there. `arrived` says which."""

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.station = StationKeeping(lat_deg, lon_deg)
        self.arrived = False
        self._frame: LocalProjection | None = None
        self._leg: GuidanceLeg | None = None
        self._guidance = GuidanceState()

    @property
    def under_way(self) -> bool:
        """Whether it was steered along and is not there yet."""
        return self._leg is not None and not self.arrived

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        """Heading and speed."""
        if self.arrived:
            return self.station.steer(now)
        gains, frame, pos_ne_m, yaw_rad, speed_mps, desired_mps, dt_s = now
        if self._leg is None or frame is not self._frame:
            self._frame = frame
            self._leg = make_leg(pos_ne_m, frame.to_local(self.station.lat_deg, self.station.lon_deg), None)
        self._guidance, output = follow_leg(
            gains, self._guidance, self._leg, pos_ne_m, yaw_rad, speed_mps, desired_mps, dt_s
        )
        self.arrived = output.reached
        return output


class CircleTransit:
    """Onto a circle around a place and around it, clockwise or not.

    radius_m: no less than TURN_RADIUS. speed_mps: what the lateral acceleration and the turn rate allow there.
    turned_rad: how far around since it was reached.
    """

    def __init__(self, gains: GuidanceGains, lat_deg: float, lon_deg: float, radius_m: float, clockwise: bool) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg
        self.radius_m = max(radius_m, gains.turn_radius_m)
        self.speed_mps = min(
            math.sqrt(gains.lateral_acceleration_mps2 * self.radius_m), gains.turn_rate_radps * self.radius_m
        )
        self.turned_rad = 0.0
        self._sense = 1.0 if clockwise else -1.0
        self._integral_s = 0.0
        self._angle_rad: float | None = None  # of the vessel seen from the centre, once it is on the circle

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        """Heading and speed: the tangent, turned toward the circle by line of sight as `follow_leg` does to a line."""
        gains, frame, pos_ne_m, yaw_rad, speed_mps, desired_mps, dt_s = now
        north_m, east_m = frame.to_local(self.lat_deg, self.lon_deg)
        north_m, east_m = pos_ne_m[0] - north_m, pos_ne_m[1] - east_m
        distance_m = math.hypot(north_m, east_m)
        angle_rad = math.atan2(east_m, north_m) if distance_m > 0.0 else yaw_rad
        outside_m = distance_m - self.radius_m
        lookahead_m, kappa_mps = min(gains.lookahead_m, self.radius_m), gains.kappa_mps
        aim_m = outside_m + kappa_mps * self._integral_s
        if self._angle_rad is not None:
            self.turned_rad += self._sense * wrap_angle(angle_rad - self._angle_rad)
            self._angle_rad = angle_rad
            if kappa_mps > 0.0 and speed_mps > _LEAST_SPEED_MPS:
                grown_s = dt_s * lookahead_m * outside_m / (lookahead_m * lookahead_m + aim_m * aim_m)
                limit_s = _CRAB_LIMIT * lookahead_m / kappa_mps
                self._integral_s = min(max(self._integral_s + grown_s, -limit_s), limit_s)
        elif abs(outside_m) <= gains.radius_m:
            self._angle_rad = angle_rad
        heading_rad = wrap_angle(angle_rad + self._sense * (0.5 * math.pi + math.atan(aim_m / lookahead_m)))
        allowed_mps = _turning_speed_mps(
            gains, abs(wrap_angle(heading_rad - yaw_rad)), min(desired_mps, self.speed_mps)
        )
        bearing_rad = wrap_angle(angle_rad + math.pi)
        return GuidanceOutput(heading_rad, allowed_mps, -self._sense * outside_m, abs(outside_m), bearing_rad, False)


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
        return wrap_angle(course_rad - math.atan(aim_m / ahead_m))
