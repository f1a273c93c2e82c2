"""Sensors of a log that is made of known noise, with a receiver of known latency."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from tests.unit.logs.made_log import MadeLog, MadeTable
from xitl_cli.errors import UserError
from xitl_cli.plugins.identify.sensors import SensorEstimate, SensorValue, identify_sensors

REST_S, END_S = 610.0, 680.0
LAT_DEG, LON_DEG, METRES_PER_DEG = 60.0, 20.0, 111_194.9
HEADING_RAD = math.radians(30.0)
AHEAD = np.array([math.cos(HEADING_RAD), math.sin(HEADING_RAD)])
GYRO_RADPS, ACCEL_MPS2, IMU_HZ = 1e-3, 0.02, 50.0
GYRO_BIAS_RADPS = np.array([3e-3, -1e-3, 2e-3])
PLACE_M, DRIFT_M, SPEED_MPS, GNSS_HZ, LATENCY_S = 0.1, 0.5, 0.02, 5.0, 0.12
BAROMETER_PA, BAROMETER_HZ = 1.5, 10.0


def speed_mps(time_s: np.ndarray) -> np.ndarray:
    """A boat at rest that then surges with a period of 8 s."""
    return np.where(time_s < REST_S, 0.0, 0.75 * (1.0 - np.cos(2.0 * np.pi * (time_s - REST_S) / 8.0)))


def acceleration_mps2(time_s: np.ndarray) -> np.ndarray:
    return np.where(time_s < REST_S, 0.0, 0.75 * np.pi / 4.0 * np.sin(2.0 * np.pi * (time_s - REST_S) / 8.0))


@pytest.fixture(scope="module")
def found() -> SensorEstimate:
    rng = np.random.default_rng(4)
    imu_s, fix_s, baro_s = (np.arange(0.0, END_S, 1.0 / rate) for rate in (IMU_HZ, GNSS_HZ, BAROMETER_HZ))
    gyro = GYRO_BIAS_RADPS + GYRO_RADPS * rng.standard_normal((len(imu_s), 3))
    accel = np.array([0.0, 0.0, -9.81]) + ACCEL_MPS2 * rng.standard_normal((len(imu_s), 3))
    accel[:, 0] += acceleration_mps2(imu_s)
    inertial = {f"Gyr{axis}": gyro[:, n] for n, axis in enumerate("XYZ")}
    inertial |= {f"Acc{axis}": accel[:, n] for n, axis in enumerate("XYZ")}
    attitude = {"Roll": 0.0, "Pitch": 0.0, "Yaw": math.degrees(HEADING_RAD)}
    drift = DRIFT_M * np.sin(2.0 * np.pi * fix_s / 200.0)
    place = drift[:, None] + PLACE_M * rng.standard_normal((len(fix_s), 2))
    velocity = speed_mps(fix_s - LATENCY_S)[:, None] * AHEAD + SPEED_MPS * rng.standard_normal((len(fix_s), 2))
    fixes = {
        "Status": np.full(len(fix_s), 3),
        "NSats": np.full(len(fix_s), 12),
        "Lat": LAT_DEG + place[:, 0] / METRES_PER_DEG,
        "Lng": LON_DEG + place[:, 1] / METRES_PER_DEG / math.cos(math.radians(LAT_DEG)),
        "Spd": np.hypot(*velocity.T),
        "GCrs": np.degrees(np.arctan2(velocity[:, 1], velocity[:, 0])) % 360.0,
    }
    pressure = {"Press": 101_325.0 + BAROMETER_PA * rng.standard_normal(len(baro_s))}
    return identify_sensors(
        MadeLog(
            MadeTable("IMU", np.round(imu_s * 1e9), inertial),
            MadeTable("ATT", np.round(imu_s * 1e9), {name: np.full(len(imu_s), at) for name, at in attitude.items()}),
            MadeTable("GPS", np.round(fix_s * 1e9), fixes),
            MadeTable("BARO", np.round(baro_s * 1e9), pressure),
        )
    )


def value(found: SensorEstimate, key: str) -> SensorValue:
    return next(own for own in found.values if own.key == key)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("key", "expected", "tolerance"),
    [
        ("imu.rate_hz", IMU_HZ, 0.0),
        ("imu.gyro_noise_density_radpsprthz", GYRO_RADPS / math.sqrt(IMU_HZ), 0.03),
        ("imu.accel_noise_density_mps2prthz", ACCEL_MPS2 / math.sqrt(IMU_HZ), 0.03),
        ("imu.gyro_turn_on_bias_radps", math.sqrt(14.0 / 3.0) * 1e-3, 0.03),
        ("gnss.rate_hz", GNSS_HZ, 0.0),
        ("gnss.horizontal_noise_m", PLACE_M, 0.05),
        ("gnss.horizontal_drift_m", DRIFT_M / math.sqrt(2.0), 0.05),
        ("gnss.velocity_noise_mps", SPEED_MPS, 0.05),
        ("gnss.latency_s", LATENCY_S, 0.02),
        ("barometer.rate_hz", BAROMETER_HZ, 0.0),
        ("barometer.noise_pa", BAROMETER_PA, 0.05),
    ],
)
def test_noise_and_latency_are_those_of_the_log(
    found: SensorEstimate, key: str, expected: float, tolerance: float
) -> None:
    assert value(found, key).value == pytest.approx(expected, rel=tolerance)


@pytest.mark.medium
def test_standard_errors_fall_with_the_root_of_the_samples(found: SensorEstimate) -> None:
    fixes, pressures = REST_S * GNSS_HZ, REST_S * BAROMETER_HZ
    assert value(found, "gnss.horizontal_noise_m").sigma == pytest.approx(PLACE_M / math.sqrt(2.0 * fixes), rel=0.06)
    assert value(found, "barometer.noise_pa").sigma == pytest.approx(
        BAROMETER_PA / math.sqrt(2.0 * pressures), rel=0.06
    )
    assert found.rest_s == pytest.approx(REST_S, abs=2.0)
    assert found.lacks == ()


@pytest.mark.medium
@pytest.mark.parametrize("exchange_s", [0.0, 0.02], ids=["continuous clock", "lockstep"])
def test_the_place_of_the_antenna_and_the_clock_of_lockstep_leave_the_latency_alone(exchange_s: float) -> None:
    """The antenna is 0.8 m ahead of the unit and 1.2 m above it, in turns: 0.2 s of error if its place is ignored.

    In lockstep, a record has the time of the exchange before it arrived.
    """
    rng = np.random.default_rng(5)
    rest_s, end_s, arm_m = 40.0, 140.0, np.array([0.8, 0.0, -1.2])
    imu_s, fix_s = np.arange(0.0, end_s, 0.005) + 0.005, np.arange(0.0, end_s, 0.2) + 0.2

    def yaw_of(time_s: np.ndarray) -> np.ndarray:
        return np.where(time_s < rest_s, 0.0, 1.2 * np.sin(2.0 * np.pi * (time_s - rest_s) / 13.0))

    def speed_of(time_s: np.ndarray) -> np.ndarray:
        return np.where(time_s < rest_s, 0.0, 0.75 * (1.0 - np.cos(2.0 * np.pi * (time_s - rest_s) / 8.0)))

    def rate_of(function: Callable[[np.ndarray], np.ndarray], time_s: np.ndarray) -> np.ndarray:
        return (function(time_s + 1e-4) - function(time_s - 1e-4)) / 2e-4

    yaw, turn, speed = yaw_of(imu_s), rate_of(yaw_of, imu_s), speed_of(imu_s)
    gyro = GYRO_RADPS * rng.standard_normal((len(imu_s), 3))
    gyro[:, 2] += turn
    accel = np.array([0.0, 0.0, -9.81]) + ACCEL_MPS2 * rng.standard_normal((len(imu_s), 3))
    accel[:, 0] += rate_of(speed_of, imu_s)
    accel[:, 1] += turn * speed
    at_s = fix_s - LATENCY_S
    ahead, right = speed_of(at_s), rate_of(yaw_of, at_s) * arm_m[0]
    cosine, sine = np.cos(yaw_of(at_s)), np.sin(yaw_of(at_s))
    velocity = np.stack([ahead * cosine - right * sine, ahead * sine + right * cosine], axis=1)
    velocity += SPEED_MPS * rng.standard_normal(velocity.shape)

    def stamps(time_s: np.ndarray) -> np.ndarray:
        stamped_s = np.ceil(time_s / exchange_s - 1e-6) * exchange_s - exchange_s if exchange_s else time_s
        return np.round(stamped_s * 1e9)

    inertial = {f"Gyr{axis}": gyro[:, n] for n, axis in enumerate("XYZ")}
    inertial |= {f"Acc{axis}": accel[:, n] for n, axis in enumerate("XYZ")}
    inertial["SampleUS"] = np.round(imu_s * 1e6)
    level = np.zeros(len(imu_s))
    fixes = {
        "Status": np.full(len(fix_s), 3),
        "NSats": np.full(len(fix_s), 12),
        "Lat": np.full(len(fix_s), LAT_DEG),
        "Lng": np.full(len(fix_s), LON_DEG),
        "Spd": np.hypot(*velocity.T),
        "GCrs": np.degrees(np.arctan2(velocity[:, 1], velocity[:, 0])) % 360.0,
    }
    result = identify_sensors(
        MadeLog(
            MadeTable("IMU", stamps(imu_s), inertial),
            MadeTable("ATT", np.round(imu_s * 1e9), {"Roll": level, "Pitch": level, "Yaw": np.degrees(yaw) % 360.0}),
            MadeTable("GPS", stamps(fix_s), fixes),
        )
    )
    latency = value(result, "gnss.latency_s")
    assert latency.sigma is not None
    assert latency.sigma < 0.005
    assert latency.value == pytest.approx(LATENCY_S, abs=3.0 * latency.sigma)


def short_log(rest_s: float, moving_s: float = 0.0, **left_out: bool) -> MadeLog:
    """A boat at rest and then in surges of 8 s, without chance in its receiver."""
    rng = np.random.default_rng(8)
    imu_s, fix_s, baro_s = (np.arange(0.0, rest_s + moving_s, 1.0 / rate) for rate in (IMU_HZ, GNSS_HZ, BAROMETER_HZ))
    later_s = REST_S - rest_s
    accel = np.array([0.0, 0.0, -9.81]) + 1e-3 * rng.standard_normal((len(imu_s), 3))
    accel[:, 0] += acceleration_mps2(imu_s + later_s)
    inertial = {f"Gyr{axis}": 3e-3 + 1e-5 * rng.standard_normal(len(imu_s)) for axis in "XYZ"}
    inertial |= {f"Acc{axis}": accel[:, n] for n, axis in enumerate("XYZ")}
    speed = speed_mps(fix_s - LATENCY_S + later_s)
    fixes = {
        "Status": np.full(len(fix_s), 3),
        "NSats": np.full(len(fix_s), 12),
        "Lat": np.full(len(fix_s), LAT_DEG),
        "Lng": np.full(len(fix_s), LON_DEG),
        "Spd": speed,
        "GCrs": np.full(len(fix_s), math.degrees(HEADING_RAD)),
    }
    attitude = {"Roll": 0.0, "Pitch": 0.0, "Yaw": math.degrees(HEADING_RAD)}
    tables = {
        "IMU": (imu_s, inertial),
        "ATT": (imu_s, {name: np.full(len(imu_s), at) for name, at in attitude.items()}),
        "GPS": (fix_s, fixes),
        "BARO": (baro_s, {"Press": 101_325.0 + rng.standard_normal(len(baro_s))}),
    }
    return MadeLog(
        *(MadeTable(name, np.round(at_s * 1e9), own) for name, (at_s, own) in tables.items() if name not in left_out)
    )


@pytest.mark.medium
def test_a_short_rest_says_what_it_does_not_show() -> None:
    found = identify_sensors(short_log(90.0))
    keys = {own.key for own in found.values}
    assert "imu.gyro_noise_density_radpsprthz" in keys
    assert not any("instability" in key or "drift" in key or "latency" in key for key in keys)
    stability, latency = found.lacks
    assert stability == (
        "the stability of the biases and the drift of the receiver need 10 min of rest, and this log has 1.5"
    )
    assert latency.startswith("the latency of the receiver needs changes of speed")
    bias = value(found, "imu.gyro_turn_on_bias_radps")
    # Of three axes at one start: the standard deviation by the root of six.
    assert (bias.value, bias.sigma) == (pytest.approx(3e-3, rel=1e-3), pytest.approx(3e-3 / math.sqrt(6.0), rel=1e-3))


@pytest.mark.medium
@pytest.mark.parametrize(("moving_s", "known"), [(24.0, False), (36.0, True)])
def test_the_latency_needs_five_windows_of_changing_speed(moving_s: float, known: bool) -> None:
    """A window is 5 s long."""
    found = {own.key: own for own in identify_sensors(short_log(90.0, moving_s)).values}
    assert ("gnss.latency_s" in found) is known
    if known:
        assert found["gnss.latency_s"].value == pytest.approx(LATENCY_S, abs=0.005)


@pytest.mark.medium
def test_logs_that_cannot_show_sensors() -> None:
    with pytest.raises(UserError, match=r"has no samples of an IMU; record IMU \(bit 18 of LOG_BITMASK\)"):
        identify_sensors(short_log(90.0, IMU=True))
    with pytest.raises(UserError, match=r"the boat is at rest for \d+ s at most; record \d+ s or more"):
        identify_sensors(short_log(5.0, 60.0))
    keys = {own.key.partition(".")[0] for own in identify_sensors(short_log(90.0, GPS=True, BARO=True)).values}
    assert keys == {"imu"}
