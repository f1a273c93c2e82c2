"""The GNSS receiver against the closed forms of its errors and of its antenna's motion."""

import numpy as np
import pytest
from motion import at_rest, swinging

from sim_core.geodesy import LocalFrame
from sim_core.sensors.gnss import Gnss
from sim_core.sensors.spec import GnssSpec

FRAME = LocalFrame(-8.8016, -63.9509, 55.0)
ERRORS = {
    "horizontal_noise_m": 0.3,
    "vertical_noise_m": 0.5,
    "horizontal_drift_m": 0.6,
    "vertical_drift_m": 1.1,
    "drift_correlation_s": 20.0,
    "velocity_noise_mps": 0.05,
}


@pytest.fixture(scope="module")
def errors() -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity errors in NED, each (samples, vessels, 3): 400 receivers at 2 Hz for two minutes."""
    gnss = Gnss(GnssSpec(rate_hz=2.0, **ERRORS), frame=FRAME)
    rng = np.random.default_rng(21)
    truth = at_rest(400, pos_ned_m=(300.0, -200.0, 1.0))
    state = gnss.initial(400, rng)
    position, velocity = np.empty((240, 400, 3)), np.empty((240, 400, 3))
    for i in range(240):
        state, sample = gnss.measure(state, truth, rng)
        position[i] = FRAME.ned(sample.lat_deg, sample.lon_deg, sample.alt_m) - truth.pos_ned_m
        velocity[i] = sample.vel_ned_mps
    return position, velocity


@pytest.mark.parametrize(
    ("axes", "noise_m", "drift_m"), [(slice(0, 2), 0.3, 0.6), (slice(2, 3), 0.5, 1.1)], ids=["horizontal", "vertical"]
)
def test_position_error_has_its_variance_and_correlation(errors, axes, noise_m, drift_m):
    error = errors[0][:, :, axes]
    # Correlated over 20 s, 120 s hold about 120 / (2 * 20) = 3 independent values a channel.
    independent = 3 * error.shape[1] * error.shape[2]
    variance = noise_m**2 + drift_m**2
    scatter = 4.0 * np.sqrt(2.0 / independent)
    assert np.mean(error**2) == pytest.approx(variance, rel=scatter)
    assert abs(np.mean(error)) < 4.0 * np.sqrt(variance / independent)
    for lag_s in (0.5, 5.0, 20.0, 60.0):
        lag = round(lag_s * 2.0)
        covariance = np.mean(error[lag:] * error[:-lag])
        # Fewer products fit as the lag grows.
        tolerance = scatter * variance / np.sqrt(1.0 - lag_s / 120.0)
        assert covariance == pytest.approx(drift_m**2 * np.exp(-lag_s / 20.0), abs=tolerance), f"lag {lag_s} s"


def test_white_part_is_the_drop_of_the_covariance_at_once(errors):
    error = errors[0][:, :, :2]
    # Second differences over one step keep the white noise (6 sigma^2) and almost lose the drift: with r = exp(-dt/tau)
    # it leaves drift^2 (6 - 8 r + 2 r^2).
    second = error[2:] - 2.0 * error[1:-1] + error[:-2]
    r = np.exp(-0.5 / 20.0)
    expected = 6.0 * 0.3**2 + 0.6**2 * (6.0 - 8.0 * r + 2.0 * r**2)
    # 190 400 values, at least a third of them independent.
    assert np.mean(second**2) == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / 6e4))


def test_velocity_error_is_white(errors):
    velocity = errors[1]
    assert velocity.std() == pytest.approx(0.05, rel=4.0 / np.sqrt(2.0 * velocity.size))
    assert abs(np.mean(velocity[1:] * velocity[:-1])) < 5.0 * 0.05**2 / np.sqrt(velocity.size)


def test_horizontal_rms_is_the_accuracy_it_reports(errors):
    gnss = Gnss(GnssSpec(**ERRORS), frame=FRAME)
    state = gnss.initial(2, np.random.default_rng(0))
    position, velocity = errors
    horizontal = np.sqrt(np.mean(np.sum(position[:, :, :2] ** 2, axis=2)))
    # The variance scatters by sqrt(2/n), its root by half of that; n from the two tests above.
    np.testing.assert_allclose(state.horizontal_accuracy_m, horizontal, rtol=2.0 * np.sqrt(2.0 / 2400))
    np.testing.assert_allclose(state.vertical_accuracy_m, position[:, :, 2].std(), rtol=2.0 * np.sqrt(2.0 / 1200))
    np.testing.assert_allclose(state.speed_accuracy_mps, np.sqrt(3.0) * velocity.std(), rtol=0.01)


@pytest.mark.parametrize("time_s", [0.0, 2.1])
def test_antenna_moves_as_a_point_of_the_body(time_s):
    lever = np.array([0.4, -0.6, -1.5])
    gnss = Gnss(GnssSpec(antenna_frd_m=tuple(lever)), frame=FRAME)
    rng = np.random.default_rng(0)

    def antenna(t: float) -> np.ndarray:
        truth = swinging(t)
        return truth.pos_ned_m[0] + truth.rot_ned_frd[0] @ lever

    _, sample = gnss.measure(gnss.initial(1, rng), swinging(time_s), rng)
    measured = FRAME.ned(sample.lat_deg, sample.lon_deg, sample.alt_m)[0]
    np.testing.assert_allclose(measured, antenna(time_s), atol=1e-6)
    h = 1e-4
    velocity = (antenna(time_s + h) - antenna(time_s - h)) / (2.0 * h)
    np.testing.assert_allclose(sample.vel_ned_mps[0], velocity, atol=1e-6)


def test_sample_has_one_row_a_vessel_and_the_quality_configured():
    gnss = Gnss(GnssSpec(satellites=17), frame=FRAME)
    rng = np.random.default_rng(0)
    _, sample = gnss.measure(gnss.initial(5, rng), at_rest(5), rng)
    assert sample.vel_ned_mps.shape == (5, 3)
    assert {sample.lat_deg.shape, sample.horizontal_accuracy_m.shape, sample.fix_type.shape} == {(5,)}
    assert set(sample.satellites) == {17}
    assert set(sample.fix_type) == {3}
    # Without errors the origin comes back: 1e-12 degrees is a tenth of a micrometre.
    np.testing.assert_allclose(sample.lat_deg, FRAME.latitude_deg, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(sample.alt_m, FRAME.altitude_m, atol=1e-6)


def test_the_seed_decides_every_fix():
    def fixes(seed: int) -> np.ndarray:
        gnss = Gnss(GnssSpec(**ERRORS), frame=FRAME)
        rng = np.random.default_rng(seed)
        state = gnss.initial(2, rng)
        latitudes = []
        for _ in range(20):
            state, sample = gnss.measure(state, at_rest(2), rng)
            latitudes.append(sample.lat_deg)
        return np.array(latitudes)

    np.testing.assert_array_equal(fixes(1), fixes(1))
    assert np.all(fixes(1) != fixes(2))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("rate_hz", -5.0),
        ("horizontal_noise_m", -0.1),
        ("drift_correlation_s", 0.0),
        ("antenna_frd_m", (0.0, float("nan"), 0.0)),
        ("satellites", -1),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=rf"GnssSpec\.{field} = .*; (use|write)"):
        GnssSpec(**{field: value})
