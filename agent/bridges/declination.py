"""Magnetic declination from the World Magnetic Model, as built into an inertial navigation unit.

Model and coefficients: WMM2025, NOAA and British Geological Survey (public domain), valid for 2025 to 2030. A year
outside this range uses the nearest end. The equations follow the technical report of the model (section 1.2): Schmidt
semi-normalised associated Legendre functions in geocentric coordinates. The result is rotated to the ellipsoid normal.
"""

from __future__ import annotations

import math

_EQUATORIAL_RADIUS_M = 6378137.0  # WGS 84
_ECCENTRICITY_SQUARED = 6.69437999014e-3
_REFERENCE_RADIUS_M = 6371200.0
_EPOCH, _LAST_YEAR = 2025.0, 2030.0
_DEGREE = 12


def declination_rad(lat_deg: float, lon_deg: float, alt_m: float, year: float) -> float:
    """Angle from true to magnetic north, east positive. Meaningless near the magnetic poles."""
    north, east = horizontal_field_nt(lat_deg, lon_deg, alt_m, year)
    return math.atan2(east, north)


def horizontal_field_nt(lat_deg: float, lon_deg: float, alt_m: float, year: float) -> tuple[float, float]:
    """North and east components of the field."""
    age_years = min(max(year, _EPOCH), _LAST_YEAR) - _EPOCH
    lat, lon = math.radians(min(max(lat_deg, -89.99), 89.99)), math.radians(lon_deg)
    sin_lat, cos_lat = math.sin(lat), math.cos(lat)
    prime_vertical_m = _EQUATORIAL_RADIUS_M / math.sqrt(1.0 - _ECCENTRICITY_SQUARED * sin_lat * sin_lat)
    axis_m = (prime_vertical_m + alt_m) * cos_lat
    up_m = (prime_vertical_m * (1.0 - _ECCENTRICITY_SQUARED) + alt_m) * sin_lat
    radius_m = math.hypot(axis_m, up_m)
    sin_geocentric, cos_geocentric = up_m / radius_m, axis_m / radius_m
    legendre, slope = _legendre(sin_geocentric, cos_geocentric)
    north = east = down = 0.0
    ratio = _REFERENCE_RADIUS_M / radius_m
    for n, m, g, h, g_per_year, h_per_year in _COEFFICIENTS:
        g += age_years * g_per_year
        h += age_years * h_per_year
        c, s = math.cos(m * lon), math.sin(m * lon)
        scale = ratio ** (n + 2)
        north -= scale * (g * c + h * s) * slope[n][m]
        east += scale * m * (g * s - h * c) * legendre[n][m] / cos_geocentric
        down -= scale * (n + 1) * (g * c + h * s) * legendre[n][m]
    tilt = math.atan2(sin_geocentric, cos_geocentric) - lat
    return north * math.cos(tilt) - down * math.sin(tilt), east


def _legendre(sin_lat: float, cos_lat: float) -> tuple[list[list[float]], list[list[float]]]:
    """Schmidt semi-normalised functions by degree and order, and their derivatives with respect to latitude."""
    p = [[0.0] * (_DEGREE + 1) for _ in range(_DEGREE + 1)]
    d = [[0.0] * (_DEGREE + 1) for _ in range(_DEGREE + 1)]
    p[0][0] = 1.0
    for n in range(1, _DEGREE + 1):
        for m in range(n + 1):
            if m == n:
                k = math.sqrt(1.0 - 0.5 / n) if n > 1 else 1.0
                p[n][n] = k * cos_lat * p[n - 1][n - 1]
                d[n][n] = k * (cos_lat * d[n - 1][n - 1] - sin_lat * p[n - 1][n - 1])
                continue
            root = math.sqrt(n * n - m * m)
            before = math.sqrt((n - 1) ** 2 - m * m) if n - 1 > m else 0.0
            p[n][m] = ((2 * n - 1) * sin_lat * p[n - 1][m] - before * p[n - 2][m]) / root
            slope = (2 * n - 1) * (sin_lat * d[n - 1][m] + cos_lat * p[n - 1][m])
            d[n][m] = (slope - before * d[n - 2][m]) / root
    return p, d


# n, m, g nT, h nT, g nT/year, h nT/year
_COEFFICIENTS: tuple[tuple[int, int, float, float, float, float], ...] = (
    (1, 0, -29351.8, 0.0, 12.0, 0.0), (1, 1, -1410.8, 4545.4, 9.7, -21.5), (2, 0, -2556.6, 0.0, -11.6, 0.0),
    (2, 1, 2951.1, -3133.6, -5.2, -27.7), (2, 2, 1649.3, -815.1, -8.0, -12.1), (3, 0, 1361.0, 0.0, -1.3, 0.0),
    (3, 1, -2404.1, -56.6, -4.2, 4.0), (3, 2, 1243.8, 237.5, 0.4, -0.3), (3, 3, 453.6, -549.5, -15.6, -4.1),
    (4, 0, 895.0, 0.0, -1.6, 0.0), (4, 1, 799.5, 278.6, -2.4, -1.1), (4, 2, 55.7, -133.9, -6.0, 4.1),
    (4, 3, -281.1, 212.0, 5.6, 1.6), (4, 4, 12.1, -375.6, -7.0, -4.4), (5, 0, -233.2, 0.0, 0.6, 0.0),
    (5, 1, 368.9, 45.4, 1.4, -0.5), (5, 2, 187.2, 220.2, 0.0, 2.2), (5, 3, -138.7, -122.9, 0.6, 0.4),
    (5, 4, -142.0, 43.0, 2.2, 1.7), (5, 5, 20.9, 106.1, 0.9, 1.9), (6, 0, 64.4, 0.0, -0.2, 0.0),
    (6, 1, 63.8, -18.4, -0.4, 0.3), (6, 2, 76.9, 16.8, 0.9, -1.6), (6, 3, -115.7, 48.8, 1.2, -0.4),
    (6, 4, -40.9, -59.8, -0.9, 0.9), (6, 5, 14.9, 10.9, 0.3, 0.7), (6, 6, -60.7, 72.7, 0.9, 0.9),
    (7, 0, 79.5, 0.0, -0.0, 0.0), (7, 1, -77.0, -48.9, -0.1, 0.6), (7, 2, -8.8, -14.4, -0.1, 0.5),
    (7, 3, 59.3, -1.0, 0.5, -0.8), (7, 4, 15.8, 23.4, -0.1, 0.0), (7, 5, 2.5, -7.4, -0.8, -1.0),
    (7, 6, -11.1, -25.1, -0.8, 0.6), (7, 7, 14.2, -2.3, 0.8, -0.2), (8, 0, 23.2, 0.0, -0.1, 0.0),
    (8, 1, 10.8, 7.1, 0.2, -0.2), (8, 2, -17.5, -12.6, 0.0, 0.5), (8, 3, 2.0, 11.4, 0.5, -0.4),
    (8, 4, -21.7, -9.7, -0.1, 0.4), (8, 5, 16.9, 12.7, 0.3, -0.5), (8, 6, 15.0, 0.7, 0.2, -0.6),
    (8, 7, -16.8, -5.2, -0.0, 0.3), (8, 8, 0.9, 3.9, 0.2, 0.2), (9, 0, 4.6, 0.0, -0.0, 0.0),
    (9, 1, 7.8, -24.8, -0.1, -0.3), (9, 2, 3.0, 12.2, 0.1, 0.3), (9, 3, -0.2, 8.3, 0.3, -0.3),
    (9, 4, -2.5, -3.3, -0.3, 0.3), (9, 5, -13.1, -5.2, 0.0, 0.2), (9, 6, 2.4, 7.2, 0.3, -0.1),
    (9, 7, 8.6, -0.6, -0.1, -0.2), (9, 8, -8.7, 0.8, 0.1, 0.4), (9, 9, -12.9, 10.0, -0.1, 0.1),
    (10, 0, -1.3, 0.0, 0.1, 0.0), (10, 1, -6.4, 3.3, 0.0, 0.0), (10, 2, 0.2, 0.0, 0.1, -0.0),
    (10, 3, 2.0, 2.4, 0.1, -0.2), (10, 4, -1.0, 5.3, -0.0, 0.1), (10, 5, -0.6, -9.1, -0.3, -0.1),
    (10, 6, -0.9, 0.4, 0.0, 0.1), (10, 7, 1.5, -4.2, -0.1, 0.0), (10, 8, 0.9, -3.8, -0.1, -0.1),
    (10, 9, -2.7, 0.9, -0.0, 0.2), (10, 10, -3.9, -9.1, -0.0, -0.0), (11, 0, 2.9, 0.0, 0.0, 0.0),
    (11, 1, -1.5, 0.0, -0.0, -0.0), (11, 2, -2.5, 2.9, 0.0, 0.1), (11, 3, 2.4, -0.6, 0.0, -0.0),
    (11, 4, -0.6, 0.2, 0.0, 0.1), (11, 5, -0.1, 0.5, -0.1, -0.0), (11, 6, -0.6, -0.3, 0.0, -0.0),
    (11, 7, -0.1, -1.2, -0.0, 0.1), (11, 8, 1.1, -1.7, -0.1, -0.0), (11, 9, -1.0, -2.9, -0.1, 0.0),
    (11, 10, -0.2, -1.8, -0.1, 0.0), (11, 11, 2.6, -2.3, -0.1, 0.0), (12, 0, -2.0, 0.0, 0.0, 0.0),
    (12, 1, -0.2, -1.3, 0.0, -0.0), (12, 2, 0.3, 0.7, -0.0, 0.0), (12, 3, 1.2, 1.0, -0.0, -0.1),
    (12, 4, -1.3, -1.4, -0.0, 0.1), (12, 5, 0.6, -0.0, -0.0, -0.0), (12, 6, 0.6, 0.6, 0.1, -0.0),
    (12, 7, 0.5, -0.1, -0.0, -0.0), (12, 8, -0.1, 0.8, 0.0, 0.0), (12, 9, -0.4, 0.1, 0.0, -0.0),
    (12, 10, -0.2, -1.0, -0.1, -0.0), (12, 11, -1.3, 0.1, -0.0, 0.0), (12, 12, -0.7, 0.2, -0.1, -0.1),
)  # fmt: skip
