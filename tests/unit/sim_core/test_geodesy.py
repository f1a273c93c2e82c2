"""WGS84 against two independent libraries and published gravity."""

import numpy as np
import pymap3d
import pyproj
import pytest

from sim_core.geodesy import LocalFrame, normal_gravity_mps2

ORIGINS = [
    (0.0, 0.0, 0.0),
    (-8.8016, -63.9509, 55.0),  # Santo Antonio dam
    (-77.85, 166.67, 10.0),
    (52.0, 179.999, 2.0),  # 50 km crosses the antimeridian eastwards
    (-17.0, -179.999, 2.0),  # and westwards
    (89.9, 30.0, 0.0),  # 50 km reaches over the pole
    (27.9, 86.9, 5000.0),
]


def offsets(rng_seed: int) -> np.ndarray:
    rng = np.random.default_rng(rng_seed)
    return np.vstack([np.zeros((1, 3)), rng.uniform([-5e4, -5e4, -500.0], [5e4, 5e4, 500.0], (500, 3))])


def wrapped_deg(angle_deg: np.ndarray) -> np.ndarray:
    return (angle_deg + 180.0) % 360.0 - 180.0


def metres_apart(lat_deg: np.ndarray, lon_deg: np.ndarray, lat2_deg: np.ndarray, lon2_deg: np.ndarray) -> np.ndarray:
    """East counts with the cosine of the latitude: near the pole a large difference in longitude is a short way."""
    north = np.radians(lat_deg - lat2_deg) * 6.4e6
    east = np.radians(wrapped_deg(lon_deg - lon2_deg)) * 6.4e6 * np.cos(np.radians(lat_deg))
    return np.hypot(north, east)


@pytest.mark.parametrize("origin", ORIGINS)
def test_geodetic_agrees_with_pymap3d_to_a_millimetre(origin):
    ned = offsets(1)
    lat, lon, alt = LocalFrame(*origin).geodetic(ned)
    lat2, lon2, alt2 = pymap3d.ned2geodetic(ned[:, 0], ned[:, 1], ned[:, 2], *origin)
    assert metres_apart(lat, lon, lat2, lon2).max() < 1e-3
    assert np.abs(alt - alt2).max() < 1e-3
    assert np.abs(lon).max() <= 180.0


@pytest.mark.parametrize("origin", ORIGINS)
def test_geodetic_agrees_with_proj_to_a_millimetre(origin):
    lat0, lon0, alt0 = origin
    pipeline = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={lat0} +lon_0={lon0} +h_0={alt0}"
    )
    ned = offsets(2)
    frame = LocalFrame(*origin)
    lat, lon, alt = frame.geodetic(ned)
    east, north, up = pipeline.transform(lon, lat, alt)
    assert np.abs(np.column_stack([north, east, -np.asarray(up)]) - ned).max() < 1e-3


@pytest.mark.parametrize("origin", ORIGINS)
def test_ned_agrees_with_pymap3d_and_inverts_geodetic(origin):
    ned = offsets(3)
    frame = LocalFrame(*origin)
    geodetic = frame.geodetic(ned)
    reference = np.column_stack(pymap3d.geodetic2ned(*geodetic, *origin))
    assert np.abs(frame.ned(*geodetic) - reference).max() < 1e-3
    # The closed-form latitude is claimed to 1 um up to 10 km of height.
    assert np.abs(frame.ned(*geodetic) - ned).max() < 1e-6


def test_the_poles_are_ordinary_points():
    lat, _, alt = LocalFrame(90.0, 0.0, 0.0).geodetic(np.zeros((1, 3)))
    assert lat[0] == pytest.approx(90.0, abs=1e-9)
    assert alt[0] == pytest.approx(0.0, abs=1e-6)
    lat, lon, _ = LocalFrame(-90.0, 0.0, 0.0).geodetic(np.array([[1000.0, 0.0, 0.0]]))
    assert lat[0] == pytest.approx(-90.0 + np.degrees(1000.0 / 6399593.6), abs=1e-7)  # polar radius of curvature a^2/b
    assert lon[0] == pytest.approx(0.0, abs=1e-9)


def test_one_vessel_is_a_row_of_the_batch():
    frame = LocalFrame(*ORIGINS[1])
    ned = offsets(4)
    batch = np.column_stack(frame.geodetic(ned))
    single = np.vstack([np.column_stack(frame.geodetic(row[None])) for row in ned[:20]])
    np.testing.assert_allclose(single, batch[:20], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("origin", "field"),
    [
        ((90.5, 0.0, 0.0), "latitude_deg = 90.5"),
        ((0.0, 181.0, 0.0), "longitude_deg = 181.0"),
        ((float("nan"), 0.0, 0.0), "latitude_deg = nan"),
        ((0.0, 0.0, 5e4), "altitude_m = 50000.0"),
    ],
)
def test_an_origin_off_the_earth_is_refused(origin, field):
    with pytest.raises(ValueError, match=rf"LocalFrame\.{field} is out of range; give a value between"):
        LocalFrame(*origin)


@pytest.mark.parametrize(
    ("latitude_deg", "gravity_mps2"),
    # NIMA TR8350.2, tables 3.3 and 3.4: normal gravity at the equator and at the pole; and at 45 degrees.
    [(0.0, 9.7803253359), (90.0, 9.8321849378), (-90.0, 9.8321849378), (45.0, 9.8061977693)],
)
def test_normal_gravity_on_the_ellipsoid(latitude_deg, gravity_mps2):
    assert normal_gravity_mps2(latitude_deg) == pytest.approx(gravity_mps2, abs=2e-9)


@pytest.mark.parametrize("latitude_deg", [0.0, 45.0, 90.0])
@pytest.mark.parametrize("height_m", [100.0, 5000.0])
def test_normal_gravity_falls_with_height(latitude_deg, height_m):
    # Height correction in mGal of Hinze et al., New standards for reducing gravity data, Geophysics 70, 2005; it stands
    # on GRS80 and keeps higher powers of the flattening: 1e-5 of the gradient each.
    sin_squared = np.sin(np.radians(latitude_deg)) ** 2
    correction_mgal = -(0.3087691 - 0.0004398 * sin_squared) * height_m + 7.2125e-8 * height_m**2
    fall = normal_gravity_mps2(latitude_deg, height_m) - normal_gravity_mps2(latitude_deg)
    assert fall == pytest.approx(correction_mgal * 1e-5, rel=1e-4)
