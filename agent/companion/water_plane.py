"""Which points of a cloud the water returned: a plane through the low points close by, by trimmed least squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Points = NDArray[np.float32]

NEAR_M = 12.0
"""Water returns no light from farther away, at so flat an angle."""
CREST_M = 0.25
"""How far above the plane a return is still taken for a wave."""
LEAST = 50
_FITTED_M = 9.0
_HEIGHT_M = 1.5
"""Points no farther away, and up or down from the body's origin, are what the plane is looked for in: of the water they
are most wherever there is a plane to be found."""
_TRIMS_M = (0.5, 0.25, 0.15)
_STEEPEST = 0.4


class WaterPlane:
    """Remembers the last plane for clouds that show no water: down = a forward + b right + c in body FRD."""

    def __init__(self) -> None:
        self._plane: Array = np.zeros(3)
        self._fresh = False

    def of(self, points_frd_m: Points) -> NDArray[np.bool_]:
        """(n,) whether each of the points (n, 3) is of the water or under it."""
        range_m = np.linalg.norm(points_frd_m, axis=1)
        near = range_m < NEAR_M
        close = (range_m < _FITTED_M) & (np.abs(points_frd_m[:, 2]) < _HEIGHT_M)
        low = points_frd_m[close].astype(np.float64)
        self._fresh = False
        if len(low) >= LEAST:
            self._plane = self._fitted(low)
        elif not self._plane.any():
            return np.zeros(len(points_frd_m), dtype=np.bool_)
        a, b, c = self._plane.astype(np.float32)
        above_m = a * points_frd_m[:, 0] + b * points_frd_m[:, 1] + c - points_frd_m[:, 2]
        wet: NDArray[np.bool_] = near & (above_m < CREST_M)
        return wet

    @property
    def level(self) -> tuple[Array, float] | None:
        """Unit normal (3,) down, and how far along it the water is; None where the last cloud showed none."""
        if not self._fresh:
            return None
        a, b, c = self._plane.tolist()
        length = float(np.sqrt(a * a + b * b + 1.0))
        return np.array([-a, -b, 1.0]) / length, c / length

    def _fitted(self, low: Array) -> Array:
        """(3,) of the low points, or the last where they are on no plane that could be water."""
        plane = np.array([0.0, 0.0, float(np.median(low[:, 2]))])
        sides = np.column_stack([low[:, :2], np.ones(len(low))])
        chosen = np.ones(len(low), dtype=np.bool_)
        for trim_m in _TRIMS_M:
            plane = np.linalg.lstsq(sides[chosen], low[chosen, 2], rcond=None)[0]
            chosen = np.abs(low[:, 2] - sides @ plane) < trim_m
            if np.count_nonzero(chosen) < LEAST:
                return self._plane
        self._fresh = bool((np.abs(plane[:2]) < _STEEPEST).all())
        return plane if self._fresh else self._plane
