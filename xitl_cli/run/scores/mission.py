"""Score of the mission by the truth: cross-track error and waypoints passed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

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
