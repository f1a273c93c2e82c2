"""A bias of an accelerometer against a made path whose onset, end and size are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from numpy.typing import NDArray

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Evidence, Finding
from xitl_cli.logs.signals.sensors import STANDARD_GRAVITY_MPS2, InertialUnit, SampleTimes
from xitl_cli.logs.signals.series import Series
from xitl_cli.plugins.logs.analyses.accelerometer_bias import accelerometer_findings, accelerometer_steps

S = 1_000_000_000
END_S, ONSET_S = 90.0, 45.0
Array = NDArray[np.float64]


def yaw_rad(time_s: Array) -> Array:
    return 1.2 * np.sin(0.25 * time_s)


def speed_mps(time_s: Array) -> Array:
    return 2.0 + 0.5 * np.sin(0.4 * time_s)


def unit(bias_mps2: tuple[float, float, float], until_s: float = END_S + 1.0) -> InertialUnit:
    """Level vessel that goes ahead: thrust along x, and the turn along y."""
    rng = np.random.default_rng(2)
    time_s = np.arange(0.0, END_S, 0.01)
    rate = np.gradient(yaw_rad(time_s), time_s)
    force = np.stack(
        [np.gradient(speed_mps(time_s), time_s), speed_mps(time_s) * rate, np.full(len(rate), -STANDARD_GRAVITY_MPS2)],
        axis=1,
    )
    force += 0.2 * rng.normal(size=force.shape)
    force[(time_s >= ONSET_S) & (time_s < until_s)] += bias_mps2
    gyro = np.stack([np.zeros(len(rate)), np.zeros(len(rate)), rate], axis=1) + 0.002 * rng.normal(size=force.shape)
    stamp_ns = np.round(time_s * S).astype(np.int64)
    table = MadeTable("IMU", stamp_ns, {})
    fields = ("GyrX", "GyrY", "GyrZ"), ("AccX", "AccY", "AccZ")
    return InertialUnit("IMU[0]", table, stamp_ns, SampleTimes(stamp_ns), gyro, force, *fields, None, None, None, None)


def attitude_deg(tilted_deg: float = 0.0) -> list[Series]:
    """Roll, pitch and yaw of an estimate whose pitch follows a bias within seconds."""
    time_s = np.arange(0.0, END_S, 0.1)
    stamp_ns = np.round(time_s * S).astype(np.int64)
    pitch = tilted_deg * (1.0 - np.exp(-np.maximum(time_s - ONSET_S, 0.0) / 3.0))
    values = np.zeros(len(time_s)), pitch, np.degrees(yaw_rad(time_s))
    return [Series(stamp_ns, angle, "deg", "ATT") for angle in values]


def velocity(step_mps: float = 0.0) -> Series:
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, END_S, 0.2)
    psi, speed = yaw_rad(time_s), speed_mps(time_s)
    values = np.stack([speed * np.cos(psi), speed * np.sin(psi), np.zeros(len(psi))], axis=1)
    values += 0.05 * rng.normal(size=values.shape)
    values[time_s >= ONSET_S, 0] += step_mps
    return Series(np.round(time_s * S).astype(np.int64), values, "m/s", "GPS")


@pytest.mark.parametrize("bias", [(0.6, 0.0, 0.0), (0.0, -0.8, 0.0), (0.3, 0.2, 0.7)])
def test_a_bias_has_its_onset_and_size(bias: tuple[float, float, float]) -> None:
    tilted_deg = float(np.degrees(np.arcsin(bias[0] / STANDARD_GRAVITY_MPS2)))
    (step,) = accelerometer_steps(unit(bias), attitude_deg(tilted_deg), velocity())
    assert step.from_ns == pytest.approx(ONSET_S * S, abs=S)
    assert step.until_ns is None
    assert step.size == pytest.approx(np.array(bias), abs=0.15)


def test_a_bias_that_ends_has_an_end() -> None:
    (step,) = accelerometer_steps(unit((0.9, 0.0, 0.0), 63.0), attitude_deg(), velocity())
    assert step.until_ns == pytest.approx(63.0 * S, abs=S)


@pytest.mark.medium
def test_a_sound_accelerometer_and_a_wrong_velocity_have_no_bias() -> None:
    assert accelerometer_steps(unit((0.0, 0.0, 0.0)), attitude_deg(), velocity()) == []
    assert accelerometer_steps(unit((0.0, 0.0, 0.0)), attitude_deg(), velocity(1.5)) == []


def test_a_velocity_that_repeats_or_is_missing_shows_no_bias() -> None:
    sound = velocity()
    frozen = sound.values.copy()
    held = (sound.stamp_ns > ONSET_S * S) & (sound.stamp_ns < 60.0 * S)
    frozen[held] = frozen[np.flatnonzero(held)[0]]
    for series in (
        Series(sound.stamp_ns, frozen, "m/s", "GPS"),
        Series(sound.stamp_ns[~held], sound.values[~held], "m/s", "GPS"),
    ):
        assert accelerometer_steps(unit((0.0, 0.0, 0.0)), attitude_deg(), series) == []


def wandering(deviation_mps: float, seed: int) -> Series:
    """Velocity of a receiver with an error that changes within 6 s, as that of reflected signals."""
    sound, rng = velocity(), np.random.default_rng(seed)
    kept = np.exp(-0.2 / 6.0)
    error = np.zeros(sound.values.shape)
    for row in range(1, len(error)):
        error[row] = kept * error[row - 1] + np.sqrt(1.0 - kept**2) * deviation_mps * rng.normal(size=3) * [1, 1, 0.33]
    return Series(sound.stamp_ns, sound.values + error, "m/s", "GPS")


@pytest.mark.parametrize(("deviation_mps", "seed"), [(0.16, 12), (0.2, 4)])
def test_in_turns_a_bias_is_not_placed_at_another_time(
    deviation_mps: float, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Biases of both axes 8 s before and after it fit better in their own windows."""
    monkeypatch.setitem(globals(), "yaw_rad", lambda time_s: 1.6 * np.sin(0.35 * time_s))
    (step,) = accelerometer_steps(unit((0.7, 0.0, 0.0)), attitude_deg(4.1), wandering(deviation_mps, seed))
    assert step.from_ns == pytest.approx(ONSET_S * S, abs=S)
    assert step.size == pytest.approx(np.array([0.65, 0.0, 0.0]), abs=0.15)


@pytest.mark.parametrize("bias", [(0.0, 0.0, 0.0), (0.7, 0.0, 0.0)])
def test_delay_and_antenna_of_the_receiver_are_known_from_the_turns(bias: tuple[float, float, float]) -> None:
    """An antenna 2 m behind and 1 m to starboard of the sensor, and a velocity of 0.3 s ago."""
    sound = velocity()
    time_s = sound.stamp_ns / S - 0.3
    psi, rate = yaw_rad(time_s), np.gradient(yaw_rad(time_s), time_s)
    ahead, aside = speed_mps(time_s) - 1.0 * rate, -2.0 * rate
    values = np.stack(
        [ahead * np.cos(psi) - aside * np.sin(psi), ahead * np.sin(psi) + aside * np.cos(psi), 0.0 * psi], axis=1
    )
    values += 0.05 * np.random.default_rng(6).normal(size=values.shape)
    steps = accelerometer_steps(unit(bias), attitude_deg(4.1 if bias[0] else 0.0), replace(sound, values=values))
    assert len(steps) == any(bias)
    for step in steps:
        assert step.from_ns == pytest.approx(ONSET_S * S, abs=S)
        assert step.size == pytest.approx(np.array(bias), abs=0.15)


def log_of(bias_mps2: tuple[float, float, float], until_s: float = END_S + 1.0, first_fix_s: float = 0.0) -> MadeLog:
    """The same as tables of ArduPilot; without a fix, the velocity is wrong."""
    made, ground = unit(bias_mps2, until_s), velocity()
    assert made.gyro_radps is not None
    assert made.accel_mps2 is not None
    imu = dict(
        zip((*made.gyro_fields, *made.accel_fields), np.hstack([made.gyro_radps, made.accel_mps2]).T, strict=True)
    )
    angles = dict(zip(("Roll", "Pitch", "Yaw"), (series.values for series in attitude_deg()), strict=True))
    fixed = ground.stamp_ns >= first_fix_s * S
    north, east, _ = ground.values.T
    gps = {
        "Lat": np.full(len(north), -8.8), "Lng": np.full(len(north), -63.9), "Status": np.where(fixed, 3, 2),
        "Spd": np.where(fixed, np.hypot(north, east), 50.0), "GCrs": np.degrees(np.arctan2(east, north)) % 360.0,
        "VZ": np.zeros(len(north)),
    }  # fmt: skip
    return MadeLog(
        MadeTable("IMU", made.stamp_ns, imu),
        MadeTable("ATT", attitude_deg()[0].stamp_ns, angles),
        MadeTable("GPS", ground.stamp_ns, gps),
    )


def findings_of(log: MadeLog) -> list[Finding]:
    return list(accelerometer_findings(log, LogClock(log)))


@pytest.mark.parametrize(
    ("until_s", "first_fix_s", "until_ns"),
    [(END_S + 1.0, 0.0, 89_990_000_000), (63.0, 0.0, 63 * S), (END_S + 1.0, 8.0, 89_990_000_000)],
)
def test_a_bias_is_told_with_its_axis_and_time(until_s: float, first_fix_s: float, until_ns: int) -> None:
    (found,) = findings_of(log_of((0.1, -0.9, 0.0), until_s, first_fix_s))
    (shown,) = found.evidence
    assert isinstance(shown, Evidence)
    assert (found.key, shown.message, shown.field) == ("sensors.accel_bias", "IMU", "AccY")
    assert shown.at_ns == pytest.approx(ONSET_S * S, abs=S)
    assert shown.until_ns == pytest.approx(until_ns, abs=S)
    assert shown.value is not None
    assert float(shown.value.split()[0]) == pytest.approx(-0.9, abs=0.15)
    assert f"IMU: the accelerometer is off by {shown.value} on y from 0:4" in found.sentence
    assert found.sentence.endswith("by the velocity of GPS")


def test_without_a_receiver_or_an_attitude_no_bias_is_told() -> None:
    log = log_of((0.1, -0.9, 0.0))
    for name in ("GPS", "ATT", "IMU"):
        assert findings_of(MadeLog(*(table for key, table in log.tables.items() if key != name))) == []
    assert findings_of(log_of((0.0, 0.0, 0.0))) == []
