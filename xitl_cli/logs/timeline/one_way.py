"""A line under readings that are late: delays have a floor, so the truth is their lower edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def lower_hull(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Vertices of the convex hull from below (Andrew's monotone chain); x increasing, of equal ones the lowest."""
    order = np.lexsort((y, x))
    xs, ys = x[order], y[order]
    first = np.ones(len(xs), dtype=np.bool_)
    first[1:] = xs[1:] != xs[:-1]
    hull: list[tuple[float, float]] = []
    for px, py in zip(xs[first].tolist(), ys[first].tolist(), strict=True):
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (x1 - x0) * (py - y0) > (y1 - y0) * (px - x0):
                break
            hull.pop()
        hull.append((px, py))
    points = np.array(hull, dtype=np.float64).reshape(-1, 2)
    return points[:, 0], points[:, 1]


def lower_line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope, and value at x = 0, of the line below all points with the least sum of distances to them.

    The linear programme of Moon, Skelly and Towsley (INFOCOM 1999): its solution is the edge of the lower hull over the
    mean of x.
    """
    hull_x, hull_y = lower_hull(x, y)
    if len(hull_x) < 2:
        return 0.0, float(hull_y[0])
    edge = int(np.clip(np.searchsorted(hull_x, np.mean(x)) - 1, 0, len(hull_x) - 2))
    slope = float((hull_y[edge + 1] - hull_y[edge]) / (hull_x[edge + 1] - hull_x[edge]))
    return slope, float(hull_y[edge] - slope * hull_x[edge])
