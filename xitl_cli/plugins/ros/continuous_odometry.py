"""The frame `odom` according to REP 105: continuous for the vessel, while corrections move `odom` in `map`."""

from __future__ import annotations

import numpy as np
from numpy import float64
from numpy.typing import NDArray

Array = NDArray[float64]


class ContinuousOdometry:
    """Integrates the velocity of an estimate with jumps of its corrected position.

    The position drifts from that of the estimate without bound, and never jumps. The axes of `odom` are those of `map`.
    origin_map_m: position of `odom` in `map` (3,), ENU; zero at first.
    """

    def __init__(self) -> None:
        self.origin_map_m: Array = np.zeros(3)
        self._place_odom_m: Array | None = None
        self._velocity_mps: Array = np.zeros(3)
        self._stamp_ns = 0

    def update(self, stamp_ns: int, place_map_m: Array, velocity_map_mps: Array) -> Array:
        """Return the position in `odom` (3,) at an instant later than the last, from estimates in `map`, both ENU (3,).

        An estimate that is not finite changes nothing.
        """
        last = place_map_m if self._place_odom_m is None else self._place_odom_m
        if not (np.isfinite(place_map_m).all() and np.isfinite(velocity_map_mps).all()):
            return last
        if self._place_odom_m is None:
            place_odom_m = place_map_m
        else:
            dt_s = (stamp_ns - self._stamp_ns) * 1e-9
            place_odom_m = last + 0.5 * dt_s * (self._velocity_mps + velocity_map_mps)
        self._stamp_ns, self._place_odom_m, self._velocity_mps = stamp_ns, place_odom_m, velocity_map_mps
        self.origin_map_m = place_map_m - place_odom_m
        return place_odom_m


def rotated(wxyz: tuple[float, float, float, float], vector: Array) -> Array:
    """Rotate a vector (3,) by a unit quaternion."""
    axis = np.array(wxyz[1:])
    across = 2.0 * np.cross(axis, vector)
    return vector + wxyz[0] * across + np.cross(axis, across)
