"""Metres as ArduPilot counts them: those of a sphere.

A degree of latitude is the same number of metres everywhere, that of a sphere of 6378.1 km, and a degree of longitude
that times the cosine of the latitude midway (ArduPilot, AP_Common/Location). A degree of the ellipsoid is up to 0.7 %
shorter near the equator, 0.3 % longer near the poles: what ArduPilot calls 150 m north of its origin near the equator
is 149 m on the Earth.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Place = tuple[float, float, float]

M_PER_DEG = math.radians(6_378_100.0)


def ned_of(origin: Place, geodetic: Array) -> Array:
    """(N, 3) NED in ArduPilot's metres about `origin` of (N, 3) latitude, longitude (deg) and altitude (m)."""
    latitude, longitude, altitude = geodetic.T
    east_scale = np.cos(np.radians(0.5 * (latitude + origin[0])))
    turns = (longitude - origin[1] + 180.0) % 360.0 - 180.0
    return np.stack([(latitude - origin[0]) * M_PER_DEG, turns * M_PER_DEG * east_scale, origin[2] - altitude], axis=1)


def geodetic_of(origin: Place, ned_m: Array) -> Array:
    """(N, 3) latitude, longitude (deg) and altitude (m) of (N, 3) NED in ArduPilot's metres about `origin`."""
    latitude = origin[0] + ned_m[:, 0] / M_PER_DEG
    east_scale = np.cos(np.radians(0.5 * (latitude + origin[0])))
    longitude = origin[1] + ned_m[:, 1] / (M_PER_DEG * east_scale)
    return np.stack([latitude, longitude, origin[2] - ned_m[:, 2]], axis=1)
