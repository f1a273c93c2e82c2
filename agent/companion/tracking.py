"""Obstacle tracker: moving objects by Kalman filters of constant velocity, and static structure.

A cluster that is long, or adjacent to structure, is structure until its whole outline is seen to move. Then it is
another vessel. A track that leaves the view is predicted for a while.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.companion.detection import Cluster, cells_of, merged_cluster
from agent.companion.settings import TUNED

Array = NDArray[np.float64]

_STRUCTURE_VIEW_RAD = np.radians(TUNED.structure_view_deg)


class StructureMap:
    """Cells of static structure: their points, first and last hits, and number of hits.

    A cell is confirmed when it was hit repeatedly over some time. Glinting crests soon move to other cells.
    """

    def __init__(self) -> None:
        self._points_ne_m: Array = np.empty((0, 2))
        self._cells: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._first_ns: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._seen_ns: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._hits: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._dry: NDArray[np.int64] = np.empty(0, dtype=np.int64)  # hits beyond the water's returns

    @property
    def points_ne_m(self) -> Array:
        """Points (k, 2) of the confirmed cells."""
        points: Array = self._points_ne_m[self._settled]
        return points

    @property
    def _settled(self) -> NDArray[np.bool_]:
        seen_ns = self._seen_ns - self._first_ns
        often = (self._hits >= TUNED.structure_wet_hits) & (seen_ns < self._hits * TUNED.wet_hit_ns)
        wet = often & (seen_ns >= TUNED.structure_wet_ns)
        return wet | ((self._dry >= TUNED.structure_settled_hits) & (seen_ns >= TUNED.structure_settled_ns))

    def add_hits(self, stamp_ns: int, points_ne_m: Array, pos_ne_m: Array, water_reach_m: float) -> None:
        """Add the points of the present hits, seen from pos_ne_m (2,).

        Hits within water_reach_m have little weight, because water returns light there.
        """
        cells, one_each = np.unique(cells_of(points_ne_m), return_index=True)
        known = np.searchsorted(self._cells, cells)
        again = np.zeros(len(cells), dtype=np.bool_)
        inside = known < len(self._cells)
        again[inside] = self._cells[known[inside]] == cells[inside]
        old = known[again]
        self._seen_ns[old] = stamp_ns
        self._hits[old] += 1
        off = points_ne_m[one_each] - pos_ne_m
        dry = (np.hypot(off[:, 0], off[:, 1]) > TUNED.strewn_share * water_reach_m).astype(np.int64)
        self._dry[old] += dry[again]
        new = ~again
        number = int(np.count_nonzero(new))
        merged = np.concatenate((self._cells, cells[new]))
        order = np.argsort(merged, kind="stable")
        stamps = np.full(number, stamp_ns, dtype=np.int64)
        self._cells = merged[order]
        self._points_ne_m = np.concatenate((self._points_ne_m, points_ne_m[one_each][new]))[order]
        self._first_ns = np.concatenate((self._first_ns, stamps))[order]
        self._seen_ns = np.concatenate((self._seen_ns, stamps))[order]
        self._hits = np.concatenate((self._hits, np.ones(number, dtype=np.int64)))[order]
        self._dry = np.concatenate((self._dry, dry[new]))[order]

    def prune(self, now_ns: int, pos_ne_m: Array, bow_rad: float, clear_m: tuple[float, float]) -> None:
        """Drop old and far cells, and cells that would be seen if they existed: ahead, between `clear_m`."""
        if not len(self._cells):
            return
        off = self._points_ne_m - pos_ne_m
        range_m = np.hypot(off[:, 0], off[:, 1])
        bearing = np.arctan2(off[:, 1], off[:, 0]) - bow_rad
        ahead = np.abs((bearing + np.pi) % (2.0 * np.pi) - np.pi) < _STRUCTURE_VIEW_RAD
        age_ns = now_ns - self._seen_ns
        gone = ahead & (range_m > clear_m[0]) & (range_m < clear_m[1]) & (age_ns > TUNED.structure_unseen_ns)
        gone |= ~self._settled & (age_ns > TUNED.structure_unseen_ns)
        gone |= (self._dry < TUNED.structure_settled_hits) & (age_ns > TUNED.structure_wet_kept_ns)
        self._keep(~gone & (age_ns < TUNED.structure_kept_ns) & (range_m < TUNED.structure_far_m))

    def forget_swept(self, since_ns: int, track: ObstacleTrack) -> None:
        """Drop the cells of a moving object: cells near its path with a first hit after `since_ns`."""
        if not len(self._cells):
            return
        off = self._points_ne_m - track.first_ne_m
        way = track.state[:2] - track.first_ne_m
        share = np.clip(off @ way / max(float(way @ way), 1e-6), 0.0, 1.0)
        beside_m = np.hypot(*(off - share[:, None] * way).T)
        self._keep((self._first_ns < since_ns) | (beside_m > 0.5 * track.length_m + TUNED.track_gate_m))

    def _keep(self, keep: NDArray[np.bool_]) -> None:
        self._cells, self._points_ne_m, self._hits = self._cells[keep], self._points_ne_m[keep], self._hits[keep]
        self._first_ns, self._seen_ns, self._dry = self._first_ns[keep], self._seen_ns[keep], self._dry[keep]

    def within(self, pos_ne_m: Array, range_m: float) -> Array:
        """Confirmed points (k, 2) within `range_m`."""
        points = self.points_ne_m
        off = points - pos_ne_m
        near: Array = points[np.hypot(off[:, 0], off[:, 1]) < range_m]
        return near

    def covers(self, point_ne_m: Array, radius_m: float) -> bool:
        """Whether there is structure within radius_m of a point."""
        off = self.points_ne_m - point_ne_m
        return bool((np.hypot(off[:, 0], off[:, 1]) < radius_m).any())


_VIEW_RAD = math.radians(TUNED.track_view_deg)
_RECTANGLES_RAD = np.radians(np.arange(0.0, 90.0, 3.0))
_RECTANGLE_AXES = np.concatenate(
    [
        np.array((np.cos(_RECTANGLES_RAD), np.sin(_RECTANGLES_RAD))),
        np.array((-np.sin(_RECTANGLES_RAD), np.cos(_RECTANGLES_RAD))),
    ],
    axis=1,
)


def _turned(vector_ne: Array, heading_rad: float) -> Array:
    """Vectors (2,) or (n, 2) in axes rotated by a heading: (2,) or (2, n)."""
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    north, east = vector_ne[..., 0], vector_ne[..., 1]
    return np.array((north * cos + east * sin, east * cos - north * sin))


@dataclass(frozen=True)
class _View:
    """A point of view: a position (2,), the direction of the lidar, and the range at which water returns light."""

    pos_ne_m: Array
    bow_rad: float
    water_reach_m: float

    def range_m(self, place_ne_m: Array) -> float:
        return math.hypot(*(place_ne_m - self.pos_ne_m).tolist())

    def is_seen(self, place_ne_m: Array) -> bool:
        """Whether an object at this position would be seen, beyond the water's returns."""
        off = place_ne_m - self.pos_ne_m
        bearing = math.remainder(math.atan2(off[1], off[0]) - self.bow_rad, math.tau)
        nearest_m = TUNED.strewn_share * self.water_reach_m
        return abs(bearing) < _VIEW_RAD and nearest_m < math.hypot(*off.tolist()) < TUNED.track_view_m

    def holds(self, points_ne_m: Array) -> NDArray[np.bool_]:
        """(n,) points that are well within view, so that an end there is a real end of the object."""
        off = points_ne_m - self.pos_ne_m
        bearing = np.arctan2(off[:, 1], off[:, 0]) - self.bow_rad
        ahead = np.abs((bearing + np.pi) % (2.0 * np.pi) - np.pi) < _VIEW_RAD
        near: NDArray[np.bool_] = np.hypot(off[:, 0], off[:, 1]) < TUNED.outline_view_m
        return ahead & near


class _OutlineLook(NamedTuple):
    """One look at an object."""

    stamp_ns: int
    middle_ne_m: Array
    points_ne_m: Array
    whole: bool
    ends_ne_m: Array
    """(2, 2), the centres of its outermost metres."""
    in_view: NDArray[np.bool_]
    """Which of these ends are in view."""
    range_m: Array


class OutlineMotion:
    """Decides whether an object moves, and not only its visible part.

    The visible part of a wall or boom varies from look to look: one end moves, or both move apart. Both ends of a
    moving object's outline move in the same direction by the same distance. If one end is out of view, the other
    decides. An end that only enters the view keeps its distance; the end of an object that we approach comes steadily
    nearer.
    """

    def __init__(self) -> None:
        self._looks: deque[_OutlineLook] = deque()
        self._agreed = 0

    def add_look(self, cluster: Cluster, view: _View) -> Array | None:
        """Return the velocity (2,) over ground, None unless several looks agree on it."""
        # Measure the ends of the outline.
        points = cluster.points_ne_m
        ahead_m = _turned(points, cluster.heading_rad)[0]
        ends = np.array(
            [points[ahead_m < ahead_m.min() + 1.0].mean(axis=0), points[ahead_m > ahead_m.max() - 1.0].mean(axis=0)]
        )
        whole_in_view, off = bool(view.holds(points).all()), ends - view.pos_ne_m
        range_m = np.hypot(off[:, 0], off[:, 1])
        now = _OutlineLook(
            cluster.stamp_ns, cluster.middle_ne_m, points, whole_in_view, ends, view.holds(ends), range_m
        )
        # Compare with an earlier look: the whole outline if possible, otherwise the visible end.
        while self._looks and now.stamp_ns - self._looks[0].stamp_ns > TUNED.outline_longest_ns:
            self._looks.popleft()
        old = [look for look in self._looks if now.stamp_ns - look.stamp_ns >= TUNED.outline_shortest_ns]
        whole = next((look for look in old if look.whole), None) if now.whole else None
        then = whole or (old[0] if old else None)
        vel_ne_mps = None
        if then is not None:
            way = _end_way(then, self._looks[len(self._looks) // 2], now) if whole is None else _whole_way(whole, now)
            dt_s = (now.stamp_ns - then.stamp_ns) * 1e-9
            least_m = max(TUNED.outline_least_m, TUNED.outline_least_mps * dt_s)
            gone = way is not None and math.hypot(*way.tolist()) > least_m
            self._agreed = self._agreed + 1 if gone else 0
            if way is not None and self._agreed >= TUNED.outline_looks:
                vel_ne_mps = way / dt_s
        self._looks.append(now)
        return vel_ne_mps


def _whole_way(then: _OutlineLook, now: _OutlineLook) -> Array | None:
    """Motion (2,) of the whole outline since then, None if only a part moved."""
    way = now.middle_ne_m - then.middle_ne_m
    way_m = max(math.hypot(*way.tolist()), 1e-6)
    now_m, then_m = now.points_ne_m @ way / way_m, then.points_ne_m @ way / way_m
    ends_m = float(now_m.max() - then_m.max()), float(now_m.min() - then_m.min())
    return way if min(ends_m) > TUNED.outline_share * way_m else None


def _end_way(then: _OutlineLook, between: _OutlineLook, now: _OutlineLook) -> Array | None:
    """Motion (2,) of the one visible end, at a constant rate and steadily nearer. None otherwise."""
    if now.in_view.sum() != 1:
        return None
    end = int(np.argmax(now.in_view))
    place = now.ends_ne_m[end]
    before = []
    for look in (between, then):
        off_m = np.where(look.in_view, np.hypot(*(look.ends_ne_m - place).T), np.inf)
        nearest = int(np.argmin(off_m))
        if not look.in_view[nearest]:
            return None
        before.append((look.ends_ne_m[nearest], float(look.range_m[nearest])))
    (halfway, halfway_m), (start, start_m) = before
    way = place - start
    way_m = max(math.hypot(*way.tolist()), 1e-6)
    share = float((halfway - start) @ way) / way_m**2
    aside_m = abs(float((halfway - start)[0] * way[1] - (halfway - start)[1] * way[0])) / way_m
    even = 0.25 < share < 0.75 and aside_m < TUNED.outline_share * way_m
    nearer_m = min(start_m - halfway_m, halfway_m - float(now.range_m[end]))
    return way if even and nearer_m > 0.5 * TUNED.outline_nearer * way_m else None


class ObstacleTrack:
    """A drifting object, or another vessel."""

    def __init__(self, number: int, cluster: Cluster, drift_ne_mps: Array, hits_needed: int) -> None:
        self.number = number
        self.state = np.array((*cluster.middle_ne_m.tolist(), *drift_ne_mps.tolist()))
        """North, east (m), and their rates (m/s)."""
        self.covariance = np.diag((0.3, 0.3, TUNED.track_start_mps**2, TUNED.track_start_mps**2))
        self.stamp_ns = self.seen_ns = self.first_ns = cluster.stamp_ns
        self.first_ne_m: Array = cluster.middle_ne_m
        self.length_m, self.width_m, self.height_m = cluster.length_m, cluster.width_m, cluster.height_m
        """Size, the length along `heading_rad`."""
        self.heading_rad = cluster.heading_rad
        self.points = cluster.points
        self.hits = 1
        self.missed_ns = 0  # time in view since the last hit
        self.hits_needed = hits_needed
        self.confirmed = False
        self.counted = False
        self.stands = cluster.length_m > TUNED.track_longest_m
        """Whether it was long in the last look, and is structure as far as is known."""
        self.moves = False
        """Whether its whole outline moves."""
        self.hidden_m = 0.0
        """Distance that a vessel may extend ahead or astern of its visible part."""
        self._outline = OutlineMotion()

    @property
    def is_vessel(self) -> bool:
        """Whether it is larger than drifting objects, and moves."""
        return self.moves and max(self.length_m, self.width_m) > TUNED.vessel_m

    def position_at(self, stamp_ns: int) -> Array:
        """Predicted position (2,) of its middle at an instant."""
        position: Array = self.state[:2] + self.state[2:] * ((stamp_ns - self.stamp_ns) * 1e-9)
        return position

    def holds(self, cluster: Cluster) -> bool:
        """Whether a cluster is at the present position of this vessel, and no larger than a part of it."""
        ahead_m, right_m = _turned(cluster.middle_ne_m - self.position_at(cluster.stamp_ns), self.heading_rad)
        inside = abs(ahead_m) < 0.5 * self.length_m + TUNED.track_gate_m
        inside &= abs(right_m) < 0.5 * self.width_m + TUNED.track_gate_m
        return bool(inside) and cluster.length_m < self.length_m + TUNED.vessel_grows_m

    def correct(self, cluster: Cluster, view: _View) -> None:
        """Correct by a cluster. Among returns of water, its size is not used."""
        self._predict(cluster.stamp_ns)
        if self.is_vessel:
            self._correct_vessel(cluster, view.pos_ne_m)
        else:
            self._correct_middle(cluster, view.range_m(cluster.middle_ne_m) < view.water_reach_m)
        speed_mps = math.hypot(*self.state[2:].tolist())
        fastest_mps = TUNED.vessel_fastest_mps if self.moves else TUNED.track_fastest_mps
        if speed_mps > fastest_mps:
            self.state[2:] *= fastest_mps / speed_mps
        self.moves &= speed_mps > TUNED.outline_rest_mps
        self.stands = not self.is_vessel and cluster.length_m > TUNED.track_longest_m
        self.seen_ns, self.points = cluster.stamp_ns, cluster.points
        self.hits += 1
        self.missed_ns = 0
        if cluster.bright >= TUNED.track_bright_points:
            self.hits_needed = min(self.hits_needed, TUNED.track_bright_hits)

    def _correct_middle(self, cluster: Cluster, among_water: bool) -> None:
        # Looks overlap: four times the variance of one look. Different parts of a long object are visible in different
        # looks. So its middle is known across it, and hardly along it.
        hidden_m = 0.5 * max(self.length_m - cluster.length_m, 0.0)
        along = np.array((math.cos(self.heading_rad), math.sin(self.heading_rad)))
        along_m2, across_m2 = 4.0 * (0.2 + 0.05 * cluster.length_m + hidden_m) ** 2, 4.0 * 0.25**2
        noise_m2 = across_m2 * np.eye(2) + (along_m2 - across_m2) * np.outer(along, along)
        if among_water:
            noise_m2 = TUNED.track_crest_gain * noise_m2
        self._update(cluster.middle_ne_m - self.state[:2], noise_m2)
        if not among_water:
            if cluster.length_m > 0.8 * self.length_m:
                self.heading_rad = cluster.heading_rad
            self.length_m = max(self.length_m * TUNED.track_shrink_gain, cluster.length_m)
            self.width_m = max(self.width_m * TUNED.track_shrink_gain, cluster.width_m)
            self.height_m = max(self.height_m * TUNED.track_shrink_gain, cluster.height_m)

    def _correct_vessel(self, cluster: Cluster, from_ne_m: Array) -> None:
        """Shift its box only as far as needed to contain the cluster, which is all of it or a part.

        Let the box grow.
        """
        self.heading_rad = self._heading_of(cluster)
        low_m, high_m = self._extent(cluster)
        half_m = 0.5 * np.array((self.length_m, self.width_m))
        grows = high_m - low_m > 2.0 * half_m
        shift_m = np.where(grows, 0.0, np.maximum(high_m - half_m, 0.0) + np.minimum(low_m + half_m, 0.0))
        self.state[:2] += _turned(np.where(grows, 0.5 * (high_m + low_m), 0.0), -self.heading_rad)  # not a motion
        size_m = np.where(grows, high_m - low_m, 2.0 * half_m * TUNED.vessel_shrink_gain)
        self.length_m, self.width_m = size_m.tolist()
        self.height_m = max(self.height_m, cluster.height_m)
        self._update(_turned(shift_m, -self.heading_rad), TUNED.vessel_place_m**2 * np.eye(2))
        ahead_m, right_m = _turned(from_ne_m - self.state[:2], self.heading_rad)
        reach_m = max(TUNED.vessel_slender * self.width_m - self.length_m, 0.0)
        self.hidden_m = -math.copysign(reach_m, ahead_m) if abs(ahead_m) > abs(right_m) else 0.0

    def _heading_of(self, cluster: Cluster) -> float:
        """Heading of a cluster: the side of its smallest rectangle that is nearest to the course.

        The principal axis of a bow and a flank is askew.
        """
        course_rad = math.atan2(self.state[3], self.state[2])
        off = cluster.points_ne_m @ _RECTANGLE_AXES  # (k, 2 * angles)
        size_m = np.maximum(off.max(axis=0) - off.min(axis=0), TUNED.cell_m)
        angles = len(_RECTANGLES_RAD)
        best = float(_RECTANGLES_RAD[int(np.argmin(size_m[:angles] * size_m[angles:]))])
        return course_rad + math.remainder(best - course_rad, 0.5 * math.pi)

    def _extent(self, cluster: Cluster) -> tuple[Array, Array]:
        """Least and greatest coordinates (2,) of a cluster, ahead and to the right of the middle."""
        seen_m = _turned(cluster.points_ne_m - self.state[:2], self.heading_rad)
        return seen_m.min(axis=-1), seen_m.max(axis=-1)

    def _update(self, innovation: Array, noise_m2: Array) -> None:
        gain = self.covariance[:, :2] @ np.linalg.inv(self.covariance[:2, :2] + noise_m2)
        self.state = self.state + gain @ innovation
        self.covariance = self.covariance - gain @ self.covariance[:2]

    def note_motion(self, cluster: Cluster, view: _View) -> bool:
        """Evaluate a look. Return whether it is the first that shows motion."""
        vel_ne_mps = self._outline.add_look(cluster, view)
        if vel_ne_mps is None:
            return False
        is_new, self.moves = not self.moves, True
        far_off_mps = TUNED.outline_off_mps if self.is_vessel else TUNED.track_odd_mps  # drift is known by now
        if math.hypot(*(vel_ne_mps - self.state[2:]).tolist()) > far_off_mps:
            self.state[2:] = vel_ne_mps
            self.covariance[2:, :2] = self.covariance[:2, 2:] = 0.0
            self.covariance[2:, 2:] = TUNED.outline_off_mps**2 * np.eye(2)
        if is_new and self.is_vessel:
            self.stands = False
            self.heading_rad = self._heading_of(cluster)
            low_m, high_m = self._extent(cluster)
            self.length_m, self.width_m = np.maximum(high_m - low_m, TUNED.cell_m).tolist()
            self.state[:2] += _turned(0.5 * (high_m + low_m), -self.heading_rad)
        return is_new

    def _predict(self, stamp_ns: int) -> None:
        dt_s = max((stamp_ns - self.stamp_ns) * 1e-9, 0.0)
        move = np.eye(4)
        move[0, 2] = move[1, 3] = dt_s
        drive = np.zeros((4, 4))
        for axis in (0, 1):
            drive[axis, axis] = dt_s**3 / 3.0
            drive[axis, axis + 2] = drive[axis + 2, axis] = dt_s**2 / 2.0
            drive[axis + 2, axis + 2] = dt_s
        self.state = move @ self.state
        self.covariance = move @ self.covariance @ move.T + TUNED.track_drive_m2ps3 * drive
        self.stamp_ns = max(stamp_ns, self.stamp_ns)


class ObstacleTracker:
    """Tracks obstacles. Call `update` with the clusters of each look. `confirmed` are the tracks to avoid.

    vessels: a long object that moves is another vessel. Otherwise all long objects are structure.
    """

    def __init__(self, vessels: bool = False) -> None:
        self._vessels = vessels
        self.structure = StructureMap()
        self.total = 0  # number confirmed so far
        self._tracks: list[ObstacleTrack] = []
        self._next = 1
        self._looked_ns: int | None = None

    @property
    def confirmed(self) -> list[ObstacleTrack]:
        """Confirmed tracks, oldest first."""
        return [track for track in self._tracks if track.confirmed and not track.stands]

    def update(
        self,
        now_ns: int,
        clusters: Sequence[Cluster],
        pos_ne_m: Array,
        bow_rad: float,
        water_reach_m: float,
        drift_ne_mps: Array,
    ) -> None:
        """Update with clusters up to `now_ns`, seen from a position and heading.

        New tracks start with the current's drift.
        """
        # Known vessels first, by all of their clusters.
        view = _View(pos_ne_m, bow_rad, water_reach_m)
        for track in self._tracks:
            parts = [cluster for cluster in clusters if track.holds(cluster)] if track.is_vessel else []
            if parts:
                clusters = [cluster for cluster in clusters if not any(cluster is part for part in parts)]
                self._correct(track, parts[0] if len(parts) == 1 else merged_cluster(parts), view)
        # Long clusters, and small ones next to structure, are structure. A long one may also be a moving vessel.
        small, long = [], []
        for cluster in clusters:
            if cluster.length_m > TUNED.track_longest_m:
                self.structure.add_hits(now_ns, cluster.points_ne_m, pos_ne_m, water_reach_m)
                if self._vessels:
                    long.append(cluster)
            else:
                small.append(cluster)
        self.structure.prune(now_ns, pos_ne_m, bow_rad, (water_reach_m + 2.0, 30.0))
        drifting: list[Cluster] = []
        for cluster in small:
            if self.structure.covers(cluster.middle_ne_m, TUNED.track_beside_m + 0.5 * cluster.width_m):
                self.structure.add_hits(now_ns, cluster.points_ne_m, pos_ne_m, water_reach_m)
            else:
                drifting.append(cluster)
        self._match([*drifting, *long], drift_ne_mps, view)
        # Count the time in view without a hit, and drop the lost tracks.
        since_ns = 0 if self._looked_ns is None else max(now_ns - self._looked_ns, 0)
        self._looked_ns = now_ns
        for track in self._tracks:
            if view.is_seen(track.position_at(now_ns)):
                track.missed_ns += since_ns
        self._tracks = [track for track in self._tracks if not self._is_lost(track, now_ns)]

    def _correct(self, track: ObstacleTrack, cluster: Cluster, view: _View) -> None:
        if cluster.stamp_ns <= track.seen_ns + 20_000_000:
            return
        track.correct(cluster, view)
        if self._vessels and track.hits_needed < TUNED.track_wet_hits and track.note_motion(cluster, view):
            if track.is_vessel:
                self.structure.forget_swept(track.first_ns, track)
            if not track.number:
                track.number = self._number()

    def _number(self) -> int:
        number, self._next = self._next, self._next % 65535 + 1
        return number

    def _match(self, clusters: list[Cluster], drift_ne_mps: Array, view: _View) -> None:
        """Associate tracks with clusters, the nearest pairs first. Start tracks for the other clusters."""
        pairs = []
        for index, track in enumerate(self._tracks):
            gate_m = TUNED.track_gate_m + 0.4 * track.length_m
            for other, cluster in enumerate(clusters):
                is_long = cluster.length_m > TUNED.track_longest_m
                if is_long != track.stands and abs(cluster.length_m - track.length_m) > TUNED.track_grows_m:
                    continue
                off_m = float(np.hypot(*(cluster.middle_ne_m - track.position_at(cluster.stamp_ns))))
                if off_m < gate_m:
                    pairs.append((off_m - (1.0 if track.confirmed else 0.0), index, other))
        taken: set[int] = set()
        matched: set[int] = set()
        for _, index, other in sorted(pairs):
            if index in matched or other in taken:
                continue
            matched.add(index)
            taken.add(other)
            track, cluster = self._tracks[index], clusters[other]
            if cluster.stamp_ns > track.seen_ns + 20_000_000:
                self._correct(track, cluster, view)
                self._confirm(track, drift_ne_mps)
        near_known = {other for _, _, other in pairs}
        for other, cluster in enumerate(clusters):
            range_m = view.range_m(cluster.middle_ne_m)
            if other in near_known or range_m < TUNED.track_born_m:
                continue
            wet = range_m < TUNED.strewn_share * view.water_reach_m
            track = ObstacleTrack(0, cluster, drift_ne_mps, TUNED.track_wet_hits if wet else TUNED.track_hits)
            if track.stands:
                track.state[2:] = 0.0
            else:
                track.number = self._number()
            self._tracks.append(track)

    def _confirm(self, track: ObstacleTrack, drift_ne_mps: Array) -> None:
        wet = track.hits_needed >= TUNED.track_wet_hits
        off_mps = math.hypot(*(track.state[2:] - drift_ne_mps).tolist())
        is_odd = not track.moves and off_mps > (TUNED.track_odd_wet_mps if wet else TUNED.track_odd_mps)
        hits = track.hits_needed + (TUNED.track_odd_hits if is_odd else 0)
        known_ns = track.seen_ns - track.first_ns
        if track.confirmed:
            # crests that the bow pushes along were tracked as one object, which then seems to follow the vessel
            track.confirmed = not wet or track.hits >= hits
            return
        if track.stands or track.hits < hits or known_ns < TUNED.track_confirmed_ns:
            return
        if wet and known_ns > track.hits * TUNED.wet_hit_ns:
            return
        self.total += not track.counted
        track.confirmed = track.counted = True

    def _is_lost(self, track: ObstacleTrack, now_ns: int) -> bool:
        unseen_ns = now_ns - track.seen_ns
        if not track.confirmed:
            wet = track.hits_needed >= TUNED.track_wet_hits
            return unseen_ns > (TUNED.track_doubtful_ns if wet else TUNED.track_doubtful_far_ns)
        covered = not track.is_vessel and self.structure.covers(track.position_at(now_ns), 1.0)
        if unseen_ns > TUNED.track_doubtful_ns and covered:
            return True
        looked_for_ns = TUNED.track_lost_ns + track.hits * TUNED.track_looked_for_ns
        if track.missed_ns > min(looked_for_ns, TUNED.track_looked_for_most_ns):
            return True
        coasted_ns = TUNED.vessel_coasted_ns if track.is_vessel else TUNED.track_coasted_ns
        return unseen_ns > min(coasted_ns, TUNED.track_lost_ns + track.hits * TUNED.track_coasts_ns)


class CurrentEstimator:
    """Estimates the current from the vessel's drift across its heading, which its propulsion does not cause.

    It uses least squares with forgetting. Its prior is a typical river speed.
    """

    def __init__(self) -> None:
        self.current_ne_mps: Array = np.zeros(2)
        self._covariance: Array = np.eye(2) * 0.5
        self._stamp_ns: int | None = None

    def update(self, stamp_ns: int, vel_ned_mps: Array, heading_rad: float, yaw_rate_radps: float) -> None:
        """Update by velocity over ground and heading. Turns are ignored."""
        if self._stamp_ns is not None and stamp_ns - self._stamp_ns < 200_000_000:
            return
        self._stamp_ns = stamp_ns
        if abs(yaw_rate_radps) > 0.1:
            return
        right = np.array((-math.sin(heading_rad), math.cos(heading_rad)))
        side_mps = float(right @ vel_ned_mps[:2])
        self._covariance = self._covariance + 1e-4 * np.eye(2)
        gain = self._covariance @ right / (float(right @ self._covariance @ right) + 0.3)
        self.current_ne_mps = self.current_ne_mps + gain * (side_mps - float(right @ self.current_ne_mps))
        self._covariance = self._covariance - np.outer(gain, right @ self._covariance)
