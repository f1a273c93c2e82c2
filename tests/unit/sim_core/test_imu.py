"""The inertial measurement unit against closed forms of its noise and of rigid-body motion."""

import numpy as np
import pytest
from motion import at_rest, swinging

from sim_core.geodesy import normal_gravity_mps2
from sim_core.kinematics import Kinematics
from sim_core.sensors.imu import Imu
from sim_core.sensors.measurement import digitiser, joined_digitiser
from sim_core.sensors.spec import ImuSpec

GRAVITY = 9.81
GYRO_DENSITY, GYRO_INSTABILITY, GYRO_CORRELATION_S = 5e-5, 2.4e-5, 100.0
ACCEL_DENSITY, ACCEL_INSTABILITY, ACCEL_CORRELATION_S = 7e-4, 4e-4, 30.0
NOISY = {
    "gyro_noise_density_radpsprthz": GYRO_DENSITY,
    "gyro_bias_instability_radps": GYRO_INSTABILITY,
    "gyro_bias_correlation_s": GYRO_CORRELATION_S,
    "gyro_turn_on_bias_radps": 3e-3,
    "accel_noise_density_mps2prthz": ACCEL_DENSITY,
    "accel_bias_instability_mps2": ACCEL_INSTABILITY,
    "accel_bias_correlation_s": ACCEL_CORRELATION_S,
    "accel_turn_on_bias_mps2": 0.1,
}


def record(imu: Imu, vessels: int, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """gyro and accel of vessels at rest, each (samples, vessels, 3)."""
    rng = np.random.default_rng(seed)
    truth = at_rest(vessels)
    state = imu.initial(vessels, rng)
    gyro, accel = np.empty((samples, vessels, 3)), np.empty((samples, vessels, 3))
    for i in range(samples):
        state, sample = imu.measure(state, truth, rng)
        gyro[i], accel[i] = sample.gyro_frd_radps, sample.accel_frd_mps2
    return gyro, accel


def allan_variance(record: np.ndarray, rate_hz: float, tau_s: float) -> float:
    """Overlapping Allan variance over axis 0, averaged over the channels (IEEE Std 952-1997, annex C)."""
    m = round(tau_s * rate_hz)
    angle = np.concatenate([np.zeros((1, *record.shape[1:])), np.cumsum(record, axis=0)]) / rate_hz
    second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
    return float(np.mean(second**2) / (2.0 * tau_s**2))


def gauss_markov_variance(tau_s: float, peak: float, correlation_s: float) -> float:
    """Allan variance of a Gauss-Markov process whose maximum is `peak`^2, from its peak 0.4365 q sqrt(Tc)."""
    x = tau_s / correlation_s
    driven = (peak / 0.43654) ** 2 / correlation_s  # q^2
    return driven * correlation_s / x * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))


@pytest.fixture(scope="module")
def ten_minutes() -> tuple[np.ndarray, np.ndarray]:
    return record(Imu(ImuSpec(rate_hz=50.0, **NOISY)), vessels=48, samples=30_000, seed=7)


@pytest.mark.parametrize(
    ("channel", "density", "instability", "correlation_s"),
    [
        (0, GYRO_DENSITY, GYRO_INSTABILITY, GYRO_CORRELATION_S),
        (1, ACCEL_DENSITY, ACCEL_INSTABILITY, ACCEL_CORRELATION_S),
    ],
    ids=["gyro", "accel"],
)
@pytest.mark.medium
def test_allan_deviation_of_ten_minutes_at_rest(ten_minutes, channel, density, instability, correlation_s):
    at_rest_record = ten_minutes[channel]
    channels = 48 * 3

    def relative_deviation(tau_s: float) -> float:
        # A record of length T holds at least T/tau - 1 independent pairs of clusters a channel; the mean square of k
        # normals scatters by sqrt(2/k).
        return float(np.sqrt(2.0 / (channels * (600.0 / tau_s - 1.0))))

    taus_s = [0.1, 1.0, 5.0, 20.0, 40.0, 1.8926 * 30.0, 90.0, 1.8926 * 100.0]
    measured = {tau_s: allan_variance(at_rest_record, 50.0, tau_s) for tau_s in taus_s}
    for tau_s, variance in measured.items():
        expected = density**2 / tau_s + gauss_markov_variance(tau_s, instability, correlation_s)
        assert variance == pytest.approx(expected, rel=4.0 * relative_deviation(tau_s)), f"tau {tau_s} s"

    # What a reader takes off the plot: the density at 1 s (to which the bias adds under 0.5 % here) ...
    assert np.sqrt(measured[1.0]) == pytest.approx(density, rel=2.0 * relative_deviation(1.0) + 0.005)
    # ... and the bias instability at the top of the hump, once the white noise is taken away.
    hump = {tau_s: np.sqrt(variance - density**2 / tau_s) for tau_s, variance in measured.items() if tau_s > 10.0}
    top_s = 1.8926 * correlation_s
    assert hump[top_s] == pytest.approx(instability, rel=2.0 * relative_deviation(top_s))
    assert max(hump.values()) == pytest.approx(instability, rel=2.0 * relative_deviation(max(taus_s)))


@pytest.mark.medium
@pytest.mark.parametrize("rate_hz", [100.0, 400.0])
def test_density_does_not_depend_on_the_rate(rate_hz):
    imu = Imu(
        ImuSpec(
            rate_hz=rate_hz, gyro_noise_density_radpsprthz=GYRO_DENSITY, accel_noise_density_mps2prthz=ACCEL_DENSITY
        )
    )
    seconds, vessels = 40, 32
    gyro, accel = record(imu, vessels, round(seconds * rate_hz), seed=3)
    tolerance = 4.0 * np.sqrt(2.0 / (vessels * 3 * (seconds - 1)))
    assert allan_variance(gyro, rate_hz, 1.0) == pytest.approx(GYRO_DENSITY**2, rel=tolerance)
    assert allan_variance(accel, rate_hz, 1.0) == pytest.approx(ACCEL_DENSITY**2, rel=tolerance)
    # One sample, on the other hand, scatters by density * sqrt(rate): 1e5 samples or more put that within 1 %.
    assert gyro.std() == pytest.approx(GYRO_DENSITY * np.sqrt(rate_hz), rel=0.01)


@pytest.mark.medium
def test_axes_vessels_and_samples_are_independent():
    imu = Imu(ImuSpec(gyro_noise_density_radpsprthz=GYRO_DENSITY, accel_noise_density_mps2prthz=ACCEL_DENSITY))
    samples, vessels = 10_000, 8
    gyro, accel = record(imu, vessels, samples, seed=11)
    columns = np.concatenate([gyro.reshape(samples, -1), accel.reshape(samples, -1)], axis=1)
    correlation = np.corrcoef(columns, rowvar=False) - np.eye(columns.shape[1])
    # 1128 pairs, each of deviation 1/sqrt(n): five of those are exceeded once in 1500 such tests.
    assert np.abs(correlation).max() < 5.0 / np.sqrt(samples)
    centred = (columns - columns.mean(axis=0)) / columns.std(axis=0)
    assert abs(np.mean(centred[1:] * centred[:-1])) < 5.0 / np.sqrt(centred.size)


def test_biases_are_independent_and_as_wide_as_configured():
    vessels = 4000
    state = Imu(ImuSpec(**NOISY)).initial(vessels, np.random.default_rng(5))
    columns = np.concatenate([state.turn_on_bias, state.drifting_bias], axis=1)
    correlation = np.corrcoef(columns, rowvar=False) - np.eye(12)
    assert np.abs(correlation).max() < 5.0 / np.sqrt(vessels)
    deviation = columns.std(axis=0)
    scatter = 4.0 / np.sqrt(2.0 * vessels)
    np.testing.assert_allclose(deviation[0:3], 3e-3, rtol=scatter)
    np.testing.assert_allclose(deviation[3:6], 0.1, rtol=scatter)
    np.testing.assert_allclose(deviation[6:9], GYRO_INSTABILITY / 0.61736, rtol=scatter)
    np.testing.assert_allclose(deviation[9:12], ACCEL_INSTABILITY / 0.61736, rtol=scatter)


def exact(truth: Kinematics, **configuration) -> tuple[np.ndarray, np.ndarray]:
    """gyro and accel of an IMU without errors."""
    imu = Imu(ImuSpec(**configuration), gravity_mps2=GRAVITY)
    rng = np.random.default_rng(0)
    _, sample = imu.measure(imu.initial(len(truth.pos_ned_m), rng), truth, rng)
    return sample.gyro_frd_radps, sample.accel_frd_mps2


def test_at_rest_it_feels_the_ground_push_up():
    gyro, accel = exact(at_rest(), position_frd_m=(0.5, -0.2, 0.1))
    np.testing.assert_allclose(gyro, [[0.0, 0.0, 0.0]])
    np.testing.assert_allclose(accel, [[0.0, 0.0, -GRAVITY]])


def test_on_a_tilted_platform_gravity_shows_on_the_axes():
    roll, pitch = 0.3, -0.2
    _, accel = exact(at_rest(euler_rad=(roll, pitch, 1.9)))
    expected = [np.sin(pitch), -np.cos(pitch) * np.sin(roll), -np.cos(pitch) * np.cos(roll)]
    np.testing.assert_allclose(accel, [GRAVITY * np.array(expected)], atol=1e-12)


def test_steady_turn_with_lever_arm():
    speed, rate, x, y, z = 3.0, 0.4, 0.7, -0.3, 0.2
    heading = 0.6
    still = at_rest(euler_rad=(0.0, 0.0, heading))
    turning = Kinematics(
        pos_ned_m=still.pos_ned_m,
        vel_ned_mps=speed * np.array([[np.cos(heading), np.sin(heading), 0.0]]),
        acc_ned_mps2=speed * rate * np.array([[-np.sin(heading), np.cos(heading), 0.0]]),
        quat_ned_frd=still.quat_ned_frd,
        rot_ned_frd=still.rot_ned_frd,
        gyro_frd_radps=np.array([[0.0, 0.0, rate]]),
        angular_acc_frd_radps2=np.zeros((1, 3)),
    )
    gyro, accel = exact(turning, position_frd_m=(x, y, z))
    # Turning right, the centre is to starboard: v w there; every point is drawn to the axis by w^2 r.
    np.testing.assert_allclose(accel, [[-(rate**2) * x, speed * rate - rate**2 * y, -GRAVITY]], atol=1e-12)
    np.testing.assert_allclose(gyro, [[0.0, 0.0, rate]])


@pytest.mark.parametrize("time_s", [0.0, 1.3, 4.7])
def test_lever_arm_is_the_second_derivative_of_the_points_path(time_s):
    lever = np.array([0.8, -0.5, -1.2])
    h = 1e-3

    def point(t: float) -> np.ndarray:
        truth = swinging(t)
        return truth.pos_ned_m[0] + truth.rot_ned_frd[0] @ lever

    acceleration = (point(time_s + h) - 2.0 * point(time_s) + point(time_s - h)) / h**2
    truth = swinging(time_s)
    _, accel = exact(truth, position_frd_m=tuple(lever))
    expected = truth.rot_ned_frd[0].T @ (acceleration - [0.0, 0.0, GRAVITY])
    # The central difference errs by h^2/12 times a fourth derivative of some 10 m/s^4, and by rounding 1e-15/h^2.
    np.testing.assert_allclose(accel[0], expected, atol=1e-5)


def test_output_comes_in_steps_within_half_a_step_of_the_value():
    configuration = NOISY | {"rate_hz": 100.0}
    fine = record(Imu(ImuSpec(**configuration)), 4, 200, seed=2)
    steps = (1e-3, 5e-3)
    coarse = record(
        Imu(ImuSpec(**configuration, gyro_resolution_radps=steps[0], accel_resolution_mps2=steps[1])), 4, 200, seed=2
    )
    for smooth, stepped, step in zip(fine, coarse, steps, strict=True):
        np.testing.assert_allclose(stepped / step, np.rint(stepped / step), atol=1e-9)
        error = stepped - smooth
        assert np.abs(error).max() <= 0.5 * step * (1.0 + 1e-9)
        assert np.abs(error).max() > 0.4 * step


def test_output_saturates_at_full_scale():
    truth = swinging(1.0)
    gyro, accel = exact(truth, gyro_range_radps=0.05, accel_range_mps2=2.0)
    free_gyro, free_accel = exact(truth)
    np.testing.assert_array_equal(gyro, np.clip(free_gyro, -0.05, 0.05))
    np.testing.assert_array_equal(accel, np.clip(free_accel, -2.0, 2.0))
    assert np.abs(free_gyro).max() > 0.05


def test_the_seed_decides_every_sample():
    imu = Imu(ImuSpec(**NOISY))
    first, again, other = (record(imu, 3, 50, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])
    assert np.all(first[0] != other[0])


def test_measuring_leaves_the_state_it_was_given_alone():
    imu = Imu(ImuSpec(**NOISY))
    state = imu.initial(2, np.random.default_rng(0))
    one = imu.measure(state, at_rest(2), np.random.default_rng(9))[1]
    two = imu.measure(state, at_rest(2), np.random.default_rng(9))[1]
    np.testing.assert_array_equal(one.gyro_frd_radps, two.gyro_frd_radps)


def test_gravity_is_that_of_the_place():
    gravity = normal_gravity_mps2(-8.8)
    imu = Imu(ImuSpec(), gravity_mps2=gravity)
    rng = np.random.default_rng(0)
    _, sample = imu.measure(imu.initial(1, rng), at_rest(), rng)
    assert sample.accel_frd_mps2[0, 2] == pytest.approx(-gravity)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("rate_hz", 0.0),
        ("rate_hz", float("nan")),
        ("gyro_noise_density_radpsprthz", -1e-5),
        ("accel_bias_instability_mps2", float("inf")),
        ("gyro_bias_correlation_s", 0.0),
        ("latency_s", -0.1),
        ("gyro_range_radps", 0.0),
        ("position_frd_m", (0.0, 1.0)),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=rf"ImuSpec\.{field} = .*; (use|write|give)"):
        Imu(ImuSpec(**{field: value}))


@pytest.mark.parametrize("scale", [1e-200, 1e-6, 1.0, 1e15])
def test_the_columns_of_a_joined_digitiser_are_rounded_and_limited_apart(scale: float) -> None:
    values = np.random.default_rng(3).normal(scale=scale, size=(4, 6))
    joined = joined_digitiser((2, 0.25, 1.0), (3, 0.0, None), (1, 0.0, 0.5)).read(values)
    assert joined[:, :2].tolist() == digitiser(0.25, 1.0).read(values[:, :2]).tolist()
    assert joined[:, 2:5].tolist() == values[:, 2:5].tolist()
    assert joined[:, 5].tolist() == np.clip(values[:, 5], -0.5, 0.5).tolist()
