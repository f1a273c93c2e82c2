"""Obstacle detection: cells above the water, in the autopilot's local NED, and clusters of them.

Turbid water returns some light at short range. That range is learnt from the clouds. A ring around the lidar is water
if most directions have low points in it. The range ends at the last such ring. Within it, a point must be higher than
the waves. Beyond it, a return is not water, however low it seems: one degree of pitch is half a metre at 30 m.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.companion.pose_history import PoseHistory
from agent.companion.settings import TUNED

Array = NDArray[np.float64]

_KEY = 1 << 20  # one integer numbers the cells north and east of the origin
_SECTOR_RAD = math.radians(TUNED.reach_sector_deg)


class DetectionFrame(NamedTuple):
    """Cells hit by one cloud."""

    stamp_ns: int
    cells: NDArray[np.int64]
    """(k,)."""
    points_ne_m: Array
    """(k, 2), means over each cell."""
    top_m: Array
    """(k,), highest point of each cell."""
    hits: NDArray[np.int64]
    """(k,), number of points."""
    bright: NDArray[np.int64]
    """(k,), number of points that are brighter than water."""


class ObstacleDetector:
    """Detects obstacles. Pass each cloud to `add_cloud`. `frames` are those of the last `window_s`, oldest first."""

    def __init__(self, range_m: float, waterline_m: float, window_s: float = 0.8) -> None:
        self.frames: deque[DetectionFrame] = deque()
        self.refused = 0  # points that are not finite
        self.unplaced = 0  # clouds without a pose
        self.early = 0  # those of them before the first pose
        self.water_reach_m = TUNED.reach_initial_m
        self.stands_out_m = TUNED.stands_out_m
        self._range_m = range_m
        self.waterline_m = waterline_m
        self._window_ns = round(window_s * 1e9)
        self._low = np.zeros((TUNED.reach_rings, TUNED.reach_sectors))
        self._spread_m = 0.05
        self._learnt = 0
        self._level_m: float | None = None  # down position of the vessel's origin, mean of the last seconds
        self._level_ns = 0

    def add_cloud(
        self,
        history: PoseHistory,
        stamp_ns: int,
        points_frd_m: NDArray[np.float32],
        offset_s: NDArray[np.float32],
        intensity: NDArray[np.uint8],
    ) -> bool:
        """Add a cloud. intensity: (n,) reflectivity. Return False when its pose is unknown."""
        good = np.isfinite(points_frd_m).all(axis=1) & np.isfinite(offset_s)
        good_count = int(np.count_nonzero(good))
        if good_count < len(good):
            self.refused += len(good) - good_count
            points_frd_m, offset_s, intensity = points_frd_m[good], offset_s[good], intensity[good]
        points = points_frd_m.astype(np.float64)
        range_m = np.hypot(points[:, 0], points[:, 1])
        near = (range_m > TUNED.detect_nearest_m) & (range_m < self._range_m)
        points, range_m, intensity = points[near], range_m[near], intensity[near]
        placed = self._placed(history, stamp_ns, points, offset_s[near].astype(np.float64))
        if placed is None:
            self.unplaced += 1
            self.early += self._level_m is None
            return False
        ned_m, height_m = placed

        # The level expected from the vessel's height drifts by more than the waves: use that of the nearby water.
        low = (range_m < TUNED.water_fit_range_m) & (np.abs(height_m) < TUNED.reach_low_m)
        if np.count_nonzero(low) >= TUNED.water_points:
            height_m -= float(np.median(height_m[low]))
        self._learn(points, range_m, height_m)
        # Points that are brighter than water, which has the median intensity of the low points.
        wet = range_m < self.water_reach_m
        low = wet & (np.abs(height_m) < TUNED.reach_low_m)
        bright = np.zeros(len(range_m), dtype=np.bool_)
        if np.count_nonzero(low) >= TUNED.bright_points:
            bright = intensity.astype(np.float64) >= float(np.median(intensity[low])) + TUNED.bright_step
            bright &= range_m > TUNED.bright_nearest_m
        # Keep the points that are no water.
        stands = np.where(wet, (height_m > self.stands_out_m) | bright, height_m > TUNED.detect_lowest_m)
        stands &= height_m < TUNED.detect_highest_m
        self._keep(stamp_ns, ned_m[stands], height_m[stands], bright[stands])
        return True

    def _placed(
        self, history: PoseHistory, stamp_ns: int, points: Array, offset_s: Array
    ) -> tuple[Array, Array] | None:
        """Return the points at their own instants: NED (n, 3), and height above the mean water (n,)."""
        last_s = float(offset_s.max()) if len(offset_s) else 0.0
        knots_s = np.linspace(0.0, max(last_s, 1e-3), TUNED.detect_knots)
        poses = [history.pose_at(stamp_ns + round(float(s) * 1e9)) for s in knots_s]
        if any(pose is None for pose in poses):
            return None
        known = [pose for pose in poses if pose is not None]
        level_m = self._level(float(known[0].pos_ned_m[2]), stamp_ns)
        at = np.clip(offset_s / knots_s[-1] * (TUNED.detect_knots - 1), 0.0, TUNED.detect_knots - 1 - 1e-9)
        first = at.astype(np.int64)
        share = (at - first)[:, None]
        ned_m = np.empty_like(points)
        for knot in range(TUNED.detect_knots - 1):
            here = first == knot
            if not here.any():
                continue
            part, along = points[here], share[here]
            before = part @ known[knot].rot_ned_frd.T + known[knot].pos_ned_m
            after = part @ known[knot + 1].rot_ned_frd.T + known[knot + 1].pos_ned_m
            ned_m[here] = before + (after - before) * along
        return ned_m, level_m + self.waterline_m - ned_m[:, 2]

    def _level(self, down_m: float, stamp_ns: int) -> float:
        """Return the mean down position of the floating vessel.

        The estimated height drifts over minutes; heave lasts seconds.
        """
        if self._level_m is None:
            self._level_m = down_m
        share = min(max((stamp_ns - self._level_ns) * 1e-9 / TUNED.float_level_s, 0.0), 1.0)
        self._level_ns = stamp_ns
        self._level_m += share * (down_m - self._level_m)
        self._level_m = min(max(self._level_m, down_m - TUNED.float_level_off_m), down_m + TUNED.float_level_off_m)
        return self._level_m

    def _learn(self, points: Array, range_m: Array, height_m: Array) -> None:
        """Learn the range at which water returns light, and the height of its waves."""
        rings, sectors = TUNED.reach_rings, TUNED.reach_sectors
        low = (range_m < rings) & (np.abs(height_m) < TUNED.reach_low_m)
        ring = range_m[low].astype(np.intp)
        sector = np.floor(np.arctan2(points[low, 1], points[low, 0]) / _SECTOR_RAD).astype(np.intp) + sectors // 2
        seen = (sector >= 0) & (sector < sectors)
        now = np.bincount(ring[seen] * sectors + sector[seen], minlength=rings * sectors)
        self._low = self._low * TUNED.reach_forget_gain + now.reshape(rings, sectors)
        watery = np.count_nonzero(self._low > TUNED.reach_count, axis=1) > TUNED.reach_wet_share * sectors
        reach = dry = 0
        for number in range(3, rings):
            dry = 0 if watery[number] else dry + 1
            if dry > 2:
                break
            reach = number + 1 if watery[number] else reach
        self._learnt += 1
        least_m = 5.0 if self._learnt > TUNED.reach_learnt_clouds else TUNED.reach_initial_m
        reach_m = max(reach + TUNED.reach_beyond_m, least_m)
        reach_m = min(reach_m, self.water_reach_m + TUNED.reach_grow_m)
        self.water_reach_m = max(reach_m, self.water_reach_m - TUNED.reach_shrink_m)
        close = height_m[low & (range_m < self.water_reach_m)]
        if len(close) > 30:
            spread_m = 1.4826 * float(np.median(np.abs(close - np.median(close))))
            self._spread_m += 0.05 * (spread_m - self._spread_m)
        self.stands_out_m = TUNED.stands_out_m + 2.5 * self._spread_m

    def _keep(self, stamp_ns: int, ned_m: Array, height_m: Array, is_bright: NDArray[np.bool_]) -> None:
        cells, where, count = np.unique(cells_of(ned_m), return_inverse=True, return_counts=True)
        points = np.empty((len(cells), 2))
        for axis in (0, 1):
            points[:, axis] = np.bincount(where, weights=ned_m[:, axis], minlength=len(cells)) / np.maximum(count, 1)
        top_m = np.full(len(cells), -np.inf)
        np.maximum.at(top_m, where, height_m)
        bright = np.bincount(where[is_bright], minlength=len(cells))
        self.frames.append(DetectionFrame(stamp_ns, cells, points, top_m, count, bright))
        while self.frames and stamp_ns - self.frames[0].stamp_ns > self._window_ns:
            self.frames.popleft()


def cells_of(points_m: Array, cell_m: float = TUNED.cell_m) -> NDArray[np.int64]:
    """Cell number of each point (n, 2 or more: north and east first)."""
    north, east = (np.floor(points_m[:, axis] / cell_m).astype(np.int64) for axis in (0, 1))
    numbers: NDArray[np.int64] = north * _KEY + east
    return numbers


def neighbours(cell: int) -> tuple[int, ...]:
    """Return the eight cells around a cell."""
    return (
        cell - _KEY - 1, cell - _KEY, cell - _KEY + 1, cell - 1,
        cell + 1, cell + _KEY - 1, cell + _KEY, cell + _KEY + 1,
    )  # fmt: skip


class Cluster(NamedTuple):
    """Cells that belong to one object."""

    stamp_ns: int
    """Mean instant of its points."""
    points_ne_m: Array
    """(k, 2) of its cells."""
    middle_ne_m: Array
    """(2,), centre of the box."""
    length_m: float
    """Along `heading_rad`."""
    width_m: float
    """Across `heading_rad`."""
    height_m: float
    heading_rad: float
    points: int
    """Number of points in the newest frame."""
    bright: int = 0
    """Number of points of all frames that are brighter than water."""


def find_clusters(frames: Sequence[DetectionFrame], pos_ne_m: Array, doubtful_m: float) -> list[Cluster]:
    """Return the clusters of the frames, in any order. Cells that too few frames saw are omitted.

    Wave crests may glint within doubtful_m of pos_ne_m (2,). Clusters with few points are omitted there too.
    """
    if not frames:
        return []
    cells = np.concatenate([frame.cells for frame in frames])
    if not len(cells):
        return []
    points = np.concatenate([frame.points_ne_m for frame in frames])
    top_m = np.concatenate([frame.top_m for frame in frames])
    count = np.concatenate([frame.hits for frame in frames])
    bright = np.concatenate([frame.bright for frame in frames])
    origin_ns = frames[0].stamp_ns
    age_s = np.concatenate([np.full(len(frame.cells), (frame.stamp_ns - origin_ns) * 1e-9) for frame in frames])
    number = np.concatenate([np.full(len(frame.cells), index) for index, frame in enumerate(frames)])
    newest = len(frames) - 1
    label = _labels(cells_of(points, TUNED.cluster_join_m))
    order = np.argsort(label, kind="stable")
    bounds = np.flatnonzero(np.diff(label[order])) + 1
    clusters: list[Cluster] = []
    for members in np.split(order, bounds):
        total = int(count[members].sum())
        if total < TUNED.cluster_points or len(np.unique(number[members])) < min(TUNED.cluster_frames, len(frames)):
            continue
        stamp_ns = origin_ns + round(float(np.average(age_s[members], weights=count[members])) * 1e9)
        middle, length_m, width_m, heading_rad = _box(points[members])
        near = math.hypot(*(middle - pos_ne_m).tolist()) < doubtful_m
        if near and total < TUNED.cluster_points_per_m * (1.0 + length_m):
            continue
        _, one_each = np.unique(cells[members], return_index=True)
        outline = points[members][one_each]
        latest = int(count[members][number[members] == newest].sum())
        clusters.append(
            Cluster(
                stamp_ns,
                outline,
                middle,
                length_m,
                width_m,
                max(float(top_m[members].max()), 0.05),
                heading_rad,
                latest,
                int(bright[members].sum()),
            )
        )
    return clusters


def merged_cluster(parts: Sequence[Cluster]) -> Cluster:
    """Merge clusters that belong to one object."""
    points = np.concatenate([part.points_ne_m for part in parts])
    middle, length_m, width_m, heading_rad = _box(points)
    shares = np.array([len(part.points_ne_m) for part in parts]) / len(points)
    first_ns = parts[0].stamp_ns
    stamp_ns = first_ns + round(float(shares @ [part.stamp_ns - first_ns for part in parts]))
    return Cluster(
        stamp_ns, points, middle, length_m, width_m, max(part.height_m for part in parts), heading_rad,
        sum(part.points for part in parts), sum(part.bright for part in parts),
    )  # fmt: skip


def _labels(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cluster number of each cell. Adjacent cells have the same number."""
    unique, where = np.unique(cells, return_inverse=True)
    numbers = {cell: index for index, cell in enumerate(unique.tolist())}
    label = [-1] * len(unique)
    for start, first in enumerate(unique.tolist()):
        if label[start] >= 0:
            continue
        label[start] = start
        waiting = [first]
        while waiting:
            for beside in neighbours(waiting.pop()):
                index = numbers.get(beside)
                if index is not None and label[index] < 0:
                    label[index] = start
                    waiting.append(beside)
    labels: NDArray[np.int64] = np.asarray(label)[where]
    return labels


def _box(points: Array) -> tuple[Array, float, float, float]:
    """Box along the principal axis of the points: middle (2,), length, width, heading."""
    mean = points.mean(axis=0)
    off = points - mean
    covariance = off.T @ off / max(len(points), 1)
    heading_rad = 0.5 * math.atan2(2.0 * covariance[0, 1], covariance[0, 0] - covariance[1, 1])
    along = np.array((math.cos(heading_rad), math.sin(heading_rad)))
    across = np.array((-along[1], along[0]))
    forward, right = off @ along, off @ across
    low_f, high_f, low_r, high_r = float(forward.min()), float(forward.max()), float(right.min()), float(right.max())
    middle = mean + along * (0.5 * (low_f + high_f)) + across * (0.5 * (low_r + high_r))
    floor_m = 0.5 * TUNED.cell_m
    return middle, max(high_f - low_f, floor_m), max(high_r - low_r, floor_m), heading_rad % math.pi
