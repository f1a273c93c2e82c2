"""Published tables of the surroundings, as data: Earth, magnetic field, atmosphere and waves."""

from __future__ import annotations

from xitl_cli.plugins.studies.manoeuvres.references import ReferenceKind, Source

EPSG = Source(ReferenceKind.PUBLISHED, "IOGP 373-7-2 (EPSG Guidance Note 7-2), example of method 9837, WGS 84")
TR8350 = Source(ReferenceKind.PUBLISHED, "NIMA TR8350.2, WGS 84: derived constants")
DEGREES = Source(ReferenceKind.PUBLISHED, "NGA, American Practical Navigator (Bowditch): length of a degree, WGS 84")
WMM = Source(ReferenceKind.PUBLISHED, "NOAA/NCEI, WMM2025 test values")
ISA = Source(ReferenceKind.PUBLISHED, "ISO 2533:1975, pressure over geopotential altitude")
SPM = Source(ReferenceKind.PUBLISHED, "US Army Shore Protection Manual 1984, table C-1")
DNV_PERIODS = Source(ReferenceKind.PUBLISHED, "DNV-RP-C205, 3.5.5: periods of JONSWAP over its peak enhancement")
DNV_PEAK = Source(ReferenceKind.PUBLISHED, "DNV-RP-C205, 3.5.5: normalising factor of JONSWAP")

TOPOCENTRE = (55.0, 5.0, 200.0)
"""Latitude, longitude (degrees) and height (m) of the origin of EPSG's example."""
TOPOCENTRIC_POINT = (53.0 + 48.0 / 60.0 + 33.82 / 3600.0, 2.0 + 7.0 / 60.0 + 46.38 / 3600.0, 73.0)
TOPOCENTRIC_NED_M = (-128_642.040, -189_013.869, 4_220.171)
POLAR_RADIUS_M = 6_356_752.3142
GRAVITY_MPS2 = ((0.0, 9.7803253359), (90.0, 9.8321849378))
"""Normal gravity by latitude."""
DEGREE_M = (
    (0.0, 110_574.0, 111_320.0),
    (30.0, 110_852.0, 96_486.0),
    (45.0, 111_132.0, 78_847.0),
    (60.0, 111_412.0, 55_800.0),
)
"""Latitude, length of a degree of latitude about it, and of a degree of longitude at it."""
FIELD_NT = (
    (2025.0, 0.0, 80.0, 0.0, (6521.6, 145.9, 54791.5)),
    (2025.0, 0.0, 0.0, 120.0, (39677.8, -109.6, -10580.2)),
    (2025.0, 0.0, -80.0, 240.0, (6117.5, 15751.9, -52022.5)),
    (2027.5, 0.0, 80.0, 0.0, (6500.8, 294.5, 54869.4)),
    (2027.5, 0.0, 0.0, 120.0, (39701.6, -167.4, -10381.8)),
    (2027.5, 0.0, -80.0, 240.0, (6200.7, 15730.3, -51783.7)),
)
"""Year, height above the ellipsoid (m), latitude, longitude, and the field to north, east and down."""
PRESSURE_PA = ((500.0, 95_460.8), (1000.0, 89_874.6), (2000.0, 79_495.2), (3000.0, 70_108.5), (5000.0, 54_019.9))
"""Pressure by geopotential altitude (m)."""
DEPTH_OVER_LENGTH = ((0.01, 0.04032), (0.05, 0.09416), (0.1, 0.1410), (0.2, 0.2251), (0.3, 0.3121), (0.5, 0.5018))
"""Depth over the wavelength in deep water, and over the wavelength there."""
GAMMAS = (1.0, 2.0, 3.3, 5.0)
PERIODS_WITHIN = 0.003
"""Share of a period by which the fits below differ from the integrals: 0.2 % for gamma 1."""


def zero_crossing_over_peak(gamma: float) -> float:
    """Return the zero up-crossing period over the peak period."""
    return 0.6673 + 0.05037 * gamma - 0.006230 * gamma**2 + 0.0003341 * gamma**3


def mean_over_peak(gamma: float) -> float:
    """Return the mean period over the peak period."""
    return 0.7303 + 0.04936 * gamma - 0.006556 * gamma**2 + 0.0003610 * gamma**3
