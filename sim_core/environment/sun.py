"""Direction to the sun by place and time.

Low-precision formulas of the Astronomical Almanac (section C, "low-precision formulas for the Sun's coordinates"):
0.01 degrees from 1950 to 2050. Refraction near the horizon, up to half a degree, is left out.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np

from sim_core.frames import Array

_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


def sun_direction_ned(instant: datetime, latitude_deg: float, longitude_deg: float) -> Array:
    """Return the unit vector to the sun, (3,), at an instant with a time zone."""
    days = (instant - _J2000).total_seconds() / 86400.0
    anomaly_rad = math.radians(357.528 + 0.9856003 * days)
    longitude_rad = math.radians(
        280.460 + 0.9856474 * days + 1.915 * math.sin(anomaly_rad) + 0.020 * math.sin(2.0 * anomaly_rad)
    )
    obliquity_rad = math.radians(23.439 - 0.0000004 * days)
    ascension_rad = math.atan2(math.cos(obliquity_rad) * math.sin(longitude_rad), math.cos(longitude_rad))
    declination_rad = math.asin(math.sin(obliquity_rad) * math.sin(longitude_rad))
    sidereal_rad = math.radians(280.46062 + 360.98564737 * days + longitude_deg)  # IAU 1982, without its small terms
    hour_rad, latitude_rad = sidereal_rad - ascension_rad, math.radians(latitude_deg)
    north = math.cos(latitude_rad) * math.sin(declination_rad) - math.sin(latitude_rad) * math.cos(
        declination_rad
    ) * math.cos(hour_rad)
    east = -math.cos(declination_rad) * math.sin(hour_rad)
    up = math.sin(latitude_rad) * math.sin(declination_rad) + math.cos(latitude_rad) * math.cos(
        declination_rad
    ) * math.cos(hour_rad)
    return np.array([north, east, -up])
