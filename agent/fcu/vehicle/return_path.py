"""Return path of SMART_RTL: positions passed since arming, simplified, with loops removed.

It works as in ArduPilot. A position is stored when it is SRTL_ACCURACY from the last one. Positions on a line are
reduced to its ends (Ramer 1972, Douglas and Peucker 1973). If the path passes an earlier part of itself, the part
between is removed. This compares every pair of segments, so each cycle compares some of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent.fcu.parameters import Parameters
from agent.fcu.vehicle_state import INFO, WARNING, EventQueue
from agent.navigation.geodetic import LocalProjection

Point = tuple[float, float]

_THINNED_AFTER = 50  # new positions
_SPARE = 10  # free positions that trigger the removal of loops
_GIVEN_UP_NS = 15_000_000_000
_WARNED_NS = 10_000_000_000
_PAIRS_A_CYCLE = 400


class ReturnPath:
    """Path in `points` from the start on, metres north and east. `problem` is the reason for no path, empty otherwise.

    Without a position, or without room, for SmartRTL's 15 s, the path is abandoned until the next arming.
    """

    def __init__(self, parameters: Parameters, events: EventQueue) -> None:
        self.points: list[Point] = []
        self.problem = "no position yet"
        self._events = events
        self._frame: LocalProjection | None = None
        self._saved_ns = 0
        self._warned_ns: int | None = None
        self.configure(parameters)
        self._forget()

    def configure(self, p: Parameters) -> None:
        """Apply changed parameters."""
        self._accuracy_m = p["SRTL_ACCURACY"]
        self._most = int(p["SRTL_POINTS"])

    def restart(self) -> None:
        """Start the path at the next position. Called at arming."""
        self.points = []
        self.problem = "no position yet"
        self._forget()

    def _forget(self) -> None:
        self._thinned = 0  # number of leading positions that are already simplified
        self._at: int | None = None  # end of the segment that is compared next for loops, None when inactive

    def update(self, frame: LocalProjection | None, pos_ne_m: Point | None, now_ns: int, saves: bool) -> None:
        """Update each cycle. pos_ne_m: None without a position. saves: False while the vessel follows the path."""
        if self._most == 0 or self._accuracy_m <= 0.0:
            self.points, self.problem = [], "SRTL_POINTS is 0"
            return
        if frame is not None and frame is not self._frame:
            if self._frame is not None:
                self.points = [frame.to_local(*self._frame.to_geodetic(*point)) for point in self.points]
            self._frame = frame
        if not self.points:
            if pos_ne_m is not None and self.problem in ("no position yet", "SRTL_POINTS is 0"):
                self.points, self.problem, self._saved_ns = [pos_ne_m], "", now_ns
            return
        if not saves or self.problem:
            return
        if pos_ne_m is None:
            self._give_up_late("bad position", now_ns)
        elif math.dist(self.points[-1], pos_ne_m) < self._accuracy_m:
            self._saved_ns = now_ns
        elif len(self.points) < self._most:
            self.points.append(pos_ne_m)
            self._saved_ns = now_ns
        else:
            self._give_up_late("buffer full", now_ns)
        self._make_room(now_ns)

    def tidy(self) -> bool:
        """Simplify and remove loops, in parts, before the path is followed. Return whether it is complete."""
        if self._at is None:
            self._thin(0)
            self._at = len(self.points) - 1
        return self._cut_loops()

    def leave(self) -> None:
        """End following the path."""
        self._forget()

    def _give_up_late(self, why: str, now_ns: int) -> None:
        if not 0 <= now_ns - self._saved_ns <= _GIVEN_UP_NS:
            self.points, self.problem = [], why
            self._events.add(WARNING, f"SmartRTL deactivated: {why}")

    def _make_room(self, now_ns: int) -> None:
        if len(self.points) - self._thinned >= _THINNED_AFTER:
            self._thin(max(self._thinned - 1, 0))
        if self._at is None and len(self.points) > self._most - _SPARE:
            self._thin(0)
            if len(self.points) > self._most - _SPARE:
                self._at = len(self.points) - 1
        if self._at is not None and self._cut_loops():
            self._at = None
            if len(self.points) > self._most - _SPARE and (
                self._warned_ns is None or not 0 <= now_ns - self._warned_ns < _WARNED_NS
            ):
                self._warned_ns = now_ns
                self._events.add(INFO, "SmartRTL Low on space!")

    def _thin(self, first: int) -> None:
        self.points[first:] = thinned(self.points[first:], 0.5 * self._accuracy_m)
        self._thinned = len(self.points)

    def _cut_loops(self) -> bool:
        """Compare from the end back. A segment near an earlier one removes the part between.

        Return True at the beginning.
        """
        points, at = self.points, min(self._at or 0, len(self.points) - 1)
        pairs = 0
        while at >= 3 and pairs < _PAIRS_A_CYCLE:
            for early in range(1, at - 1):
                pairs += 1
                near = _nearest(points[early - 1], points[early], points[at - 1], points[at])
                if near[0] < 0.99 * self._accuracy_m:
                    points[early:at] = [near[1]]
                    self._thinned = min(self._thinned, len(points))
                    at = early + 1
                    break
            at -= 1
        self._at = at
        return at < 3


def thinned(points: Sequence[Point], least_m: float) -> list[Point]:
    """Return a subset of the points. Its line is nowhere farther than `least_m` from the others. Both ends remain."""
    if len(points) < 3:
        return list(points)
    remaining = {0, len(points) - 1}
    open_ends = [(0, len(points) - 1)]
    while open_ends:
        first, last = open_ends.pop()
        off_m, furthest = 0.0, first
        for index in range(first + 1, last):
            distance_m = math.dist(points[index], _foot(points[index], points[first], points[last]))
            if distance_m > off_m:
                off_m, furthest = distance_m, index
        if off_m > least_m:
            remaining.add(furthest)
            open_ends += [(first, furthest), (furthest, last)]
    return [points[index] for index in sorted(remaining)]


def _foot(point: Point, start: Point, end: Point) -> Point:
    """Return the point of a segment that is nearest to a point."""
    dn, de = end[0] - start[0], end[1] - start[1]
    length2 = dn * dn + de * de
    if length2 == 0.0:
        return start
    part = min(max(((point[0] - start[0]) * dn + (point[1] - start[1]) * de) / length2, 0.0), 1.0)
    return start[0] + part * dn, start[1] + part * de


def _nearest(a: Point, b: Point, c: Point, d: Point) -> tuple[float, Point]:
    """Least distance of the segments a to b and c to d, and the midpoint at that distance."""
    crossing = _crossing(a, b, c, d)
    if crossing is not None:
        return 0.0, crossing
    best, middle = math.inf, a
    for point, start, end in ((a, c, d), (b, c, d), (c, a, b), (d, a, b)):
        foot = _foot(point, start, end)
        distance_m = math.dist(point, foot)
        if distance_m < best:
            best, middle = distance_m, (0.5 * (point[0] + foot[0]), 0.5 * (point[1] + foot[1]))
    return best, middle


def _crossing(a: Point, b: Point, c: Point, d: Point) -> Point | None:
    first, second = (b[0] - a[0], b[1] - a[1]), (d[0] - c[0], d[1] - c[1])
    across = first[0] * second[1] - first[1] * second[0]
    if across == 0.0:
        return None
    gap = (c[0] - a[0], c[1] - a[1])
    along_first = (gap[0] * second[1] - gap[1] * second[0]) / across
    along_second = (gap[0] * first[1] - gap[1] * first[0]) / across
    if not (0.0 <= along_first <= 1.0 and 0.0 <= along_second <= 1.0):
        return None
    return a[0] + along_first * first[0], a[1] + along_first * first[1]
