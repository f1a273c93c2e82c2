"""Where the vessel will be: candidate courses sailed ahead of time, all at once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 0.4
_LOOKAHEAD_M = 6.0
_TURN_PER_S = 1.2  # turn rate per course still to be turned
_TURN_RADPS = math.radians(22.0)
_ACCELERATION_MPS2 = 0.6
_REACHED_M = 3.0
_RECKONED_MPS = 0.3  # a current that counts in full
_SLOWEST_TURN = 0.25  # of the speed asked for, with the bow far off


class Legs:
    """The way: legs joined end to end, (north, east) of their ends (m + 1, 2)."""

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

    def off(self, leg: NDArray[np.int64], pos: Array) -> tuple[Array, Array]:
        """How far along its leg and to the right of it each position (c, 2) is."""
        off, along = pos - self.start_m[leg], self.along[leg]
        return (off * along).sum(axis=1), off[:, 1] * along[:, 0] - off[:, 0] * along[:, 1]


class Sailed(NamedTuple):
    """C candidates over T instants: pos_ne_m (c, t, 2), progress_m (c,) along the legs at the end.

    off_m (c,) is the mean distance off the legs, lee_m (c,) the part of it that lies down the current.
    """

    pos_ne_m: Array
    progress_m: Array
    off_m: Array
    lee_m: Array


def sail(
    legs: Legs,
    pos_ne_m: Array,
    vel_ne_mps: Array,
    bow_rad: float,
    course_rad: Array,
    hold_s: Array,
    speed_mps: Array,
    horizon_s: float,
    current_ne_mps: Array | None = None,
) -> Sailed:
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
    set_ne = np.zeros(2) if current_ne_mps is None else _set_of(current_ne_mps)
    to_right = legs.along[:, 0] * set_ne[1] - legs.along[:, 1] * set_ne[0]  # how much of the set is across each leg
    for step in range(steps):
        along_m, cross_m = legs.off(leg, pos)
        reached = (along_m > legs.length_m[leg] - _REACHED_M) & (leg < legs.last)
        if reached.any():
            leg = np.where(reached, leg + 1, leg)
            along_m, cross_m = legs.off(leg, pos)
        done = (leg == legs.last) & (along_m > legs.length_m[leg] - 1.0)
        direction = np.arctan2(legs.along[leg, 1], legs.along[leg, 0])
        wanted = np.where(step * STEP_S < hold_s, course_rad, direction - np.arctan(cross_m / _LOOKAHEAD_M))
        turn = (wanted - course + np.pi) % (2.0 * np.pi) - np.pi
        course = course + np.clip(_TURN_PER_S * turn, -_TURN_RADPS, _TURN_RADPS) * STEP_S
        slow = np.clip(np.cos(turn), _SLOWEST_TURN, 1.0)
        asked = np.where(done & (step * STEP_S >= hold_s), 0.0, speed_mps * slow)
        speed = speed + np.clip(asked - speed, -_ACCELERATION_MPS2 * STEP_S * 1.5, _ACCELERATION_MPS2 * STEP_S)
        pos = pos + (speed * STEP_S)[:, None] * np.stack((np.cos(course), np.sin(course)), axis=1)
        out[:, step] = pos
        off_sum += np.abs(cross_m)
        lee_sum += np.maximum(cross_m * to_right[leg], 0.0)
    along_m, _ = legs.off(leg, pos)
    progress_m = legs.before_m[leg] + np.minimum(along_m, legs.length_m[leg])
    return Sailed(out, progress_m, off_sum / max(steps, 1), lee_sum / max(steps, 1))


def _set_of(current_ne_mps: Array) -> Array:
    """Where the current sets to (2,), of length 1 when it is one to reckon with, less when it is weak."""
    speed_mps = math.hypot(*current_ne_mps.tolist())
    set_ne: Array = current_ne_mps / max(speed_mps, _RECKONED_MPS)
    return set_ne


def crabbing_rad(course_rad: float, speed_mps: float, current_ne_mps: Array) -> float:
    """The heading that makes good a course over ground at a speed over ground in a current."""
    north, east = (
        speed_mps * math.cos(course_rad) - float(current_ne_mps[0]),
        speed_mps * math.sin(course_rad) - float(current_ne_mps[1]),
    )
    return math.atan2(east, north)


def leg_course_rad(legs: Legs, pos_ne_m: Array) -> tuple[float, float]:
    """The course back to the first leg and along it, and how far off it the vessel is (right positive)."""
    _, cross = legs.off(np.zeros(1, dtype=np.int64), pos_ne_m[None])
    direction = math.atan2(legs.along[0, 1], legs.along[0, 0])
    return direction - math.atan(float(cross[0]) / _LOOKAHEAD_M), float(cross[0])
