"""The declination against pygeomag, an independent evaluation of the same model."""

from __future__ import annotations

import math

import pytest
from pygeomag import GeoMag  # type: ignore[import-untyped]

from agent.bridges.declination import declination_rad

MODEL = GeoMag(base_year=2025)


@pytest.mark.parametrize(
    ("lat_deg", "lon_deg", "alt_m", "year"),
    [
        (-8.8, -63.95, 60.0, 2025.5),
        (47.0, 8.0, 400.0, 2026.0),
        (60.0, -120.0, 0.0, 2029.9),
        (-55.0, 140.0, 10.0, 2025.0),
    ],
)
def test_declination(lat_deg: float, lon_deg: float, alt_m: float, year: float) -> None:
    expected_deg = MODEL.calculate(glat=lat_deg, glon=lon_deg, alt=alt_m / 1000.0, time=year).d
    assert math.degrees(declination_rad(lat_deg, lon_deg, alt_m, year)) == pytest.approx(expected_deg, abs=1e-6)


def test_a_year_out_of_its_time_keeps_the_nearest_end() -> None:
    assert declination_rad(47.0, 8.0, 0.0, 1999.0) == declination_rad(47.0, 8.0, 0.0, 2025.0)
    assert declination_rad(47.0, 8.0, 0.0, 2050.0) == declination_rad(47.0, 8.0, 0.0, 2030.0)


@pytest.mark.parametrize("lat_deg", [-90.0, 90.0])
def test_a_pole_is_a_place(lat_deg: float) -> None:
    assert math.isfinite(declination_rad(lat_deg, 0.0, 0.0, 2026.0))
