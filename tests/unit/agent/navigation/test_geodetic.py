"""The local frame against an independent geodesy library."""

from __future__ import annotations

import pymap3d
import pytest

from agent.navigation.geodetic import LocalProjection, normal_gravity_mps2


@pytest.mark.parametrize(("lat", "lon"), [(-8.8, -63.95), (60.0, 179.999), (0.0, -179.9999)])
def test_against_pymap3d(lat: float, lon: float) -> None:
    """Within 0.15 m at 1 km, for the constant scale of longitude gives up 700² tan(60°)/R = 0.13 m at 60 degrees."""
    frame = LocalProjection(lat, lon, 50.0)
    for north, east in ((0.0, 0.0), (300.0, -200.0), (-700.0, 700.0)):
        point = pymap3d.enu2geodetic(east, north, 0.0, lat, lon, 50.0)
        got = frame.to_local(float(point[0]), float(point[1]))
        assert got == pytest.approx((north, east), abs=0.15)
        assert frame.to_local(*frame.to_geodetic(north, east)) == pytest.approx((north, east), abs=1e-6)


def test_gravity_at_equator_and_pole() -> None:
    """WGS 84's own defining and derived values."""
    assert normal_gravity_mps2(0.0) == pytest.approx(9.7803253359, abs=1e-9)
    assert normal_gravity_mps2(90.0) == pytest.approx(9.8321849379, abs=1e-8)
