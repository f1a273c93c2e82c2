"""Obstacle tracker: drifting objects by Kalman filters of constant velocity, and structure that stands still.

A cluster that is long, or lies against structure, is structure and not tracked. A track that leaves the view is
predicted on for a while.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.companion.detection import Cluster, cells_of
from agent.companion.settings import TUNED

Array = NDArray[np.float64]

_STRUCTURE_VIEW_RAD = np.radians(TUNED.structure_view_deg)


class StructureMap:
    """Cells of what stands still: where they were hit, when they were first and last seen, and how often.

    A cell is confirmed when it was hit repeatedly over some time: glinting crests are elsewhere soon.
    """

    def __init__(self) -> None:
        self._points_ne_m: Array = np.empty((0, 2))
        self._cells: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._first_ns: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._seen_ns: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._hits: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._dry: NDArray[np.int64] = np.empty(0, dtype=np.int64)  # hits where no water returns

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
        """Add points hit now, seen from pos_ne_m (2,); hits within water_reach_m, where water returns, weigh little."""
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
        """Drop old and far cells, and those that would be seen if they existed: ahead, between `clear_m`."""
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
        keep = ~gone & (age_ns < TUNED.structure_kept_ns) & (range_m < TUNED.structure_far_m)
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


class ObstacleTrack:
    """A drifting object. state: north, east (m) and their rates (m/s) ; `length_m` along `heading_rad`."""

    def __init__(self, number: int, cluster: Cluster, drift_ne_mps: Array, hits_needed: int) -> None:
        self.number = number
        self.state = np.array((*cluster.middle_ne_m.tolist(), *drift_ne_mps.tolist()))
        self.covariance = np.diag((0.3, 0.3, TUNED.track_start_mps**2, TUNED.track_start_mps**2))
        self.stamp_ns = self.seen_ns = self.first_ns = cluster.stamp_ns
        self.length_m, self.width_m, self.height_m = cluster.length_m, cluster.width_m, cluster.height_m
        self.heading_rad = cluster.heading_rad
        self.points = cluster.points
        self.hits = 1
        self.missed_ns = 0  # in view since it was last seen
        self.hits_needed = hits_needed
        self.confirmed = False
        self.counted = False

    def position_at(self, stamp_ns: int) -> Array:
        """Predicted position (2,) of its middle at an instant."""
        where: Array = self.state[:2] + self.state[2:] * ((stamp_ns - self.stamp_ns) * 1e-9)
        return where

    def correct(self, cluster: Cluster, among_water: bool) -> None:
        """Correct by a cluster; among returns of water its size is not used."""
        self._predict(cluster.stamp_ns)
        # Looks overlap: four times the variance of one. Of a long thing now one part is seen, now another, so that its
        # middle is known across it and hardly along it.
        hidden_m = 0.5 * max(self.length_m - cluster.length_m, 0.0)
        along = np.array((math.cos(self.heading_rad), math.sin(self.heading_rad)))
        along_m2, across_m2 = 4.0 * (0.2 + 0.05 * cluster.length_m + hidden_m) ** 2, 4.0 * 0.25**2
        noise_m2 = across_m2 * np.eye(2) + (along_m2 - across_m2) * np.outer(along, along)
        if among_water:
            noise_m2 = TUNED.track_crest_gain * noise_m2
        innovation = cluster.middle_ne_m - self.state[:2]
        gain = self.covariance[:, :2] @ np.linalg.inv(self.covariance[:2, :2] + noise_m2)
        self.state = self.state + gain @ innovation
        self.covariance = self.covariance - gain @ self.covariance[:2]
        speed_mps = math.hypot(*self.state[2:].tolist())
        if speed_mps > TUNED.track_fastest_mps:
            self.state[2:] *= TUNED.track_fastest_mps / speed_mps
        if not among_water:
            if cluster.length_m > 0.8 * self.length_m:
                self.heading_rad = cluster.heading_rad
            self.length_m = max(self.length_m * TUNED.track_shrink_gain, cluster.length_m)
            self.width_m = max(self.width_m * TUNED.track_shrink_gain, cluster.width_m)
            self.height_m = max(self.height_m * TUNED.track_shrink_gain, cluster.height_m)
        self.seen_ns, self.points = cluster.stamp_ns, cluster.points
        self.hits += 1
        self.missed_ns = 0
        if cluster.bright >= TUNED.track_bright_points:
            self.hits_needed = min(self.hits_needed, TUNED.track_bright_hits)

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
    """`update` with the clusters of each look; `confirmed` are the tracks to avoid."""

    def __init__(self) -> None:
        self.structure = StructureMap()
        self.total = 0  # confirmed so far
        self._tracks: list[ObstacleTrack] = []
        self._next = 1
        self._looked_ns: int | None = None

    @property
    def confirmed(self) -> list[ObstacleTrack]:
        """Oldest first."""
        return [track for track in self._tracks if track.confirmed]

    def update(
        self,
        now_ns: int,
        found: Sequence[Cluster],
        pos_ne_m: Array,
        bow_rad: float,
        water_reach_m: float,
        drift_ne_mps: Array,
    ) -> None:
        """Clusters up to `now_ns`, seen from a position and heading; new tracks start with the current's drift."""
        small: list[Cluster] = []
        for cluster in found:
            if cluster.length_m > TUNED.track_longest_m:
                self.structure.add_hits(now_ns, cluster.points_ne_m, pos_ne_m, water_reach_m)
            else:
                small.append(cluster)
        self.structure.prune(now_ns, pos_ne_m, bow_rad, (water_reach_m + 2.0, 30.0))
        left: list[Cluster] = []
        for cluster in small:
            if self.structure.covers(cluster.middle_ne_m, TUNED.track_beside_m + 0.5 * cluster.width_m):
                self.structure.add_hits(now_ns, cluster.points_ne_m, pos_ne_m, water_reach_m)
            else:
                left.append(cluster)
        self._match(left, drift_ne_mps, pos_ne_m, water_reach_m)
        since_ns = 0 if self._looked_ns is None else max(now_ns - self._looked_ns, 0)
        self._looked_ns = now_ns
        for track in self._tracks:
            if _is_in_view(track, now_ns, pos_ne_m, bow_rad, water_reach_m):
                track.missed_ns += since_ns
        self._tracks = [track for track in self._tracks if not self._is_lost(track, now_ns)]

    def _match(self, things: list[Cluster], drift_ne_mps: Array, pos_ne_m: Array, water_reach_m: float) -> None:
        """Associate tracks with clusters, the nearest pairs first."""
        pairs = []
        for index, track in enumerate(self._tracks):
            gate_m = TUNED.track_gate_m + 0.4 * track.length_m
            for other, thing in enumerate(things):
                off_m = float(np.hypot(*(thing.middle_ne_m - track.position_at(thing.stamp_ns))))
                if off_m < gate_m:
                    pairs.append((off_m - (1.0 if track.confirmed else 0.0), index, other))
        taken: set[int] = set()
        matched: set[int] = set()
        for _, index, other in sorted(pairs):
            if index in matched or other in taken:
                continue
            matched.add(index)
            taken.add(other)
            track, thing = self._tracks[index], things[other]
            if thing.stamp_ns > track.seen_ns + 20_000_000:
                range_m = math.hypot(*(thing.middle_ne_m - pos_ne_m).tolist())
                track.correct(thing, range_m < water_reach_m)
                self._confirm(track, drift_ne_mps)
        near_known = {other for _, _, other in pairs}
        for other, thing in enumerate(things):
            if other not in taken and other not in near_known:
                range_m = math.hypot(*(thing.middle_ne_m - pos_ne_m).tolist())
                if range_m < TUNED.track_born_m:
                    continue
                hits_needed = TUNED.track_wet_hits if range_m < TUNED.strewn_share * water_reach_m else TUNED.track_hits
                self._tracks.append(ObstacleTrack(self._next, thing, drift_ne_mps, hits_needed))
                self._next = self._next % 65535 + 1

    def _confirm(self, track: ObstacleTrack, drift_ne_mps: Array) -> None:
        wet = track.hits_needed >= TUNED.track_wet_hits
        off_mps = math.hypot(*(track.state[2:] - drift_ne_mps).tolist())
        is_odd = off_mps > (TUNED.track_odd_wet_mps if wet else TUNED.track_odd_mps)
        hits = track.hits_needed + (TUNED.track_odd_hits if is_odd else 0)
        known_ns = track.seen_ns - track.first_ns
        if track.confirmed:
            # crests that the bow pushes along were taken for one thing, which then seems to keep up with the vessel
            track.confirmed = not wet or track.hits >= hits
            return
        if track.hits < hits or known_ns < TUNED.track_confirmed_ns:
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
        if unseen_ns > TUNED.track_doubtful_ns and self.structure.covers(track.position_at(now_ns), 1.0):
            return True
        looked_for_ns = TUNED.track_lost_ns + track.hits * TUNED.track_looked_for_ns
        if track.missed_ns > min(looked_for_ns, TUNED.track_looked_for_most_ns):
            return True
        return unseen_ns > min(TUNED.track_coasted_ns, TUNED.track_lost_ns + track.hits * TUNED.track_coasts_ns)


def _is_in_view(track: ObstacleTrack, now_ns: int, pos_ne_m: Array, view_rad: float, water_reach_m: float) -> bool:
    """Whether a track would be seen at its predicted position, beyond where water returns."""
    off = track.position_at(now_ns) - pos_ne_m
    bearing = math.remainder(math.atan2(off[1], off[0]) - view_rad, math.tau)
    nearest_m = TUNED.strewn_share * water_reach_m
    return abs(bearing) < _VIEW_RAD and nearest_m < math.hypot(*off.tolist()) < TUNED.track_view_m


class CurrentEstimator:
    """Estimates the current from the vessel's drift across its heading, which its propulsion does not cause.

    Least squares with forgetting, from nothing known but that it is about as fast as rivers are.
    """

    def __init__(self) -> None:
        self.current_ne_mps: Array = np.zeros(2)
        self._covariance: Array = np.eye(2) * 0.5
        self._stamp_ns: int | None = None

    def update(self, stamp_ns: int, vel_ned_mps: Array, heading_rad: float, yaw_rate_radps: float) -> None:
        """Update by velocity over ground and heading; turns are left out."""
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
