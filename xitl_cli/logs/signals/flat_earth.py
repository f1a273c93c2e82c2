"""Metres of a world that ArduPilot's own simulator made.

It counts the same metres for a degree of latitude everywhere, those of a sphere of 6378.1 km (AP_Common/Location); a
degree of the ellipsoid is up to 0.7 % shorter near the equator and 0.3 % longer near the poles. What such a world calls
a metre is found back only by its own count; a receiver on the real Earth is not concerned.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from xitl_cli.logs.signals.series import Series

Array = NDArray[np.float64]

_M_PER_DEG = math.radians(6_378_100.0)
_STILL_M = 5.0
_NEAR_SHARE = 0.02


def flat_ned(origin: tuple[float, float, float], geodetic: Array) -> Array:
    """(N, 3) metres about `origin` of latitude and longitude (deg) and altitude (m), (N, 3), as ArduPilot counts."""
    latitude, longitude, altitude = geodetic.T
    east_scale = np.cos(np.radians(0.5 * (latitude + origin[0])))
    turns = (longitude - origin[1] + 180.0) % 360.0 - 180.0
    return np.stack(
        [(latitude - origin[0]) * _M_PER_DEG, turns * _M_PER_DEG * east_scale, origin[2] - altitude], axis=1
    )


def is_of_its_world(told: Series, simulated: Series) -> bool:
    """Whether the place that a log tells is the one its simulator moved (SIM), by and large.

    Where the senses come from elsewhere the simulated vehicle stands still, or is driven by the same outputs to another
    place.
    """
    origin = (*map(float, simulated.values[0]),)
    true_m = flat_ned((origin[0], origin[1], origin[2]), simulated.values)[:, :2]
    extent_m = float(np.hypot(*np.ptp(true_m, axis=0)))
    if extent_m < _STILL_M:
        return False
    at = simulated.at(told.stamp_ns)
    known = np.isfinite(at).all(axis=1)
    if not known.any():
        return False
    apart = flat_ned((origin[0], origin[1], origin[2]), told.values[known]) - flat_ned(
        (origin[0], origin[1], origin[2]), at[known]
    )
    return float(np.median(np.hypot(apart[:, 0], apart[:, 1]))) < _NEAR_SHARE * extent_m
