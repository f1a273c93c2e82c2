"""Where both went, whenever: the distance of one path from the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BLOCK = 250_000


def off_path_m(points: Array, path: Array) -> Array:
    """(N,) distance (m) of points (N, 2) from the line through path (M, 2), M at least 1."""
    if len(path) == 1:
        alone: Array = np.linalg.norm(points - path[0], axis=1)
        return alone
    begins, along = path[:-1], np.diff(path, axis=0)
    lengths = np.maximum(np.sum(along**2, axis=1), 1e-12)
    found = np.empty(len(points))
    block = max(1, _BLOCK // len(begins))
    for first in range(0, len(points), block):
        east, north = (points[first : first + block, axis, None] - begins[:, axis] for axis in (0, 1))
        share = np.clip((east * along[:, 0] + north * along[:, 1]) / lengths, 0.0, 1.0)
        squared = (east - share * along[:, 0]) ** 2 + (north - share * along[:, 1]) ** 2
        found[first : first + block] = np.sqrt(squared.min(axis=1))
    return found


def thinned(path: Array, least_m: float = 0.05, most: int = 2000) -> Array:
    """Points at least so far from the one before, and no more than `most`: a vessel at rest adds none."""
    steps = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    every_m = max(least_m, float(steps[-1]) / most)
    chosen = np.searchsorted(steps, np.arange(0.0, steps[-1], every_m))
    found: Array = path[np.unique(np.append(chosen, len(path) - 1))]
    return found
