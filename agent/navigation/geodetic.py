"""Geodetic conversions: degrees to metres north and east of the estimator's origin and back, home, gravity."""

from __future__ import annotations

import math
from typing import NamedTuple

_EQUATORIAL_RADIUS_M = 6378137.0  # WGS 84
_ECCENTRICITY_SQUARED = 6.69437999014e-3
STANDARD_GRAVITY_MPS2 = 9.80665


def normal_gravity_mps2(lat_deg: float) -> float:
    """Gravity in m/s² on the WGS 84 ellipsoid (Somigliana)."""
    sin2 = math.sin(math.radians(lat_deg)) ** 2
    return 9.7803253359 * (1.0 + 1.931852652e-3 * sin2) / math.sqrt(1.0 - _ECCENTRICITY_SQUARED * sin2)


class Home(NamedTuple):
    """Position of arming or of the first fix, unless it was set."""

    lat_deg: float
    lon_deg: float
    alt_m: float


class LocalProjection:
    """Metres north and east of an origin, by the WGS 84 radii of curvature at that origin.

    The scale is constant, so the conversion is exactly invertible. Its error against the true tangent plane is a few
    centimetres at 1 km, far below the resolution of a GNSS receiver on a boat.
    """

    def __init__(self, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg
        self.alt_m = alt_m
        sin_lat = math.sin(math.radians(lat_deg))
        curvature = 1.0 - _ECCENTRICITY_SQUARED * sin_lat * sin_lat
        prime_vertical_m = _EQUATORIAL_RADIUS_M / math.sqrt(curvature)
        meridian_m = prime_vertical_m * (1.0 - _ECCENTRICITY_SQUARED) / curvature
        self._north_m_per_deg = math.radians(meridian_m + alt_m)
        # East is undefined within a hundredth of a degree of a pole. The floor only keeps the inverse finite.
        cos_lat = max(math.cos(math.radians(lat_deg)), 1e-4)
        self._east_m_per_deg = math.radians((prime_vertical_m + alt_m) * cos_lat)

    def to_local(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Metres (north, east) from the origin."""
        lon_difference_deg = (lon_deg - self.lon_deg + 180.0) % 360.0 - 180.0
        return (lat_deg - self.lat_deg) * self._north_m_per_deg, lon_difference_deg * self._east_m_per_deg

    def to_geodetic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Degrees (latitude, longitude)."""
        lon_deg = self.lon_deg + east_m / self._east_m_per_deg
        return self.lat_deg + north_m / self._north_m_per_deg, (lon_deg + 180.0) % 360.0 - 180.0


def position_problem(lat_deg: float, lon_deg: float) -> str:
    """Return the reason why a position is not a valid target, or an empty text."""
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        return f"position {lat_deg:g}, {lon_deg:g} is not on Earth; use degrees"
    return "position 0, 0 is not set" if lat_deg == 0.0 and lon_deg == 0.0 else ""
