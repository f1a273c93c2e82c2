"""Errors of a compass, a barometer and a gyroscope against made series whose onset, end and size are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_log import MadeTable
from scipy.spatial.transform import Rotation

from xitl_cli.logs.signals.sensors import InertialUnit, SampleTimes, SensorKind, SensorSeries
from xitl_cli.logs.signals.series import Series
from xitl_cli.plugins.logs.analyses.sensor_departures import (
    field_error,
    field_steps,
    gyro_steps,
    pressure_steps,
    rotations,
)

S = 1_000_000_000
END_S = 120.0
FIELD_MGAUSS = np.array([200.0, 0.0, -120.0])  # north, east, down


def yaw_rad(time_s: np.ndarray) -> np.ndarray:
    """Legs with turns in between: up to 35 deg/s."""
    return 1.2 * np.sin(0.5 * time_s) + 0.1 * np.sin(2.0 * time_s)


def unit(bias_radps: float = 0.0, from_s: float = 60.0) -> InertialUnit:
    rng = np.random.default_rng(5)
    time_s = np.arange(0.0, END_S, 0.02)
    rate = np.zeros((len(time_s), 3))
    rate[:, 2] = 0.6 * np.cos(0.5 * time_s) + 0.2 * np.cos(2.0 * time_s) + bias_radps * (time_s >= from_s)
    rate += 0.003 * rng.normal(size=rate.shape)
    stamp_ns = np.round(time_s * S).astype(np.int64)
    table = MadeTable("IMU", stamp_ns.tolist(), {})
    fields = ("GyrX", "GyrY", "GyrZ")
    return InertialUnit(
        "IMU[0]", table, stamp_ns, SampleTimes(stamp_ns), rate, None, fields, (), None, None, None, None
    )


def series(sort: SensorKind, unit_name: str, time_s: np.ndarray, values: np.ndarray) -> SensorSeries:
    stamp_ns = np.round(time_s * S).astype(np.int64)
    return SensorSeries(
        sort,
        sort,
        sort,
        ("A",),
        unit_name,
        stamp_ns,
        SampleTimes(stamp_ns),
        values,
        None,
        None,
    )


def compass(bias_mgauss: tuple[float, float, float], from_s: float, until_s: float) -> SensorSeries:
    rng = np.random.default_rng(6)
    time_s = np.arange(0.0, END_S, 0.1)
    psi = yaw_rad(time_s)
    north, _, down = FIELD_MGAUSS
    body = np.stack([north * np.cos(psi), -north * np.sin(psi), np.full(len(psi), down)], axis=1)
    body += 3.0 * rng.normal(size=body.shape)
    body[(time_s >= from_s) & (time_s < until_s)] += bias_mgauss
    return series("magnetometer", "mGauss", time_s, body)


@pytest.mark.parametrize("bias", [(30.0, 66.5, 0.0), (-60.0, 41.5, 10.0)])
def test_interference_has_onset_end_and_size_while_the_vessel_turns(bias: tuple[float, float, float]) -> None:
    (step,) = field_steps(rotations(unit()), compass(bias, 60.0, 80.0))
    assert step.from_ns / S == pytest.approx(60.0, abs=0.2)
    assert step.until_ns is not None
    assert step.until_ns / S == pytest.approx(80.0, abs=0.2)
    assert step.size == pytest.approx(np.array(bias), abs=9.0)


def test_a_lasting_error_of_a_compass_has_an_onset_and_no_end() -> None:
    (step,) = field_steps(rotations(unit()), compass((50.0, -30.0, 20.0), 60.0, END_S + 1.0))
    assert step.from_ns / S == pytest.approx(60.0, abs=0.2)
    assert step.until_ns is None


def test_turning_and_noise_are_no_step_of_the_field() -> None:
    assert field_steps(rotations(unit()), compass((0.0, 0.0, 0.0), 60.0, 80.0)) == []


@pytest.mark.parametrize("late_s", [0.25, 0.0])
def test_a_compass_that_is_late_in_a_turn_and_catches_up_is_no_step_of_the_field(late_s: float) -> None:
    """In half a second, the lag grows to `late_s`. Then the compass is as before."""
    rates = np.zeros((len(unit().stamp_ns), 3))
    rates[:, 2] = 0.6
    circling, time_s = replace(unit(), gyro_radps=rates), np.arange(0.0, END_S, 0.1)
    north, _, down = FIELD_MGAUSS
    seen_s = time_s - late_s * np.clip((time_s - 60.0) / 0.5, 0.0, 1.0) * (time_s < 60.75)
    body = np.stack([north * np.cos(0.6 * seen_s), -north * np.sin(0.6 * seen_s), np.full(len(seen_s), down)], axis=1)
    assert field_steps(rotations(circling), series("magnetometer", "mGauss", time_s, body)) == []
    body[time_s >= 60.0] += (60.0, 0.0, 0.0)
    (step,) = field_steps(rotations(circling), series("magnetometer", "mGauss", time_s, body))
    assert step.from_ns == pytest.approx(60.0 * S, abs=0.8 * S)


def test_a_turn_that_no_gyroscope_measured_is_no_step_of_the_field() -> None:
    whole = unit()
    rows = (whole.stamp_ns < 60 * S) | (whole.stamp_ns > 63 * S)
    assert whole.gyro_radps is not None
    cut = replace(whole, stamp_ns=whole.stamp_ns[rows], gyro_radps=whole.gyro_radps[rows])
    assert field_steps(rotations(cut), compass((0.0, 0.0, 0.0), 0.0, 0.0)) == []


def test_a_pressure_that_is_off_for_a_time_has_onset_end_and_size() -> None:
    rng = np.random.default_rng(7)
    time_s = np.arange(0.0, END_S, 0.1)
    pressure_pa = 100_600.0 + 5.0 * np.sin(time_s) + 3.0 * rng.normal(size=len(time_s))
    clean = series("barometer", "Pa", time_s, pressure_pa[:, None])
    assert pressure_steps(clean, 36.0) == []
    off = pressure_pa - 300.0 * ((time_s >= 60.0) & (time_s < 80.0))
    (step,) = pressure_steps(series("barometer", "Pa", time_s, off[:, None]), 36.0)
    assert (step.from_ns / S, (step.until_ns or 0) / S) == pytest.approx((60.0, 80.0), abs=0.2)
    assert step.size[0] == pytest.approx(-300.0, rel=0.05)


def level() -> Series:
    stamp_ns = np.arange(0, round(END_S * S), S // 10, dtype=np.int64)
    return Series(stamp_ns, np.zeros(len(stamp_ns)), "deg", "ATT.Roll")


@pytest.mark.parametrize("bias_degps", [3.44, -2.5])
def test_a_bias_of_the_gyroscope_is_measured_by_the_heading_of_the_compass(bias_degps: float) -> None:
    right = compass((0.0, 0.0, 0.0), 0.0, 0.0)
    (step,) = gyro_steps(unit(np.radians(bias_degps)), level(), level(), right)
    assert step.from_ns / S == pytest.approx(60.0, abs=1.0)
    assert step.until_ns is None
    assert np.degrees(step.size) == pytest.approx(np.array([0.0, 0.0, bias_degps]), abs=0.2)


def test_a_bias_of_the_gyroscope_is_found_in_a_log_of_a_minute() -> None:
    """Most of so short a log is near the onset."""
    right = compass((0.0, 0.0, 0.0), 0.0, 0.0)
    whole = unit(np.radians(2.5), 35.0)
    rows = whole.stamp_ns < 60 * S
    assert whole.gyro_radps is not None
    short = replace(whole, stamp_ns=whole.stamp_ns[rows], gyro_radps=whole.gyro_radps[rows])
    (step,) = gyro_steps(short, level(), level(), right)
    assert step.from_ns / S == pytest.approx(35.0, abs=1.0)
    assert np.degrees(step.size[2]) == pytest.approx(2.5, abs=0.3)


@pytest.mark.parametrize("seed", [1, 10, 11, 16, 17])
def test_a_short_log_of_a_roll_that_wanders_is_judged_to_its_end(seed: int) -> None:
    """The corrections of one change after the other grew without end."""
    whole, roll = unit(), level()
    wandering = np.cumsum(np.random.default_rng(seed).normal(0.0, 10.0 + seed, len(roll.values)))
    rows = whole.stamp_ns < (48.5 + seed % 7) * S
    assert whole.gyro_radps is not None
    short = replace(whole, stamp_ns=whole.stamp_ns[rows], gyro_radps=whole.gyro_radps[rows])
    for step in gyro_steps(short, replace(roll, values=wandering), level(), None):
        assert np.isfinite(step.size).all()


def wave(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch (deg) of a vessel that also turns."""
    return 15.0 * np.sin(0.4 * time_s + 1.0), 12.0 * np.sin(0.3 * time_s) + 8.0


def attitude(time_s: np.ndarray) -> Rotation:
    roll_deg, pitch_deg = wave(time_s)
    return Rotation.from_euler(
        "ZYX", np.stack([np.degrees(yaw_rad(time_s)), pitch_deg, roll_deg], axis=1), degrees=True
    )


@pytest.mark.parametrize("bias_degps", [(0.0, 0.0, 0.0), (0.0, 0.0, 2.5), (-2.5, 0.0, 0.0), (0.0, 2.5, 0.0)])
def test_a_bias_of_the_gyroscope_in_waves_is_on_its_axis(bias_degps: tuple[float, float, float]) -> None:
    """Against the rates of scipy: a vessel that rolls, pitches and turns has no bias by its motion alone."""
    time_s = np.arange(0.0, END_S, 0.02)
    turns = attitude(np.append(-0.02, time_s))
    rates = (turns[:-1].inv() * turns[1:]).as_rotvec() / 0.02
    biased = rates + np.radians(bias_degps) * (time_s >= 60.0)[:, None]
    seen_s = np.arange(0.0, END_S, 0.1)
    field = series("magnetometer", "mGauss", seen_s, attitude(seen_s).inv().apply(FIELD_MGAUSS))
    roll_deg, pitch_deg = (replace(level(), values=angle_deg) for angle_deg in wave(level().stamp_ns / S))
    found = gyro_steps(replace(unit(), gyro_radps=biased), roll_deg, pitch_deg, field)
    if not any(bias_degps):
        assert found == []
        return
    (step,) = found
    assert step.from_ns / S == pytest.approx(60.0, abs=1.0)
    # The angles of Euler also turn, by the tangents of roll and pitch.
    assert np.degrees(step.size) == pytest.approx(np.array(bias_degps), abs=0.5)


@pytest.mark.parametrize("until_s", [80.0, END_S + 1.0])
def test_interference_of_the_compass_is_no_bias_of_the_gyroscope(until_s: float) -> None:
    off = compass((30.0, 66.5, 0.0), 60.0, until_s)
    assert gyro_steps(unit(), level(), level(), off, field_steps(rotations(unit()), off)) == []


@pytest.mark.parametrize("until_s", [78.0, END_S + 1.0])
@pytest.mark.parametrize("bias_degps", [0.0, 3.0])
def test_a_compass_that_repeats_a_value_shows_no_other_bias_of_the_gyroscope(bias_degps: float, until_s: float) -> None:
    """The bias begins before the compass stops, while the vessel circles."""
    rates = np.zeros((len(unit().stamp_ns), 3))
    rates[:, 2] = 0.3 + np.radians(bias_degps) * (unit().stamp_ns >= 40 * S)
    circling, time_s = replace(unit(), gyro_radps=rates), np.arange(0.0, END_S, 0.1)
    north, _, down = FIELD_MGAUSS
    psi = 0.3 * time_s
    body = np.stack([north * np.cos(psi), -north * np.sin(psi), np.full(len(psi), down)], axis=1)
    held = (time_s >= 60.0) & (time_s < until_s)
    body[held] = body[np.flatnonzero(held)[0]]
    steps = gyro_steps(circling, level(), level(), series("magnetometer", "mGauss", time_s, body))
    assert [(step.from_ns / S, np.degrees(step.size[2]), step.until_ns) for step in steps] == (
        [(pytest.approx(40.0, abs=0.5), pytest.approx(bias_degps, abs=0.2), None)] if bias_degps else []
    )


def test_a_compass_that_soon_stops_for_good_is_too_short_to_judge_the_gyroscope() -> None:
    time_s = np.arange(0.0, END_S, 0.1)
    right = compass((0.0, 0.0, 0.0), 0.0, 0.0)
    held = right.values.copy()
    held[time_s >= 12.0] = held[120]
    assert gyro_steps(unit(np.radians(3.0), 5.0), level(), level(), replace(right, values=held)) == []


def test_a_compass_that_is_off_in_circles_is_no_bias_of_the_gyroscope() -> None:
    """An error that far exceeds the level field hides the turns: the heading hardly changes any more."""
    rates = np.zeros((len(unit().stamp_ns), 3))
    rates[:, 2] = 0.15
    circling, time_s = replace(unit(), gyro_radps=rates), np.arange(0.0, END_S, 0.1)
    north, _, down = FIELD_MGAUSS
    psi = 0.15 * time_s
    body = np.stack([north * np.cos(psi), -north * np.sin(psi), np.full(len(psi), down)], axis=1)
    body[time_s >= 60.0] += (1500.0, 0.0, 0.0)
    off = series("magnetometer", "mGauss", time_s, body)
    (step,) = field_steps(rotations(circling), off)
    assert step.until_ns is None
    assert gyro_steps(circling, level(), level(), off, [step]) == []
    assert gyro_steps(circling, level(), level(), off)  # without the step, it is taken for one


def with_error(error: np.ndarray) -> SensorSeries:
    """The compass with an error (N, 3) in body axes."""
    right = compass((0.0, 0.0, 0.0), 0.0, 0.0)
    return series("magnetometer", "mGauss", right.stamp_ns / S, right.values + error)


def test_an_error_from_the_start_of_the_log_has_a_size() -> None:
    error = field_error(rotations(unit()), compass((60.0, -45.0, 0.0), 0.0, END_S + 1.0), None)
    assert error is not None
    assert error.offset_mgauss == pytest.approx(np.array([60.0, -45.0]), abs=6.0)
    assert not error.growth_mgauss_per_s.any()


def test_an_error_that_grows_slowly_has_a_rate() -> None:
    time_s = np.arange(0.0, END_S, 0.1)
    error = field_error(rotations(unit()), with_error(np.outer(time_s / END_S, [0.0, 90.0, 0.0])), None)
    assert error is not None
    assert error.growth_mgauss_per_s * END_S == pytest.approx(np.array([0.0, 90.0]), abs=9.0)
    assert not error.offset_mgauss.any()


def test_an_error_that_follows_the_motors_is_their_current() -> None:
    time_s = np.arange(0.0, END_S, 0.1)
    drive = (0.6 + 0.3 * np.sin(0.7 * time_s)) ** 2
    error = field_error(rotations(unit()), with_error(np.outer(drive, [70.0, 30.0, 20.0])), drive)
    assert error is not None
    assert error.drive_mgauss == pytest.approx(np.array([70.0, 30.0]), abs=8.0)
    assert not error.offset_mgauss.any()
    assert not error.growth_mgauss_per_s.any()


def test_a_good_compass_has_no_lasting_error() -> None:
    drive = (0.6 + 0.3 * np.sin(0.07 * np.arange(0.0, END_S, 0.1))) ** 2
    error = field_error(rotations(unit()), compass((0.0, 0.0, 0.0), 0.0, 0.0), drive)
    assert error is not None
    assert not any(part.any() for part in (error.offset_mgauss, error.growth_mgauss_per_s, error.drive_mgauss))


def test_a_bias_of_the_gyroscope_from_the_start_of_the_log_has_a_size() -> None:
    (step,) = gyro_steps(unit(np.radians(2.0), 0.0), level(), level(), compass((0.0, 0.0, 0.0), 0.0, 0.0))
    assert (step.from_ns, step.until_ns) == (0, None)
    assert np.degrees(step.size) == pytest.approx(np.array([0.0, 0.0, 2.0]), abs=0.2)
