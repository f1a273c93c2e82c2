"""What was hit in the last second, gathered into things."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.companion.sighting import CELL_M, Frame, cells_of, neighbours

Array = NDArray[np.float64]

_JOIN_M = 1.0  # cells of this size that touch belong together
_FRAMES = 2  # a cell seen in one frame alone is a drop of spray or a gleam
_POINTS = 3
_POINTS_A_METRE = 5.0


class Cluster(NamedTuple):
    """One thing. points_ne_m (k, 2) of its cells, stamp_ns the mean of its points' instants.

    length_m lies along heading_rad, width_m across; middle_ne_m (2,) of that box. `points` in the newest frame;
    `bright`: of all frames' points those that are brighter than water.
    """

    stamp_ns: int
    points_ne_m: Array
    middle_ne_m: Array
    length_m: float
    width_m: float
    height_m: float
    heading_rad: float
    points: int
    bright: int = 0


def clusters(frames: Sequence[Frame], pos_ne_m: Array, doubtful_m: float) -> list[Cluster]:
    """Things among the frames, any order. What too few frames saw is left out.

    Nearer to pos_ne_m (2,) than doubtful_m a crest may gleam now and then: what is thinly strewn there is left out too.
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
    label = _labels(cells_of(points, _JOIN_M))
    order = np.argsort(label, kind="stable")
    bounds = np.flatnonzero(np.diff(label[order])) + 1
    found: list[Cluster] = []
    for members in np.split(order, bounds):
        total = int(count[members].sum())
        if total < _POINTS or len(np.unique(number[members])) < min(_FRAMES, len(frames)):
            continue
        stamp_ns = origin_ns + round(float(np.average(age_s[members], weights=count[members])) * 1e9)
        middle, length_m, width_m, heading_rad = _box(points[members])
        near = math.hypot(*(middle - pos_ne_m).tolist()) < doubtful_m
        if near and total < _POINTS_A_METRE * (1.0 + length_m):
            continue
        _, one_each = np.unique(cells[members], return_index=True)
        outline = points[members][one_each]
        latest = int(count[members][number[members] == newest].sum())
        found.append(
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
    return found


def _labels(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of the thing that each cell belongs to: cells that touch belong together."""
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
    """The box along the principal axis of the points: middle (2,), length, width, heading."""
    mean = points.mean(axis=0)
    off = points - mean
    covariance = off.T @ off / max(len(points), 1)
    heading_rad = 0.5 * math.atan2(2.0 * covariance[0, 1], covariance[0, 0] - covariance[1, 1])
    along = np.array((math.cos(heading_rad), math.sin(heading_rad)))
    across = np.array((-along[1], along[0]))
    forward, right = off @ along, off @ across
    low_f, high_f, low_r, high_r = float(forward.min()), float(forward.max()), float(right.min()), float(right.max())
    middle = mean + along * (0.5 * (low_f + high_f)) + across * (0.5 * (low_r + high_r))
    floor_m = 0.5 * CELL_M
    return middle, max(high_f - low_f, floor_m), max(high_r - low_r, floor_m), heading_rad % math.pi
