"""Separation of the points that water returned: a plane through the low points at short range, by trimmed least
squares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.companion.settings import TUNED

Array = NDArray[np.float64]
Points = NDArray[np.float32]
Mask = NDArray[np.bool_]


class WaterLevel(NamedTuple):
    """Water level in body axes at a cloud's end."""

    normal_frd: Array
    """(3,) unit normal, down."""
    down_m: float
    """Distance along the normal."""
    turn_frd_radps: Array
    """(3,): rotation rate of the body against the water, without yaw information."""


class WaterPlane:
    """Plane of the water: down = a forward + b right + c in body FRD.

    Within a cloud, a, b and c are linear in time.

    A boat of some metres rolls within a second. A cloud of 0.1 s covers a tenth of the swing, and its water shows the
    rate. The last plane is stored for clouds without water.
    """

    def __init__(self) -> None:
        self._plane: Array = np.zeros(6)
        self._height_m: float | None = None
        self.level: WaterLevel | None = None

    def water_mask(self, points_frd_m: Points, lag_s: Points) -> NDArray[np.bool_]:
        """(n,) whether each of the points (n, 3), taken lag_s (n,) after the cloud's end, is water or below it.

        lag_s is at most 0. `level` is set to the water level of this cloud, None if it shows no water.
        """
        squared = np.einsum("ij,ij->i", points_frd_m, points_frd_m)
        near = squared < TUNED.water_near_m**2
        close = (squared < TUNED.water_fit_range_m**2) & (np.abs(points_frd_m[:, 2]) < TUNED.water_fit_height_m)
        self.level = None
        self._plane[3:] = 0.0  # the rotation in an earlier cloud does not apply to this one
        if np.count_nonzero(close) >= TUNED.water_points:
            self._fit(_sides(points_frd_m[close], lag_s[close]), points_frd_m[close, 2])
        elif not self._plane.any():
            return np.zeros(len(points_frd_m), dtype=np.bool_)
        wet: NDArray[np.bool_] = near.copy()
        above_m = _sides(points_frd_m[near], lag_s[near]) @ self._plane.astype(np.float32) - points_frd_m[near, 2]
        wet[near] = above_m < TUNED.water_crest_m
        return wet

    def crest_mask(
        self, points_frd_m: Points, lag_s: Points, down_frd: Array, rate_frd_radps: Array
    ) -> NDArray[np.bool_]:
        """(n,) which of these points are wave crests beyond water_near_m. down_frd, rate_frd_radps: (3,)."""
        if self.level is not None:
            before_m = self.level.down_m if self._height_m is None else self._height_m
            self._height_m = before_m + TUNED.water_height_share * (self.level.down_m - before_m)
        squared = np.einsum("ij,ij->i", points_frd_m, points_frd_m)
        far: NDArray[np.bool_] = (squared >= TUNED.water_near_m**2) & (squared < TUNED.water_far_m**2)
        if self._height_m is None:
            return np.zeros(len(far), dtype=np.bool_)
        points, lag = points_frd_m[far].astype(np.float64), lag_s[far].astype(np.float64)
        down_m = points @ down_frd + lag * (points @ np.cross(down_frd, rate_frd_radps))
        far[far] = self._height_m - down_m < TUNED.water_far_crest_m
        return far

    def _fit(self, sides: Points, down_m: Points) -> None:
        """Fit the low points. Keep the last plane if they form no plane that could be water."""
        plane = np.zeros(6)
        chosen = np.ones(len(down_m), dtype=np.bool_)
        for trim_m in TUNED.water_trims_m:
            # Least squares. Undetermined parameters are nearly zero.
            fitted, low_m = sides[chosen], down_m[chosen]
            normal_matrix = (fitted.T @ fitted).astype(np.float64) + np.diag([1e-6] * 3 + [1e-3] * 3)
            plane = np.linalg.solve(normal_matrix, (fitted.T @ low_m).astype(np.float64)).astype(np.float64)
            chosen = np.abs(down_m - sides @ plane.astype(np.float32)) < trim_m
            if np.count_nonzero(chosen) < TUNED.water_points:
                return
        if not (np.abs(plane[:2]) < TUNED.water_slope).all():
            return
        a, b, c, a_rate, b_rate, _ = plane.tolist()
        length = float(np.sqrt(a * a + b * b + 1.0))
        normal = np.array([-a, -b, 1.0]) / length
        # normal x turn is the rate of the normal of a static level in the body
        moving = np.array([-a_rate, -b_rate, 0.0]) / length
        moving -= normal * (normal @ moving)
        self._plane = plane
        self.level = WaterLevel(normal, c / length, np.cross(moving, normal))


def _sides(points_frd_m: Points, lag_s: Points) -> Points:
    """Factors (n, 6) of a plane's parameters and of their rates."""
    sides = np.empty((len(lag_s), 6), dtype=np.float32)
    sides[:, :2] = points_frd_m[:, :2]
    sides[:, 2] = 1.0
    np.multiply(sides[:, :3], lag_s[:, None], out=sides[:, 3:])
    return sides
