"""The direction to the sun against published positions."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta, timezone

import pytest

from sim_core.environment.sun import sun_direction_ned


def angles_deg(instant: datetime, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    north, east, down = sun_direction_ned(instant, latitude_deg, longitude_deg).tolist()
    return math.degrees(math.asin(-down)), math.degrees(math.atan2(east, north)) % 360.0


def test_the_example_of_nrels_algorithm() -> None:
    # Reda and Andreas 2004, Solar Position Algorithm, table A5.1: zenith 50.11162 and azimuth 194.34024 degrees.
    # Its zenith has 0.02 degrees of refraction; the accuracy of ours is 0.01 degrees.
    instant = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7)))
    elevation, azimuth = angles_deg(instant, 39.742476, -105.1786)
    assert elevation == pytest.approx(90.0 - 50.11162, abs=0.03)
    assert azimuth == pytest.approx(194.34024, abs=0.02)


def test_it_is_over_the_tropic_at_the_solstice() -> None:
    # Solstice of June 2024: 20:51 UTC, declination 23.436 degrees. The sun is highest where it is noon by true time.
    instant = datetime(2024, 6, 20, 20, 51, tzinfo=UTC)
    highest = max(angles_deg(instant, 23.436, longitude / 10.0)[0] for longitude in range(-1800, 1800))
    assert highest == pytest.approx(90.0, abs=0.06)


def test_it_is_below_the_horizon_at_night() -> None:
    assert angles_deg(datetime(2026, 3, 20, 4, 0, tzinfo=UTC), -8.8, -63.95)[0] < -75.0
