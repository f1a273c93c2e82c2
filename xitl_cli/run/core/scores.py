"""Scores of a run by the truth: the mission, the autopilot's estimate, and the obstacles of the companion."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.kinematics import Kinematics
from sim_core.world.debris import DebrisState
from sim_core.world.rays import Bodies, RayCaster
from xitl_cli.record.topics import MotionEstimate

Point = tuple[float, float]


class RootMeanSquare:
    def __init__(self) -> None:
        self._sum = 0.0
        self._count = 0

    def add(self, square: float) -> None:
        self._sum += square
        self._count += 1

    def value(self) -> float | None:
        return math.sqrt(self._sum / self._count) if self._count else None


class MissionScore:
    """Cross-track error of the true track against the true legs, and the closest distance to each waypoint.

    The first leg starts at the vessel's position when the mission began. Waypoints are (north, east) in metres.
    """

    def __init__(self, waypoints: Sequence[Point]) -> None:
        self._begin(waypoints)

    def follow(self, waypoints: Sequence[Point]) -> bool:
        """Judge by these waypoints from now on. If they are new, start again and return True."""
        another = list(waypoints) != self._waypoints
        if another:
            self._begin(waypoints)
        return another

    def _begin(self, waypoints: Sequence[Point]) -> None:
        self._waypoints = list(waypoints)
        self._start: Point | None = None
        self._cross_track = RootMeanSquare()
        self.cross_track_max_m = 0.0
        self.latest_m: float | None = None  # None while the vessel heads for no waypoint of the mission
        self.closest_m: list[float | None] = [None] * len(self._waypoints)
        self.reached = 0

    def add(self, position: Point, target: int, reached: int) -> None:
        """Add the true position, the index of the current waypoint, and the number of waypoints reached."""
        self._start = self._start or position
        self.reached = max(self.reached, reached)
        if not 0 <= target < len(self._waypoints):
            return
        goal = self._waypoints[target]
        distance = math.dist(position, goal)
        closest = self.closest_m[target]
        self.closest_m[target] = distance if closest is None else min(closest, distance)
        origin = self._waypoints[target - 1] if target else self._start
        error = cross_track_m(position, origin, goal)
        self.latest_m = error
        self._cross_track.add(error * error)
        self.cross_track_max_m = max(self.cross_track_max_m, abs(error))

    @property
    def total(self) -> int:
        """Number of waypoints."""
        return len(self._waypoints)

    @property
    def completed(self) -> bool:
        """Whether every waypoint was reached; a mission without waypoints is never complete."""
        return 0 < self.total == self.reached

    @property
    def cross_track_rms_m(self) -> float | None:
        """Root mean square of the cross-track error; None before the mission began."""
        return self._cross_track.value()

    def section(self) -> dict[str, Any]:
        """Return `mission` of summary.json."""
        return {
            "completed": self.completed,
            "waypoints_reached": self.reached,
            "waypoints_total": self.total,
            "cross_track_rms_m": self.cross_track_rms_m,
            "cross_track_max_m": self.cross_track_max_m,
            "closest_m": self.closest_m,
        }


def cross_track_m(position: Point, origin: Point, goal: Point) -> float:
    """Return the distance to the right of the line from origin to goal, or from the goal when the leg has no length."""
    along_n, along_e = goal[0] - origin[0], goal[1] - origin[1]
    length = math.hypot(along_n, along_e)
    if length < 1e-6:
        return math.dist(position, goal)
    return (along_n * (position[1] - origin[1]) - along_e * (position[0] - origin[0])) / length


KEPT_S = 1.0


class TruePose(NamedTuple):
    """True position (3,) and attitude (4,) at an instant."""

    pos_ned_m: NDArray[np.float64]
    quat_ned_frd: NDArray[np.float64]


class TruthHistory:
    """Pose at regular instants. The rest of the motion is not kept, so that its memory is reused."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = 1e9 / rate_hz
        self._poses: deque[tuple[NDArray[np.float64], NDArray[np.float64]]] = deque(
            maxlen=max(round(KEPT_S * rate_hz), 1)
        )
        self._newest_ns = 0

    def add(self, stamp_ns: int, motion: Kinematics) -> None:
        """Add the motion at `stamp_ns`."""
        self._newest_ns = stamp_ns
        self._poses.append((motion.pos_ned_m, motion.quat_ned_frd))

    def at(self, stamp_ns: int) -> TruePose | None:
        """Return the pose nearest to an instant.

        Too old an instant gives None, and a future one the newest pose.
        """
        back = max(round((self._newest_ns - stamp_ns) / self._period_ns), 0)
        if back >= len(self._poses):
            return None
        pos_ned_m, quat_ned_frd = self._poses[-1 - back]
        return TruePose(pos_ned_m[0], quat_ned_frd[0])


class EstimationScore:
    """Horizontal position error and heading error of the autopilot's estimate against the truth."""

    def __init__(self) -> None:
        self._position = RootMeanSquare()
        self._normalised = RootMeanSquare()
        self._heading = RootMeanSquare()
        self._normalised_heading = RootMeanSquare()

    def add(
        self,
        true_pos_ned_m: NDArray[np.float64],
        true_quat_ned_frd: NDArray[np.float64],
        pos_ned_m: NDArray[np.float64],
        quat_ned_frd: NDArray[np.float64],
        pos_deviation_ned_m: NDArray[np.float64] | None = None,
        yaw_deviation_rad: float | None = None,
    ) -> None:
        """Add an estimate and the truth of the same instant; positions (3,), quaternions (4,)."""
        north, east = (pos_ned_m - true_pos_ned_m)[:2].tolist()
        self._position.add(north * north + east * east)
        if pos_deviation_ned_m is not None and pos_deviation_ned_m[:2].all():
            north, east = ((pos_ned_m - true_pos_ned_m) / pos_deviation_ned_m)[:2].tolist()
            self._normalised.add(north * north + east * east)
        error = math.remainder(_yaw_rad(quat_ned_frd) - _yaw_rad(true_quat_ned_frd), math.tau)
        self._heading.add(math.degrees(error) ** 2)
        if yaw_deviation_rad:
            self._normalised_heading.add((error / yaw_deviation_rad) ** 2)

    @property
    def position_rms_m(self) -> float | None:
        """Root mean square of the position error; None without an estimate."""
        return self._position.value()

    @property
    def position_nees(self) -> float | None:
        """Mean of the squared horizontal error over its variance (Bar-Shalom, Li and Kirubarajan 2001, 5.4).

        It is 2 for a consistent estimator, and None when the estimator gives no position accuracy.
        """
        rms = self._normalised.value()
        return None if rms is None else rms * rms

    @property
    def heading_rms_deg(self) -> float | None:
        """Root mean square of the heading error; None without an estimate."""
        return self._heading.value()

    @property
    def heading_nees(self) -> float | None:
        """Mean of the squared heading error over its variance: 1 if it is consistent, None without a variance."""
        rms = self._normalised_heading.value()
        return None if rms is None else rms * rms


def _yaw_rad(quat: NDArray[np.float64]) -> float:
    w, x, y, z = quat.tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


class EstimateCheck:
    """Compares estimates with the truth.

    rate_hz: of the truth. score: of the estimates while armed. position_error_m: of the newest estimate.
    """

    def __init__(self, rate_hz: float) -> None:
        self._history = TruthHistory(rate_hz)
        self.score = EstimationScore()
        self.position_error_m: float | None = None

    def add_truth(self, sim_ns: int, motion: Kinematics) -> None:
        """Add the truth. Call this `rate_hz` times a second."""
        self._history.add(sim_ns, motion)

    def add_estimate(self, stamp_ns: int | None, estimate: MotionEstimate, armed: bool) -> None:
        """Add an estimate of the instant `stamp_ns`. Ignore it if the instant is unknown or too old."""
        truth = None if stamp_ns is None else self._history.at(stamp_ns)
        if truth is None:
            return
        north, east = (estimate.pos_ned_m - truth.pos_ned_m)[:2].tolist()
        self.position_error_m = math.hypot(north, east)
        if armed:
            self.score.add(
                truth.pos_ned_m,
                truth.quat_ned_frd,
                estimate.pos_ned_m,
                estimate.quat_ned_frd,
                estimate.pos_deviation_ned_m,
                estimate.yaw_deviation_rad,
            )


Array = NDArray[float64]

NEAR_M = 2.0
"""A track belongs to a body when it lies within this and half the body's length of the body's middle."""
_STANDING_M = 3.0  # a track this near to a fixed object belongs to it
_GRID = 9
_ABOVE_M = 60.0
_AFLOAT_DOWN_M = 0.3


class ObstacleScore:
    """Call `see` with the truth some ten times a second, `hear` with every XITL_OBSTACLE, and `report` at the end.

    hull_m: length and width of the vessel. standing: rays at all fixed objects, None without any. water_down_m: mean
    level of the water. others: bodies that rays hit, first debris and then the hulls of other vessels; None without
    any. tide_m: returns the height of the water above its mean level now. A track of another hull is not a false one.
    Tracks are in the autopilot's local NED with the origin origin_ne_m.
    """

    def __init__(
        self,
        hull_m: tuple[float, float],
        standing: RayCaster | None = None,
        water_down_m: float = 0.0,
        others: Callable[[], Bodies] | None = None,
        tide_m: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self.origin_ne_m: tuple[float, float] = (0.0, 0.0)
        self._half_m = (0.5 * hull_m[0], 0.5 * hull_m[1])
        self._standing = standing
        self._water_down_m, self._tide_m = water_down_m, tide_m
        self._others = others
        self._debris: DebrisState | None = None
        self._place_ne_m, self._yaw_rad = np.zeros(2), 0.0
        self._detected_at_m: dict[int, float] = {}
        self._clearance_m: dict[int, float] = {}
        self._of_something: dict[int, bool] = {}
        self._labels: dict[int, str] = {}
        """Latest class that a track gave to a body, or to another hull, by its number in `others`."""
        self._truth: dict[int, str] = {}
        self._range_error = RootMeanSquare()

    def see(self, pos_ned_m: Array, yaw_rad: float, debris: DebrisState) -> None:
        """Note the vessel's position (3,) and heading, and the drifting bodies, at one instant."""
        self._debris, self._place_ne_m, self._yaw_rad = debris, pos_ned_m[:2], yaw_rad
        for number, gap_m in enumerate(self._gaps_m(np.zeros(2), self._half_m).tolist()):
            self._clearance_m[number] = min(gap_m, self._clearance_m.get(number, math.inf))

    def hear(self, message: Any) -> None:
        """Note an XITL_OBSTACLE, as a report on the instant last seen."""
        place = np.array(message.pos_ned[:2], dtype=float) + self.origin_ne_m
        number = int(message.id)
        if not np.isfinite(place).all():
            self._of_something.setdefault(number, False)
            return
        known = self._of_something.get(number, False)
        debris = self._debris
        if debris is not None and len(debris.bodies):
            off = np.hypot(*(debris.pos_ned_m[:, :2] - place).T)
            reach = NEAR_M + 0.5 * np.array([body.length_m for body in debris.bodies])
            near = np.flatnonzero(off < reach).tolist()
            new = [body for body in near if body not in self._detected_at_m]
            if new:
                from_bow = self._gaps_m(np.array((self._half_m[0], 0.0)), (0.0, 0.0))
                self._detected_at_m.update({body: float(from_bow[body]) for body in new})
            known = known or bool(near)
            if near:
                self._compare(min(near, key=off.__getitem__), message)
        hull = self._near_vessel(place)
        if hull is not None:
            self._label(hull, "vessel", message.label)
        self._of_something[number] = known or hull is not None or self._is_near_fixed(place)

    def _compare(self, body: int, message: Any) -> None:
        """Compare the range and the class of a track with those of its body."""
        assert self._debris is not None
        from_bow = self._gaps_m(np.array((self._half_m[0], 0.0)), (0.0, 0.0))
        self._range_error.add((message.range - float(from_bow[body])) ** 2)
        self._label(body, "debris" if self._debris.bodies[body].buoy is None else "buoy", message.label)

    def _label(self, number: int, truth: str, label: str) -> None:
        self._truth[number] = truth
        self._labels[number] = label or self._labels.get(number, "")

    def _gaps_m(self, middle_fr_m: Array, half_m: tuple[float, float]) -> Array:
        """Return the distances (B,) in plan from a box of the vessel to the edges of the bodies.

        The box is `half_m` long and wide on each side of `middle_fr_m`.
        """
        debris = self._debris
        if debris is None or not len(debris.bodies):
            return np.empty(0)
        figures = debris.figures
        cos, sin = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        steps = np.linspace(-1.0, 1.0, 25)
        axis = np.stack([np.cos(debris.yaw_rad), np.sin(debris.yaw_rad)], axis=-1)
        along = (steps[None] * figures.half_axis_m[:, None])[..., None]
        off = debris.pos_ned_m[:, None, :2] + along * axis[:, None] - self._place_ne_m
        forward = np.abs(off[..., 0] * cos + off[..., 1] * sin - middle_fr_m[0]) - half_m[0]
        right = np.abs(off[..., 1] * cos - off[..., 0] * sin - middle_fr_m[1]) - half_m[1]
        gap = np.hypot(np.maximum(forward, 0.0), np.maximum(right, 0.0)).min(axis=1)
        gaps: Array = np.maximum(gap - figures.radius_m, 0.0)
        return gaps

    def _near_vessel(self, place_ne_m: Array) -> int | None:
        """Return the number of another vessel near a place, counted behind the bodies; None for none."""
        if self._others is None:
            return None
        bodies, adrift = self._others(), 0 if self._debris is None else len(self._debris.bodies)
        off = np.hypot(*(bodies.pos_ned_m[adrift:, :2] - place_ne_m).T)
        reach = [NEAR_M + np.hypot(*mesh.vertices_m[:, :2].T).max() for mesh in bodies.meshes[adrift:]]
        near = np.flatnonzero(off < reach)
        return adrift + int(near[0]) if len(near) else None

    def _is_near_fixed(self, place_ne_m: Array) -> bool:
        """Whether a fixed object rises from the water near a place, by rays from high above."""
        if self._standing is None:
            return False
        offsets = np.linspace(-_STANDING_M, _STANDING_M, _GRID)
        north, east = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
        surface_down_m = self._water_down_m - self._tide_m()
        origin = np.column_stack([north, east, np.full(len(north), surface_down_m - _ABOVE_M)])
        origin[:, :2] += place_ne_m
        down = np.tile(np.array((0.0, 0.0, 1.0), dtype=np.float32), (len(origin), 1))
        range_m = self._standing.cast(origin.astype(np.float32), down).range_m
        return bool((range_m < _ABOVE_M + _AFLOAT_DOWN_M).any())

    def report(self) -> dict[str, Any]:
        """Return the counts for the summary's section `obstacles`."""
        launched = 0 if self._debris is None else len(self._debris.bodies)
        return {
            "launched": launched,
            "detected": len(self._detected_at_m),
            "detected_at_m": [self._detected_at_m.get(number) for number in range(launched)],
            "tracks": len(self._of_something),
            "false": sum(not known for known in self._of_something.values()),
            "min_clearance_m": min(self._clearance_m.values(), default=None),
            "range_rms_m": self._range_error.value(),
            "classes": {
                truth: {
                    "tracked": len(tracked),
                    "right": tracked.count(truth),
                    "wrong": sum(label not in ("", truth) for label in tracked),
                }
                for truth in sorted(set(self._truth.values()))
                for tracked in [[self._labels[number] for number, kind in self._truth.items() if kind == truth]]
            },
        }
