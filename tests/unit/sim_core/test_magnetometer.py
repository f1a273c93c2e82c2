"""The magnetometer and the Earth's field against published values and rotations."""

import numpy as np
import pytest
from motion import at_rest

from sim_core.sensors.magnetometer import Magnetometer, local_field_ned_gauss
from sim_core.sensors.spec import MagnetometerSpec

FIELD_NED_GAUSS = (0.26, -0.07, 0.05)


def measured(truth, magnetometer: Magnetometer) -> np.ndarray:
    rng = np.random.default_rng(0)
    _, sample = magnetometer.measure(magnetometer.initial(len(truth.pos_ned_m), rng), truth, rng)
    return sample.field_frd_gauss


@pytest.mark.parametrize(
    ("year", "height_km", "latitude_deg", "longitude_deg", "declination_deg", "inclination_deg", "ned_nt"),
    # Test values that NOAA NCEI distributes with the coefficients of WMM2020.
    [
        (2020.0, 66.0, 14.0, 143.0, 0.12, 13.08, (34916.8, 70.2, 8114.9)),
        (2020.0, 18.0, 0.0, 21.0, 1.05, -26.46, (29311.2, 536.0, -14589.0)),
        (2020.5, 6.0, -36.0, -137.0, 20.16, -52.21, (23948.6, 8791.9, -32897.6)),
        (2020.5, 63.0, 26.0, 81.0, 0.43, 40.84, (34737.7, 259.2, 30023.4)),
    ],
)
def test_local_field_is_the_published_one(
    year, height_km, latitude_deg, longitude_deg, declination_deg, inclination_deg, ned_nt
):
    field = local_field_ned_gauss(latitude_deg, longitude_deg, height_km * 1000.0, year)
    # The table is rounded to 0.1 nT and 0.01 degree.
    np.testing.assert_allclose(np.array(field.ned_gauss) * 1e5, ned_nt, atol=0.051)
    assert field.declination_deg == pytest.approx(declination_deg, abs=0.0051)
    assert field.inclination_deg == pytest.approx(inclination_deg, abs=0.0051)


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg", "height_km", "declination_deg"),
    [(89.0, -121.0, 28.0, -99.77), (-33.0, 109.0, 51.0, -5.49)],  # NOAA's test values of WMM2025 at 2025.0
)
def test_the_year_chooses_the_epoch(latitude_deg, longitude_deg, height_km, declination_deg):
    field = local_field_ned_gauss(latitude_deg, longitude_deg, height_km * 1000.0, 2025.0)
    assert field.declination_deg == pytest.approx(declination_deg, abs=0.0051)


@pytest.mark.parametrize(
    ("place", "field"),
    [
        ((91.0, 0.0, 0.0, 2025.0), "latitude_deg"),
        ((0.0, 0.0, 1e7, 2025.0), "altitude_m"),
        ((0.0, 0.0, 0.0, 2031.0), "decimal_year"),
        ((0.0, float("nan"), 0.0, 2025.0), "longitude_deg"),
    ],
)
def test_the_field_outside_its_model_is_refused(place, field):
    with pytest.raises(ValueError, match=rf"local_field\.{field} = .*; give"):
        local_field_ned_gauss(*place)


def test_level_compass_reads_true_heading_less_declination():
    local = local_field_ned_gauss(-8.8016, -63.9509, 55.0, 2025.5)
    headings = np.radians(np.arange(0.0, 360.0, 15.0))
    euler = np.column_stack([np.zeros_like(headings), np.zeros_like(headings), headings])
    field = measured(
        at_rest(len(headings), euler_rad=euler), Magnetometer(MagnetometerSpec(), field_ned_gauss=local.ned_gauss)
    )
    compass = np.arctan2(-field[:, 1], field[:, 0])
    difference = np.angle(np.exp(1j * (headings - np.radians(local.declination_deg) - compass)))
    assert np.abs(difference).max() < 1e-9


def test_the_field_turns_but_keeps_its_strength():
    euler = np.random.default_rng(4).uniform(-3.0, 3.0, (200, 3)) * [1.0, 0.5, 1.0]
    truth = at_rest(200, euler_rad=euler)
    field = measured(truth, Magnetometer(MagnetometerSpec(), field_ned_gauss=FIELD_NED_GAUSS))
    np.testing.assert_allclose(np.linalg.norm(field, axis=1), np.linalg.norm(FIELD_NED_GAUSS), rtol=1e-12)
    back = (truth.rot_ned_frd @ field[:, :, None])[:, :, 0]
    np.testing.assert_allclose(back, np.broadcast_to(FIELD_NED_GAUSS, (200, 3)), atol=1e-12)


def test_hard_iron_stays_with_the_body():
    iron = np.array([0.03, -0.02, 0.01])
    truth = at_rest(3, euler_rad=[[0.1, 0.2, 0.3], [0.0, 0.0, 2.0], [-0.4, 0.0, -1.0]])
    clean = measured(truth, Magnetometer(MagnetometerSpec(), field_ned_gauss=FIELD_NED_GAUSS))
    magnetised = measured(
        truth, Magnetometer(MagnetometerSpec(hard_iron_frd_gauss=tuple(iron)), field_ned_gauss=FIELD_NED_GAUSS)
    )
    np.testing.assert_allclose(magnetised - clean, np.broadcast_to(iron, (3, 3)), atol=1e-15)


def test_output_comes_in_steps():
    truth = at_rest(50, euler_rad=np.random.default_rng(1).uniform(-1.0, 1.0, (50, 3)))
    step = 3e-3
    fine = measured(truth, Magnetometer(MagnetometerSpec(), field_ned_gauss=FIELD_NED_GAUSS))
    coarse = measured(truth, Magnetometer(MagnetometerSpec(resolution_gauss=step), field_ned_gauss=FIELD_NED_GAUSS))
    np.testing.assert_allclose(coarse / step, np.rint(coarse / step), atol=1e-9)
    assert 0.4 * step < np.abs(coarse - fine).max() <= 0.5 * step


def test_noise_and_drift_are_as_configured():
    vessels, samples, rate_hz = 400, 300, 50.0
    density, instability, correlation_s = 1e-4, 1e-3, 2.0
    magnetometer = Magnetometer(
        MagnetometerSpec(
            rate_hz=rate_hz,
            noise_density_gaussprthz=density,
            bias_instability_gauss=instability,
            bias_correlation_s=correlation_s,
        ),
        field_ned_gauss=FIELD_NED_GAUSS,
    )
    rng = np.random.default_rng(8)
    state = magnetometer.initial(vessels, rng)
    error = np.empty((samples, vessels, 3))
    for i in range(samples):
        state, sample = magnetometer.measure(state, at_rest(vessels), rng)
        error[i] = sample.field_frd_gauss - FIELD_NED_GAUSS
    white, drift = density**2 * rate_hz, (instability / 0.61736) ** 2
    # 6 s hold 1.5 independent values of a process correlated over 2 s: 1800 over all channels.
    scatter = 4.0 * np.sqrt(2.0 / 1800)
    assert error.var() == pytest.approx(white + drift, rel=scatter)
    for lag in (1, 50, 100):
        covariance = np.mean(error[lag:] * error[:-lag])
        expected = drift * np.exp(-lag / rate_hz / correlation_s)
        assert covariance == pytest.approx(expected, abs=scatter * drift), f"lag {lag}"
    # First differences: 2 white + 2 drift (1 - r), 1 - r = 0.00995.
    first = np.diff(error, axis=0)
    expected = 2.0 * white + 2.0 * drift * -np.expm1(-1.0 / rate_hz / correlation_s)
    assert first.var() == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / 1e5))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("rate_hz", 0.0),
        ("noise_density_gaussprthz", -1e-4),
        ("bias_correlation_s", -1.0),
        ("field_ned_gauss", (0.2, float("inf"), 0.1)),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=rf"Magnetometer(Spec)?\.{field} = .*; (use|write)"):
        Magnetometer(MagnetometerSpec(), value) if field == "field_ned_gauss" else MagnetometerSpec(**{field: value})
