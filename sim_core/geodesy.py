"""WGS84 geodesy: local tangent-plane NED, latitude, longitude and height, normal gravity; and ArduPilot's sphere.

Constants and formulas: NIMA TR8350.2, Department of Defense World Geodetic System 1984, 3rd edition.
"""

from __future__ import annotations

import math
from dataclasses import field

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array

GeodeticPoint = tuple[float, float, float]
"""Latitude, longitude (deg) and altitude (m)."""

SEMI_MAJOR_AXIS_M = 6378137.0
FLATTENING = 1.0 / 298.257223563
SEMI_MINOR_AXIS_M = SEMI_MAJOR_AXIS_M * (1.0 - FLATTENING)
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
SECOND_ECCENTRICITY_SQUARED = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)

_EQUATOR_GRAVITY_MPS2 = 9.7803253359
_SOMIGLIANA_K = 0.00193185265241
_CENTRIFUGAL_RATIO = 0.00344978650684  # m = omega^2 a^2 b / GM

# Arrays without dimensions: at N = 1, numpy multiplies by them in half the time of a Python float.
_DEG_PER_RAD = np.array(180.0 / math.pi)
_RAD_PER_DEG = np.array(math.pi / 180.0)
_ONE = np.array(1.0)
_A_M = np.array(SEMI_MAJOR_AXIS_M)
_B_M = np.array(SEMI_MINOR_AXIS_M)
_E2 = np.array(ECCENTRICITY_SQUARED)
_ONE_LESS_E2 = np.array(1.0 - ECCENTRICITY_SQUARED)
_STRETCH = np.array(1.0 / (1.0 - FLATTENING))
_RISE_M = np.array(SECOND_ECCENTRICITY_SQUARED * SEMI_MINOR_AXIS_M)
_RUN_M = np.array(ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS_M)


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """North-east-down axes on the tangent plane at one geodetic point.

    The axes are straight: a point level with the origin at distance d is about d^2 / 2R higher in altitude (0.8 m at
    3.2 km). Raises ValueError when the origin is outside the ranges of the fields.
    """

    latitude_deg: float
    """-90 to 90."""
    longitude_deg: float
    """-180 to 180."""
    altitude_m: float
    """Altitude above the WGS84 ellipsoid, -10000 to 10000."""
    _origin_ecef_m: Array = field(init=False, repr=False, compare=False)
    _ned_ecef: Array = field(init=False, repr=False, compare=False)  # rows are north, east and down in ECEF

    def __post_init__(self) -> None:
        for name, value, limit in (
            ("latitude_deg", self.latitude_deg, 90.0),
            ("longitude_deg", self.longitude_deg, 180.0),
            ("altitude_m", self.altitude_m, 10e3),
        ):
            if not abs(value) <= limit:
                raise ValueError(
                    f"LocalFrame.{name} = {value} is out of range; give a value between {-limit:g} and {limit:g}"
                )
        lat, lon = math.radians(self.latitude_deg), math.radians(self.longitude_deg)
        sin_lat, cos_lat, sin_lon, cos_lon = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
        object.__setattr__(
            self,
            "_ned_ecef",
            np.array(
                [
                    [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
                    [-sin_lon, cos_lon, 0.0],
                    [-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat],
                ]
            ),
        )
        origin = np.array([[self.latitude_deg], [self.longitude_deg], [self.altitude_m]])
        object.__setattr__(self, "_origin_ecef_m", _ecef(*origin))

    def geodetic(self, pos_ned_m: Array) -> tuple[Array, Array, Array]:
        """(N, 3) NED -> latitude_deg (N,), longitude_deg (N,) in [-180, 180], altitude_m (N,).

        One pass of Bowring, Transformation from spatial to geographical coordinates, Survey Review 23, 1976, from the
        parametric latitude of the ellipsoid: under 1 um up to 10 km from it, poles included.
        """
        x, y, z = (pos_ned_m.dot(self._ned_ecef) + self._origin_ecef_m).T
        p = np.hypot(x, y)
        # Angles as the two legs of a triangle, not as a tangent: the formula holds at the poles.
        rise = _STRETCH * z
        side = np.hypot(rise, p)
        sin_u, cos_u = rise / side, p / side  # of the parametric latitude u
        rise = z + _RISE_M * (sin_u * sin_u * sin_u)
        run = p - _RUN_M * (cos_u * cos_u * cos_u)
        # p cos + z sin - a sqrt(1 - e^2 sin^2). The sine and cosine of the latitude still contain the hypotenuse as a
        # factor.
        height: Array = p * run + z * rise - np.hypot(_A_M * run, _B_M * rise)
        return (
            np.arctan2(rise, run) * _DEG_PER_RAD,
            np.arctan2(y, x) * _DEG_PER_RAD,
            height / np.hypot(rise, run),
        )

    def ned(self, latitude_deg: Array, longitude_deg: Array, altitude_m: Array) -> Array:
        """latitude_deg, longitude_deg, altitude_m, each (N,) -> (N, 3) NED in metres."""
        pos_ned_m: Array = (_ecef(latitude_deg, longitude_deg, altitude_m) - self._origin_ecef_m).dot(self._ned_ecef.T)
        return pos_ned_m


def _ecef(latitude_deg: Array, longitude_deg: Array, altitude_m: Array) -> Array:
    """(N,) geodetic coordinates -> (N, 3) Earth-centred, Earth-fixed metres."""
    lat, lon = latitude_deg * _RAD_PER_DEG, longitude_deg * _RAD_PER_DEG
    sin_lat, cos_lat = np.sin(lat), np.cos(lat)
    prime_vertical_m = _A_M / np.sqrt(_ONE - _E2 * (sin_lat * sin_lat))
    ecef_m = np.empty((len(latitude_deg), 3))
    p = (prime_vertical_m + altitude_m) * cos_lat
    ecef_m[:, 0] = p * np.cos(lon)
    ecef_m[:, 1] = p * np.sin(lon)
    ecef_m[:, 2] = (prime_vertical_m * _ONE_LESS_E2 + altitude_m) * sin_lat
    return ecef_m


def normal_gravity_mps2(latitude_deg: float, altitude_m: float = 0.0) -> float:
    """WGS84 normal gravity: Somigliana on the ellipsoid (TR8350.2, eq 4-1), second order in height (eq 4-3)."""
    sin_squared = math.sin(math.radians(latitude_deg)) ** 2
    surface = (
        _EQUATOR_GRAVITY_MPS2
        * (1.0 + _SOMIGLIANA_K * sin_squared)
        / math.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_squared)
    )
    height = altitude_m / SEMI_MAJOR_AXIS_M
    slope = 1.0 + FLATTENING + _CENTRIFUGAL_RATIO - 2.0 * FLATTENING * sin_squared
    return surface * (1.0 - 2.0 * slope * height + 3.0 * height * height)


ARDUPILOT_M_PER_DEG = math.radians(6_378_100.0)
"""Metres per degree of latitude in ArduPilot (AP_Common/Location), on a sphere of 6378.1 km.

A degree of longitude is this times the cosine of the latitude midway. A degree of the ellipsoid is up to 0.7 % shorter
near the equator and 0.3 % longer near the poles. For example, 150 m north of the origin in ArduPilot is 149 m on the
Earth near the equator.
"""


def ardupilot_ned(origin: GeodeticPoint, geodetic: Array) -> Array:
    """Convert (N, 3) latitude, longitude (deg) and altitude (m) to (N, 3) NED about `origin`, in ArduPilot's metres."""
    latitude, longitude, altitude = geodetic.T
    east_scale = np.cos(np.radians(0.5 * (latitude + origin[0])))
    turns = (longitude - origin[1] + 180.0) % 360.0 - 180.0
    north, east = (latitude - origin[0]) * ARDUPILOT_M_PER_DEG, turns * ARDUPILOT_M_PER_DEG * east_scale
    return np.stack([north, east, origin[2] - altitude], axis=1)


def ardupilot_geodetic(origin: GeodeticPoint, ned_m: Array) -> Array:
    """Convert (N, 3) NED about `origin`, in ArduPilot's metres, to (N, 3) latitude, longitude (deg), altitude (m)."""
    latitude = origin[0] + ned_m[:, 0] / ARDUPILOT_M_PER_DEG
    east_scale = np.cos(np.radians(0.5 * (latitude + origin[0])))
    longitude = origin[1] + ned_m[:, 1] / (ARDUPILOT_M_PER_DEG * east_scale)
    return np.stack([latitude, longitude, origin[2] - ned_m[:, 2]], axis=1)
