"""Collision check and avoidance course.

Candidate courses, speeds and holding times are simulated ahead among moving and static obstacles. The method is the
dynamic window approach (Fox, Burgard and Thrun 1997), here over ground. The obstacles' own velocities are included, as
in velocity obstacles (Fiorini and Shiller 1998). A candidate holds a course for a while and then follows the mission.
It is judged as a whole, so that a detour is no longer than necessary.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.companion.settings import TUNED
from agent.companion.tracking import ObstacleTrack

Array = NDArray[np.float64]

STEP_S = 0.4
_POINTS_AT_ONCE = 8
_TURN_RADPS = math.radians(TUNED.course_turn_degps)


class PathLegs:
    """A path of straight legs: (north, east) of their ends (m + 1, 2)."""

    def __init__(self, points_ne_m: Array) -> None:
        steps = np.diff(points_ne_m, axis=0)
        length_m = np.hypot(steps[:, 0], steps[:, 1])
        good = length_m > 0.1
        if not good.any():
            good = np.ones(len(length_m), dtype=bool)
        self.start_m: Array = points_ne_m[:-1][good]
        self.length_m: Array = np.maximum(length_m[good], 0.1)
        self.along: Array = steps[good] / self.length_m[:, None]
        self.before_m: Array = np.concatenate(((0.0,), np.cumsum(self.length_m)[:-1]))
        self.last = len(self.length_m) - 1
        self.total_m = float(self.length_m.sum())

    def offsets_m(self, leg: NDArray[np.int64], pos: Array) -> tuple[Array, Array]:
        """Return the distance of each position (c, 2) along its leg and to the right of it."""
        off, along = pos - self.start_m[leg], self.along[leg]
        return (off * along).sum(axis=1), off[:, 1] * along[:, 0] - off[:, 0] * along[:, 1]


class SimulatedCourses(NamedTuple):
    """C candidates over T instants."""

    pos_ne_m: Array
    """(c, t, 2)."""
    progress_m: Array
    """(c,) along the legs, at the end."""
    off_m: Array
    """(c,) mean distance off the legs."""
    lee_m: Array
    """(c,) part of `off_m` that is down the current."""


def simulate_courses(
    legs: PathLegs,
    pos_ne_m: Array,
    vel_ne_mps: Array,
    bow_rad: float,
    course_rad: Array,
    hold_s: Array,
    speed_mps: Array,
    horizon_s: float,
    current_ne_mps: Array | None = None,
) -> SimulatedCourses:
    """Hold course_rad (c,) for hold_s (c,), then follow the legs by line of sight, at speed_mps (c,) over ground."""
    number = len(course_rad)
    steps = round(horizon_s / STEP_S)
    pos = np.tile(pos_ne_m, (number, 1))
    speed_now = math.hypot(*vel_ne_mps.tolist())
    made_good = math.atan2(vel_ne_mps[1], vel_ne_mps[0]) if speed_now > 0.7 else bow_rad
    course, speed = np.full(number, made_good), np.full(number, speed_now)
    leg = np.zeros(number, dtype=np.int64)
    out = np.empty((number, steps, 2))
    off_sum, lee_sum = np.zeros(number), np.zeros(number)
    set_ne = np.zeros(2)  # direction of the current, of length 1 for a strong current and less for a weak one
    if current_ne_mps is not None:
        set_ne = current_ne_mps / max(math.hypot(*current_ne_mps.tolist()), TUNED.course_current_mps)
    to_right = legs.along[:, 0] * set_ne[1] - legs.along[:, 1] * set_ne[0]  # component of the set across each leg
    for step in range(steps):
        along_m, cross_m = legs.offsets_m(leg, pos)
        reached = (along_m > legs.length_m[leg] - TUNED.course_reached_m) & (leg < legs.last)
        if reached.any():
            leg = np.where(reached, leg + 1, leg)
            along_m, cross_m = legs.offsets_m(leg, pos)
        done = (leg == legs.last) & (along_m > legs.length_m[leg] - 1.0)
        direction = np.arctan2(legs.along[leg, 1], legs.along[leg, 0])
        wanted = np.where(step * STEP_S < hold_s, course_rad, direction - np.arctan(cross_m / TUNED.course_lookahead_m))
        turn = (wanted - course + np.pi) % (2.0 * np.pi) - np.pi
        course = course + np.clip(TUNED.course_turn_gain_per_s * turn, -_TURN_RADPS, _TURN_RADPS) * STEP_S
        slow = np.clip(np.cos(turn), TUNED.course_slowest_turn, 1.0)
        asked = np.where(done & (step * STEP_S >= hold_s), 0.0, speed_mps * slow)
        most_mps = TUNED.course_acceleration_mps2 * STEP_S
        speed = speed + np.clip(asked - speed, -most_mps * 1.5, most_mps)
        pos = pos + (speed * STEP_S)[:, None] * np.stack((np.cos(course), np.sin(course)), axis=1)
        out[:, step] = pos
        off_sum += np.abs(cross_m)
        lee_sum += np.maximum(cross_m * to_right[leg], 0.0)
    along_m, _ = legs.offsets_m(leg, pos)
    progress_m = legs.before_m[leg] + np.minimum(along_m, legs.length_m[leg])
    return SimulatedCourses(out, progress_m, off_sum / steps, lee_sum / steps)


def crab_heading_rad(course_rad: float, speed_mps: float, current_ne_mps: Array) -> float:
    """Heading in rad that makes good a course over ground at a speed over ground in a current."""
    north, east = (
        speed_mps * math.cos(course_rad) - float(current_ne_mps[0]),
        speed_mps * math.sin(course_rad) - float(current_ne_mps[1]),
    )
    return math.atan2(east, north)


def leg_course_rad(legs: PathLegs, pos_ne_m: Array) -> tuple[float, float]:
    """Course in rad back to the first leg and along it, and cross-track distance of the vessel (right positive)."""
    _, cross = legs.offsets_m(np.zeros(1, dtype=np.int64), pos_ne_m[None])
    direction = math.atan2(legs.along[0, 1], legs.along[0, 0])
    return direction - math.atan(float(cross[0]) / TUNED.course_lookahead_m), float(cross[0])


FREE, AROUND, STAY = range(3)

_COURSES_RAD = np.radians(np.arange(-TUNED.plan_courses_deg, TUNED.plan_courses_deg + 1.0, TUNED.plan_courses_step_deg))
# Distances of the waiting positions, up the current.
_RETREATS_M = np.array(TUNED.plan_retreats_m)


class AvoidanceChoice(NamedTuple):
    """Chosen course."""

    kind: int
    """FREE: follow the legs. AROUND: hold a course and speed over ground. STAY: stop."""
    course_rad: float
    speed_mps: float
    clearance_m: float
    """Least clearance of that choice."""


class CollisionCheck(NamedTuple):
    """Result of the collision check of a path."""

    clearance_m: float
    """Least clearance on the path."""
    blocked: bool
    """Whether that clearance is too small."""
    after_s: float
    """Time until the clearance becomes too small."""


class Obstacles(NamedTuple):
    """Moving boxes and static points."""

    middle_ne_m: Array
    """(o, 2) now."""
    vel_ne_mps: Array
    """(o, 2) now."""
    half_length_m: Array
    """(o,), as are the next two."""
    half_width_m: Array
    heading_rad: Array
    points_ne_m: Array


def obstacles_near(now_ns: int, tracks: Sequence[ObstacleTrack], points_ne_m: Array, pos_ne_m: Array) -> Obstacles:
    """Return the tracks and the structure near the vessel at `now_ns`."""
    far_m = TUNED.plan_far_m
    near = [track for track in tracks if math.hypot(*(track.position_at(now_ns) - pos_ne_m).tolist()) < far_m]
    if len(points_ne_m) > TUNED.plan_structure_points:
        off = points_ne_m - pos_ne_m
        nearest = np.argsort(np.hypot(off[:, 0], off[:, 1]), kind="stable")[: TUNED.plan_structure_points]
        points_ne_m = points_ne_m[nearest]
    stray_m = [min(TUNED.plan_stray_mps * (now_ns - track.seen_ns) * 1e-9, TUNED.plan_stray_most_m) for track in near]
    ahead = [np.array((math.cos(track.heading_rad), math.sin(track.heading_rad))) for track in near]
    middles = [track.position_at(now_ns) + 0.5 * track.hidden_m * bow for track, bow in zip(near, ahead)]
    half_m = [0.5 * (track.length_m + abs(track.hidden_m)) for track in near]
    return Obstacles(
        np.array(middles).reshape(-1, 2),
        np.array([track.state[2:] for track in near]).reshape(-1, 2),
        np.array([half + strays for half, strays in zip(half_m, stray_m)]),
        np.array([0.5 * track.width_m + strays for track, strays in zip(near, stray_m)]),
        np.array([track.heading_rad for track in near]),
        points_ne_m,
    )


def clearance_m(sailed: Array, around: Obstacles, hull_m: float) -> Array:
    """Distance (c, t) from the hull, a circle of radius hull_m, to the nearest obstacle, for positions (c, t, 2)."""
    return np.minimum(_from_tracks_m(sailed, around), _from_points_m(sailed, around.points_ne_m)) - hull_m


def _from_tracks_m(sailed: Array, around: Obstacles) -> Array:
    steps = sailed.shape[1]
    after_s = STEP_S * np.arange(1, steps + 1)
    nearest = np.full(sailed.shape[:2], 1e3)
    for number in range(len(around.middle_ne_m)):
        off = sailed - (around.middle_ne_m[number] + around.vel_ne_mps[number] * after_s[:, None])
        cos, sin = math.cos(around.heading_rad[number]), math.sin(around.heading_rad[number])
        along = np.abs(off[..., 0] * cos + off[..., 1] * sin) - around.half_length_m[number]
        across = np.abs(off[..., 1] * cos - off[..., 0] * sin) - around.half_width_m[number]
        gap = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0)) + np.minimum(np.maximum(along, across), 0.0)
        np.minimum(nearest, gap - TUNED.plan_spread_mps * after_s, out=nearest)
    return nearest


def _from_points_m(sailed: Array, points_ne_m: Array) -> Array:
    if not len(points_ne_m):
        return np.full(sailed.shape[:2], 1e3)
    # A few points at once, in one array: products with all of them are megabytes in each plan, which the heap keeps.
    flat = np.ascontiguousarray(sailed.reshape(-1, 2).T)
    nearest = np.full(flat.shape[1], np.inf)
    products = np.empty((_POINTS_AT_ONCE, flat.shape[1]))
    for first in range(0, len(points_ne_m), _POINTS_AT_ONCE):
        points = points_ne_m[first : first + _POINTS_AT_ONCE]
        square = np.matmul(-2.0 * points, flat, out=products[: len(points)])
        square += (points**2).sum(axis=1)[:, None]
        np.minimum(nearest, square.min(axis=0), out=nearest)
    gap: Array = np.sqrt(np.maximum(nearest + (flat**2).sum(axis=0), 0.0)).reshape(sailed.shape[:2])
    return gap


class AvoidancePlanner:
    """Plans avoidance courses.

    margin_m: clearance to keep.
    begin_m: a path with less clearance is blocked.
    horizon_s: horizon of the collision check.
    hull_m: radius of the circle around the hull.
    """

    def __init__(self, margin_m: float, begin_m: float, horizon_s: float, hull_m: float) -> None:
        self._margin_m = margin_m
        self._begin_m = begin_m
        self._horizon_s = horizon_s
        self._hull_m = hull_m

    def check_collision(
        self, legs: PathLegs, pos_ne_m: Array, vel_ne_mps: Array, bow_rad: float, speed_mps: float, around: Obstacles
    ) -> CollisionCheck:
        """Check the mission's path for collisions."""
        none, speed = np.zeros(1), np.array((speed_mps,))
        sailed = simulate_courses(legs, pos_ne_m, vel_ne_mps, bow_rad, none, none, speed, self._horizon_s)
        clear = clearance_m(sailed.pos_ne_m, around, self._hull_m)
        least_m = float(_least(clear)[0])
        close = np.flatnonzero(clear[0] < self._begin_m)
        return CollisionCheck(
            least_m, least_m < self._begin_m, STEP_S * float(close[0] + 1 if len(close) else clear.shape[1])
        )

    def choose_course(
        self,
        legs: PathLegs,
        pos_ne_m: Array,
        vel_ne_mps: Array,
        bow_rad: float,
        speed_mps: float,
        around: Obstacles,
        last_rad: float | None,
        stays: bool,
        current_ne_mps: Array,
    ) -> AvoidanceChoice:
        """Choose the best of all candidate courses.

        `last_rad`, the course held so far, is kept unless another is better.

        Obstacles are passed upstream if possible, because the current sets both them and the vessel downstream.
        stays: whether the vessel is stopped because no course is free.
        """
        # Candidates: the legs at each speed, then all courses, holding times and speeds.
        direction = math.atan2(legs.along[0, 1], legs.along[0, 0])
        courses, holds, speeds = (
            grid.ravel()
            for grid in np.meshgrid(
                direction + _COURSES_RAD,
                np.array(TUNED.plan_holds_s),
                speed_mps * np.array(TUNED.plan_speeds),
                indexing="ij",
            )
        )
        courses = np.concatenate(((0.0, 0.0), courses))
        holds = np.concatenate(((0.0, 0.0), holds))
        speeds = np.concatenate((speed_mps * np.array(TUNED.plan_speeds), speeds))
        # Simulate beyond the horizon of the collision check. Otherwise the vessel steers for an obstacle just beyond
        # it.
        ahead_s = TUNED.plan_farther * self._horizon_s
        sailed = simulate_courses(legs, pos_ne_m, vel_ne_mps, bow_rad, courses, holds, speeds, ahead_s, current_ne_mps)
        standing = np.repeat(_from_points_m(sailed.pos_ne_m[:, ::2], around.points_ne_m), 2, axis=1)
        standing = standing[:, : sailed.pos_ne_m.shape[1]]
        clear = np.minimum(_from_tracks_m(sailed.pos_ne_m, around), standing) - self._hull_m
        least = _least(clear)
        lee_m = standing.min(axis=1) - self._hull_m if math.hypot(*current_ne_mps.tolist()) > 0.2 else None
        cost = self._cost(sailed, least, lee_m, courses, holds, last_rad)
        best = int(np.argmin(cost))
        # Stay if the best course makes too little way, or collides earlier than the stopped vessel.
        stay_m = self._staying(pos_ne_m, vel_ne_mps, around)
        along_m = float(legs.offsets_m(np.zeros(1, dtype=np.int64), pos_ne_m[None])[0][0])
        worth_m = (TUNED.plan_leaving_worth if stays else TUNED.plan_worth) * speed_mps * ahead_s
        wanted_m = min(worth_m, TUNED.plan_gain_share * (legs.total_m - along_m))
        no_use = float(sailed.progress_m[best]) - along_m < wanted_m and stay_m > 0.5 * self._margin_m
        if no_use or (least[best] < TUNED.plan_touch_m and stay_m > least[best]):
            return AvoidanceChoice(STAY, bow_rad, 0.0, stay_m)
        if least[best] < TUNED.plan_touch_m:
            best = int(np.argmax(least))
        return AvoidanceChoice(
            FREE if best < 2 else AROUND, float(courses[best]), float(speeds[best]), float(least[best])
        )

    def _cost(
        self,
        sailed: SimulatedCourses,
        least: Array,
        lee_m: Array | None,
        courses: Array,
        holds: Array,
        last_rad: float | None,
    ) -> Array:
        short = np.maximum(self._margin_m - least, 0.0)
        cost: Array = (sailed.progress_m.max() - sailed.progress_m) + 1.5 * sailed.off_m + 4.0 * short + 6.0 * short**2
        cost = cost + np.where(least < TUNED.plan_touch_m, 1e3, 0.0)
        cost = cost + np.where(holds > 0.0, TUNED.plan_leaving_cost, 0.0)
        cost = cost + TUNED.plan_lee_cost * sailed.lee_m
        if lee_m is not None:  # require no more clearance than the legs have
            wanted_m = min(TUNED.plan_lee_margins * self._margin_m, lee_m[0])
            cost = cost + TUNED.plan_lee_short_cost * np.maximum(wanted_m - lee_m, 0.0)
        if last_rad is not None:
            turned = np.abs((courses - last_rad + np.pi) % (2.0 * np.pi) - np.pi)
            cost = cost + np.where(holds > 0.0, 1.5 * np.minimum(turned, 1.5), 0.0)
        return cost

    def waiting_position(self, pos_ne_m: Array, vel_ne_mps: Array, around: Obstacles, current_ne_mps: Array) -> Array:
        """Position (2,) to wait at: the stopping point, or a point up the current with enough clearance."""
        speed = math.hypot(*vel_ne_mps.tolist())
        rest = pos_ne_m + vel_ne_mps * (0.5 * speed / 0.7)
        drift_mps = math.hypot(*current_ne_mps.tolist())
        if drift_mps < 0.1:
            return rest
        places = rest - _RETREATS_M[:, None] * current_ne_mps / drift_mps
        off = places - pos_ne_m
        way_m = np.hypot(off[:, 0], off[:, 1])
        after_s = STEP_S * np.arange(1, round(self._horizon_s / STEP_S) + 1)
        share = np.minimum(TUNED.plan_retreat_mps * after_s / np.maximum(way_m, 0.1)[:, None], 1.0)
        sailed = pos_ne_m + share[..., None] * off[:, None]
        clear = np.minimum(
            _from_tracks_m(sailed, around) - self._margin_m,
            _from_points_m(places[:, None], around.points_ne_m) - TUNED.plan_lee_margins * self._margin_m,
        )
        least = _least(clear - self._hull_m)
        good = np.flatnonzero(least > 0.0)
        best: Array = places[good[0] if len(good) else int(np.argmax(least))]
        return best

    def _staying(self, pos_ne_m: Array, vel_ne_mps: Array, around: Obstacles) -> float:
        """Least clearance if the vessel brakes and stays."""
        steps = round(self._horizon_s / STEP_S)
        speed = math.hypot(*vel_ne_mps.tolist())
        after_s = np.minimum(STEP_S * np.arange(1, steps + 1), speed / 0.7 if speed > 0.0 else 0.0)
        way = after_s - 0.5 * 0.7 / max(speed, 0.1) * after_s**2
        pos = pos_ne_m + way[:, None] * vel_ne_mps
        return float(_least(clearance_m(pos[None], around, self._hull_m))[0])


def _least(clear: Array) -> Array:
    """Least clearance over time. A course that starts too close but opens is judged by its later clearance."""
    least: Array = clear.min(axis=1)
    start = clear[:, 0]
    opening = (start < 3.0) & (least >= start - 0.05)
    return np.where(opening, np.minimum(clear[:, min(5, clear.shape[1] - 1)], clear[:, -1]), least)
