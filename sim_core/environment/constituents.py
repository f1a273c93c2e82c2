"""Harmonic constituents of the tide: speeds, equilibrium arguments, and nodal corrections.

    constituent = CONSTITUENTS["M2"]
    arguments = Arguments.at(datetime(2026, 3, 1, tzinfo=UTC))
    arguments.factor(constituent), arguments.phase_rad(constituent)  # f, and V + u

The height is the sum of f A cos(V + u - g), with the amplitude A, the Greenwich phase lag g, the equilibrium argument V
at Greenwich, and the nodal corrections f and u (Schureman, Manual of Harmonic Analysis and Prediction of Tides, Special
Publication 98, US Coast and Geodetic Survey, 1958). The names are those of NOAA's stations.

V and u of this module are combinations of the mean longitudes of moon and sun (Meeus, Astronomical Algorithms, 1998).
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Literal

from sim_core.dataclass import dataclass

Node = Literal["none", "M2", "O1", "K1", "K2", "J1", "OO1", "M3", "L2", "M1", "MM", "MF"]


@dataclass(frozen=True, slots=True)
class Constituent:
    """One harmonic constituent."""

    speed_degph: float
    """Angular speed, degrees per hour."""
    argument: tuple[int, int, int, int, int]
    """Multiples of T, s, h, p and p1 in V: hour angle of the mean sun, and mean longitudes of moon, sun, lunar perigee
    and solar perigee.
    """
    constant_deg: int = 0
    """Constant part of V."""
    nodes: tuple[tuple[Node, int], ...] = ()
    """Nodal corrections, each with a number n: f is the product of f^|n|, and u is the sum of n u."""


_M2: tuple[tuple[Node, int], ...] = (("M2", 1),)
_O1: tuple[tuple[Node, int], ...] = (("O1", 1),)

# Speeds: NOAA, Center for Operational Oceanographic Products and Services, table of the 37 constituents of a station.
# Arguments: Schureman 1958, table 2.
CONSTITUENTS: dict[str, Constituent] = {
    "M2": Constituent(28.984104, (2, -2, 2, 0, 0), 0, _M2),
    "S2": Constituent(30.0, (2, 0, 0, 0, 0)),
    "N2": Constituent(28.43973, (2, -3, 2, 1, 0), 0, _M2),
    "K1": Constituent(15.041069, (1, 0, 1, 0, 0), -90, (("K1", 1),)),
    "M4": Constituent(57.96821, (4, -4, 4, 0, 0), 0, (("M2", 2),)),
    "O1": Constituent(13.943035, (1, -2, 1, 0, 0), 90, _O1),
    "M6": Constituent(86.95232, (6, -6, 6, 0, 0), 0, (("M2", 3),)),
    "MK3": Constituent(44.025173, (3, -2, 3, 0, 0), -90, (("M2", 1), ("K1", 1))),
    "S4": Constituent(60.0, (4, 0, 0, 0, 0)),
    "MN4": Constituent(57.423832, (4, -5, 4, 1, 0), 0, (("M2", 2),)),
    "NU2": Constituent(28.512583, (2, -3, 4, -1, 0), 0, _M2),
    "S6": Constituent(90.0, (6, 0, 0, 0, 0)),
    "MU2": Constituent(27.968208, (2, -4, 4, 0, 0), 0, _M2),
    "2N2": Constituent(27.895355, (2, -4, 2, 2, 0), 0, _M2),
    "OO1": Constituent(16.139101, (1, 2, 1, 0, 0), -90, (("OO1", 1),)),
    "LAM2": Constituent(29.455626, (2, -1, 0, 1, 0), 180, _M2),
    "S1": Constituent(15.0, (1, 0, 0, 0, 0)),
    "M1": Constituent(14.496694, (1, -1, 1, 0, 0), -90, (("M1", 1),)),
    "J1": Constituent(15.5854435, (1, 1, 1, -1, 0), -90, (("J1", 1),)),
    "MM": Constituent(0.5443747, (0, 1, 0, -1, 0), 0, (("MM", 1),)),
    "SSA": Constituent(0.0821373, (0, 0, 2, 0, 0)),
    "SA": Constituent(0.0410686, (0, 0, 1, 0, 0)),
    "MSF": Constituent(1.0158958, (0, 2, -2, 0, 0), 0, (("M2", -1),)),
    "MF": Constituent(1.0980331, (0, 2, 0, 0, 0), 0, (("MF", 1),)),
    "RHO": Constituent(13.471515, (1, -3, 3, -1, 0), 90, _O1),
    "Q1": Constituent(13.398661, (1, -3, 1, 1, 0), 90, _O1),
    "T2": Constituent(29.958933, (2, 0, -1, 0, 1)),
    "R2": Constituent(30.041067, (2, 0, 1, 0, -1), 180),
    "2Q1": Constituent(12.854286, (1, -4, 1, 2, 0), 90, _O1),
    "P1": Constituent(14.958931, (1, 0, -1, 0, 0), 90),
    "2SM2": Constituent(31.015896, (2, 2, -2, 0, 0), 0, (("M2", -1),)),
    "M3": Constituent(43.47616, (3, -3, 3, 0, 0), 0, (("M3", 1),)),
    "L2": Constituent(29.528479, (2, -1, 2, -1, 0), 180, (("L2", 1),)),
    "2MK3": Constituent(42.92714, (3, -4, 3, 0, 0), 90, (("M2", 2), ("K1", -1))),
    "K2": Constituent(30.082138, (2, 0, 2, 0, 0), 0, (("K2", 1),)),
    "M8": Constituent(115.93642, (8, -8, 8, 0, 0), 0, (("M2", 4),)),
    "MS4": Constituent(58.984104, (4, -2, 2, 0, 0), 0, _M2),
}

_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
_CENTURY_S = 36525.0 * 86400.0
_DAY_S = 86400.0


@dataclass(frozen=True, slots=True)
class Arguments:
    """Longitudes in degrees, and nodal corrections, at one instant. The corrections change by a few percent a year."""

    longitudes_deg: tuple[float, float, float, float, float]
    """T, s, h, p and p1."""
    nodal: dict[Node, tuple[float, float]]
    """f and u in degrees."""

    @classmethod
    def at(cls, instant: datetime) -> Arguments:
        """Return the arguments at an instant with a time zone."""
        since_s = (instant - _J2000).total_seconds()
        century = since_s / _CENTURY_S
        hour_angle = (since_s / _DAY_S % 1.0) * 360.0  # since noon, at which the mean sun crosses Greenwich
        moon = 218.3164477 + 481267.88123421 * century
        sun = 280.46646 + 36000.76983 * century
        perigee = 83.3532465 + 4069.0137287 * century
        node = 125.04452 - 1934.136261 * century
        solar_perigee = 282.93735 + 1.71946 * century
        return cls((hour_angle, moon, sun, perigee, solar_perigee), _nodal(math.radians(node), math.radians(perigee)))

    def factor(self, constituent: Constituent) -> float:
        """Return f."""
        return math.prod(self.nodal[name][0] ** abs(power) for name, power in constituent.nodes)

    def phase_rad(self, constituent: Constituent) -> float:
        """Return V + u."""
        multiples = zip(constituent.argument, self.longitudes_deg, strict=True)
        equilibrium_deg = sum(number * longitude for number, longitude in multiples) + constituent.constant_deg
        nodal_deg = sum(power * self.nodal[name][1] for name, power in constituent.nodes)
        return math.radians(math.fmod(equilibrium_deg + nodal_deg, 360.0))


def _nodal(node_rad: float, perigee_rad: float) -> dict[Node, tuple[float, float]]:
    """Return f and u by Schureman 1958 (numbers of equations in comments), from the longitude of the moon's node."""
    tilt = math.acos(0.91370 - 0.03569 * math.cos(node_rad))  # I, obliquity of the moon's orbit
    half, sine, twice = 0.5 * tilt, math.sin(tilt), math.sin(2.0 * tilt)
    nu = math.asin(0.08978 * math.sin(node_rad) / sine)  # right ascension of the intersection
    node = math.remainder(node_rad, math.tau)
    xi = node - 2.0 * math.atan(0.64412 * math.tan(0.5 * node)) - nu  # longitude of the intersection in the orbit
    nu_1 = math.atan2(twice * math.sin(nu), twice * math.cos(nu) + 0.3347)  # 224
    nu_2 = 0.5 * math.atan2(sine**2 * math.sin(2.0 * nu), sine**2 * math.cos(2.0 * nu) + 0.0727)  # 232
    from_node = perigee_rad - xi  # P, 191
    lean = math.tan(half) ** 2
    orbit_l2 = math.sqrt(1.0 - 12.0 * lean * math.cos(2.0 * from_node) + 36.0 * lean**2)  # 213
    turn_l2 = math.atan2(math.sin(2.0 * from_node), 1.0 / (6.0 * lean) - math.cos(2.0 * from_node))  # 214
    orbit_m1 = math.sqrt(2.310 + 1.435 * math.cos(2.0 * from_node))  # 197
    turn_m1 = math.atan2(0.483 * math.sin(from_node), math.cos(from_node))  # 203
    f_m2 = math.cos(half) ** 4 / 0.9154  # 78
    f_o1 = sine * math.cos(half) ** 2 / 0.3800  # 75
    f_k1 = math.sqrt(0.8965 * twice**2 + 0.6001 * twice * math.cos(nu) + 0.1006)  # 227
    f_k2 = math.sqrt(19.0444 * sine**4 + 2.7702 * sine**2 * math.cos(2.0 * nu) + 0.0981)  # 235
    corrections: dict[Node, tuple[float, float]] = {
        "M2": (f_m2, 2.0 * (xi - nu)),
        "O1": (f_o1, 2.0 * xi - nu),
        "K1": (f_k1, -nu_1),
        "K2": (f_k2, -2.0 * nu_2),
        "J1": (twice / 0.7214, -nu),  # 76
        "OO1": (sine * math.sin(half) ** 2 / 0.0164, -2.0 * xi - nu),  # 77
        "M3": (math.cos(half) ** 6 / 0.8758, 3.0 * (xi - nu)),  # 149
        "L2": (f_m2 * orbit_l2, 2.0 * (xi - nu) - turn_l2),  # 215
        "M1": (f_o1 * orbit_m1, xi - nu + turn_m1),  # 207
        "MM": ((2.0 / 3.0 - sine**2) / 0.5021, 0.0),  # 73
        "MF": (sine**2 / 0.1578, -2.0 * xi),  # 74
    }
    return {name: (f, math.degrees(u)) for name, (f, u) in corrections.items()}
