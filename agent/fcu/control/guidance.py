"""Guidance (LC): from a leg and an estimate to a desired heading and speed over ground.

Integral line of sight (Børhaug, Pavlov and Pettersen 2008; Fossen 2021, eq 12.108). The integral finds the crab angle
that holds the leg in an unknown cross current or wind.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.fcu.parameters import Parameters
from agent.navigation.geodetic import LocalProjection

_GRAVITY_MPS2 = 9.80665
_CRAB_LIMIT = math.tan(math.radians(50.0))  # limit of the integral's part
_LEAST_SPEED_MPS = 0.3  # at lower speed, the integral would wind up at standstill
_BRAKING_LAG_S = 0.6  # delay between command and deceleration: propellers and speed loop
# Speed against the heading error: the leg's speed up to 20 degrees, WP_SPEED_MIN from 60 to 90, zero from 120. A vessel
# that cannot turn on the spot keeps WP_SPEED_MIN and turns in an arc.
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
        """Read the gains from the parameters."""
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
    """Input of the guidance."""

    gains: GuidanceGains
    frame: LocalProjection
    pos_ne_m: tuple[float, float]
    yaw_rad: float
    speed_mps: float
    """Measured, over ground."""
    wanted_mps: float
    """Desired speed, or the highest permitted speed."""
    dt_s: float

    @property
    def here(self) -> tuple[float, float]:
        """Latitude and longitude in degrees."""
        return self.frame.to_geodetic(*self.pos_ne_m)


class GuidanceLeg(NamedTuple):
    """A straight line from start to end, in metres north and east of the origin. `make_leg` computes it."""

    start_north_m: float
    start_east_m: float
    end_north_m: float
    end_east_m: float
    course_rad: float
    length_m: float
    turn_rad: float | None
    """Change of course at the end, in [-pi, pi]. None when no leg follows."""


class GuidanceState(NamedTuple):
    """Integral s of the cross-track error, as Fossen defines it."""

    integral_s: float = 0.0


class GuidanceOutput(NamedTuple):
    """Output of the guidance."""

    heading_rad: float
    speed_mps: float
    cross_track_m: float
    """Positive to the right of the leg."""
    distance_m: float
    bearing_rad: float
    reached: bool
    """Whether to continue with the next leg."""


def make_leg(start: tuple[float, float], end: tuple[float, float], after: tuple[float, float] | None) -> GuidanceLeg:
    """Return the leg between two (north, east) points in m.

    after: end of the next leg.

    A leg of zero length heads north.
    """
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
    """Run one step. speed_mps: measured speed over ground. desired_speed_mps: speed of the leg."""
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
    """Return the same motion, stern first."""
    return output._replace(heading_rad=wrap_angle(output.heading_rad + math.pi), speed_mps=-output.speed_mps)


def carry_integral(state: GuidanceState, turn_rad: float) -> GuidanceState:
    """Return the integral for the next leg: the same cross force, seen from a course changed by `turn_rad`."""
    return GuidanceState(state.integral_s * math.cos(turn_rad))


def wrap_angle(angle_rad: float) -> float:
    """Wrap an angle to [-pi, pi]."""
    return math.remainder(angle_rad, 2.0 * math.pi)


def _approach_speed_mps(gains: GuidanceGains, turn_rad: float | None, to_go_m: float, desired_mps: float) -> float:
    """Return a speed that leaves room to slow down before the end of the leg.

    A corner is a circular arc that touches both legs WP_RADIUS from it. Its radius is WP_RADIUS / tan(turn/2). The turn
    rate and the lateral acceleration limit the speed on it. The last waypoint is approached at WP_SPEED_MIN.
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
    """Return the speed with the bow `off_rad` from the desired heading."""
    slow_mps = min(gains.speed_min_mps, allowed_mps)
    if off_rad <= _FULL_RAD:
        return allowed_mps
    if off_rad <= _SLOW_RAD:
        return slow_mps + (allowed_mps - slow_mps) * (_SLOW_RAD - off_rad) / (_SLOW_RAD - _FULL_RAD)
    if not gains.pivots:
        return slow_mps
    return slow_mps * min(1.0, max(0.0, (_PIVOT_RAD - off_rad) / (_PIVOT_RAD - _TURNING_RAD)))


class StationKeeping:
    """Keeps within LOIT_RADIUS of a position, as ArduRover's boats do: drift near it, and drive back farther away.

    ArduRover starts to drive back at the radius, so it stays a little outside in a current. Here the vessel starts at
    half the radius. A vessel that cannot turn on the spot drifts at its present heading, and turns in an arc with way
    on.
    """

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg
        self._heading_rad: float | None = None

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        """Return heading and speed, negative astern, no faster than desired."""
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
    """A straight path to a position from the present one, then station keeping there.

    `arrived` is True at the station.
    """

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.station = StationKeeping(lat_deg, lon_deg)
        self.arrived = False
        self._frame: LocalProjection | None = None
        self._leg: GuidanceLeg | None = None
        self._guidance = GuidanceState()

    @property
    def under_way(self) -> bool:
        """Whether the transit has begun and not arrived yet."""
        return self._leg is not None and not self.arrived

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        """Return heading and speed."""
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
    """Path onto a circle around a position and along it, clockwise or counterclockwise."""

    def __init__(self, gains: GuidanceGains, lat_deg: float, lon_deg: float, radius_m: float, clockwise: bool) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg
        self.radius_m = max(radius_m, gains.turn_radius_m)
        """Radius, at least TURN_RADIUS."""
        self.speed_mps = min(
            math.sqrt(gains.lateral_acceleration_mps2 * self.radius_m), gains.turn_rate_radps * self.radius_m
        )
        """Limit of the speed, from the lateral acceleration and the turn rate."""
        self.turned_rad = 0.0
        """Angle travelled since the circle was reached."""
        self._sense = 1.0 if clockwise else -1.0
        self._integral_s = 0.0
        self._angle_rad: float | None = None  # of the vessel seen from the centre, on the circle

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        """Return heading and speed.

        Line of sight turns the tangent toward the circle, as `follow_leg` does for a line.
        """
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

    The distance off the line is integrated from the velocity. So a target that is repeated many times a second does not
    restart it. A new direction keeps the components that still apply.
    """

    def __init__(self) -> None:
        self._course_rad: float | None = None
        self._cross_m = 0.0
        self._integral_s = 0.0

    def heading_rad(
        self, gains: GuidanceGains, course_rad: float, vel_ne_mps: tuple[float, float], dt_s: float
    ) -> float:
        """Return the heading for a course, in rad."""
        if self._course_rad is not None and course_rad != self._course_rad:
            component = math.cos(course_rad - self._course_rad)
            self._cross_m *= component
            self._integral_s *= component
        self._course_rad = course_rad
        side_mps = vel_ne_mps[1] * math.cos(course_rad) - vel_ne_mps[0] * math.sin(course_rad)
        ahead_m, kappa_mps = gains.lookahead_m, gains.kappa_mps
        # A distance beyond the look-ahead is not made good.
        self._cross_m = min(max(self._cross_m + side_mps * dt_s, -ahead_m), ahead_m)
        aim_m = self._cross_m + kappa_mps * self._integral_s
        if kappa_mps > 0.0:
            limit_s = ahead_m / kappa_mps
            grown_s = self._integral_s + dt_s * ahead_m * self._cross_m / (ahead_m * ahead_m + aim_m * aim_m)
            self._integral_s = min(max(grown_s, -limit_s), limit_s)
        return wrap_angle(course_rad - math.atan(aim_m / ahead_m))
