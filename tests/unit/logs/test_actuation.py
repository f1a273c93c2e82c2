"""Drifts of a receiver and sags of a battery against made series whose onset and size are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.signals.receivers import GnssReceiver
from xitl_cli.plugins.logs.analyses.actuation import battery_sags
from xitl_cli.plugins.logs.analyses.gnss_drift import gnss_drifts, velocity_jumped

S = 1_000_000_000


def receiver(drift_mps: float, bearing_deg: float = 90.0, *, shared: bool = False, seed: int = 4) -> GnssReceiver:
    """Two minutes on a circle at 5 Hz, with the usual noise; the drift lasts from 40 to 80 s and then stays."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(600) * 0.2
    place = 30.0 * np.stack([np.sin(0.1 * time_s), np.cos(0.1 * time_s), 0 * time_s], axis=1)
    speed = 3.0 * np.stack([np.cos(0.1 * time_s), -np.sin(0.1 * time_s), 0 * time_s], axis=1)
    walk = np.zeros((600, 2))  # 0.5 m that changes over a minute
    for row in range(1, 600):
        walk[row] = math.exp(-0.2 / 60) * walk[row - 1] + 0.5 * math.sqrt(1 - math.exp(-0.4 / 60)) * rng.normal(size=2)
    way = math.radians(bearing_deg)
    drift = drift_mps * np.outer(np.clip(time_s - 40.0, 0.0, 40.0), [math.cos(way), math.sin(way)])
    place[:, :2] += walk + drift + 0.15 * rng.normal(size=(600, 2))
    speed += 0.05 * rng.normal(size=(600, 3))
    if shared:
        inside = (time_s >= 40.0) & (time_s < 80.0)
        speed[inside, :2] += drift_mps * np.array([math.cos(way), math.sin(way)])
    lat_deg, lon_deg, _ = LocalFrame(-8.8, -63.9, 60.0).geodetic(place)
    stamp_ns = np.round(time_s * S).astype(np.int64)
    fix, fields = np.full(600, 3), {"lat": "Lat"}
    return GnssReceiver(
        "GPS", "GPS", fields, stamp_ns, stamp_ns, fix, None, None, lat_deg, lon_deg, speed, None, None, None
    )


@pytest.mark.medium
@pytest.mark.parametrize(("rate_mps", "bearing_deg"), [(0.3, 90.0), (0.5, 210.0)])
def test_a_position_that_leaves_its_velocity_drifts_with_onset_rate_and_bearing(
    rate_mps: float, bearing_deg: float
) -> None:
    """The slow error of the receiver, 0.5 m, moves the ends by as long as the drift takes for it."""
    drifts = [drift for seed in range(8) for drift in gnss_drifts(receiver(rate_mps, bearing_deg, seed=seed))]
    assert len(drifts) == 8
    assert np.median([abs(drift.from_ns / S - 40.0) for drift in drifts]) < 0.5 / rate_mps
    assert np.median([abs(drift.until_ns / S - 80.0) for drift in drifts]) < 0.5 / rate_mps
    for drift in drifts:
        assert drift.speed_mps == pytest.approx(rate_mps, rel=0.25)
        assert drift.bearing_deg == pytest.approx(bearing_deg, abs=10.0)


def test_the_slow_error_of_a_good_receiver_is_no_drift() -> None:
    assert gnss_drifts(receiver(0.0)) == []


@pytest.mark.medium
def test_the_random_error_of_reflected_signals_is_no_drift() -> None:
    """An error of 5 m that changes over 8 s strays by a metre a second for up to 15 s."""
    rng = np.random.default_rng(1)
    good = receiver(0.0)
    share = math.exp(-0.2 / 8.0)
    for _ in range(3):
        error_m = np.zeros((600, 3))
        for row in range(1, 600):
            error_m[row, :2] = share * error_m[row - 1, :2] + 5.0 * math.sqrt(1.0 - share**2) * rng.normal(size=2)
        off_deg = np.degrees(error_m / 6.371e6)
        reflected = replace(good, lat_deg=good.lat_deg + off_deg[:, 0], lon_deg=good.lon_deg + off_deg[:, 1])
        assert gnss_drifts(reflected) == []


@pytest.mark.parametrize("gap_s", [2.0, 4.0, 20.0])
def test_a_gap_in_which_the_boat_turns_is_no_drift(gap_s: float) -> None:
    """Its way across the gap is 2.5 m off the mean of the velocities before and after."""
    whole = receiver(0.0)
    kept = (whole.stamp_ns < 50 * S) | (whole.stamp_ns > (50 + gap_s) * S)
    aside_deg = np.where(whole.stamp_ns > 50 * S, math.degrees(2.5 / 6.371e6), 0.0)
    arrays = ("stamp_ns", "sample_ns", "fix", "lat_deg", "lon_deg", "vel_ned_mps")
    turned = replace(whole, lon_deg=whole.lon_deg + aside_deg)
    assert gnss_drifts(replace(turned, **{name: getattr(turned, name)[kept] for name in arrays})) == []


def test_a_repeated_position_is_no_drift() -> None:
    """A receiver that no longer measures repeats its last position and velocity."""
    whole = receiver(0.0)
    rows = np.arange(600)
    rows[200:300] = 200
    held = {name: getattr(whole, name)[rows] for name in ("lat_deg", "lon_deg", "vel_ned_mps")}
    assert gnss_drifts(replace(whole, **held)) == []


def test_a_position_that_jumps_and_jumps_back_does_not_drift() -> None:
    whole = receiver(0.0)
    off_deg = np.where((whole.stamp_ns > 50 * S) & (whole.stamp_ns < 70 * S), math.degrees(10.0 / 6.371e6), 0.0)
    assert gnss_drifts(replace(whole, lat_deg=whole.lat_deg + off_deg)) == []


@pytest.mark.medium
def test_a_velocity_that_changes_at_once_is_wrong_and_not_the_position() -> None:
    """An error of 1.2 m/s to the north, from 40 to 70 s."""
    whole = receiver(0.0)
    inside = (whole.stamp_ns >= 40 * S) & (whole.stamp_ns < 70 * S)
    wrong = replace(whole, vel_ned_mps=whole.vel_ned_mps + np.outer(inside, [1.2, 0.0, 0.0]))
    (drift,) = gnss_drifts(wrong)
    assert drift.from_ns / S == pytest.approx(40.0, abs=0.5)
    assert drift.until_ns / S == pytest.approx(70.0, abs=0.5)
    assert drift.speed_mps == pytest.approx(1.2, rel=0.1)
    assert velocity_jumped(wrong, drift)
    slid = receiver(1.2)
    (drift,) = gnss_drifts(slid)
    assert not velocity_jumped(slid, drift)


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(4))
def test_a_position_that_drifts_in_waves_is_not_a_wrong_velocity(seed: int) -> None:
    """Waves change the velocity of a small boat by as much from fix to fix as an error that begins at once."""
    calm = receiver(0.6, seed=seed)
    waves_mps = 0.12 * np.random.default_rng(20 + seed).normal(size=calm.vel_ned_mps.shape)
    rough = replace(calm, vel_ned_mps=calm.vel_ned_mps + waves_mps)
    drifts = gnss_drifts(rough)
    assert drifts
    assert not any(velocity_jumped(rough, drift) for drift in drifts)


def test_a_drift_that_the_velocity_shares_cannot_be_seen() -> None:
    assert gnss_drifts(receiver(0.3, shared=True)) == []


def battery(drop_v: float, added_ohm: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two minutes at 10 Hz under a current that changes; the fault begins at 60 s."""
    rng = np.random.default_rng(2)
    time_s = np.arange(1200) * 0.1
    current_a = 10.0 + 5.0 * np.sin(0.5 * time_s) + 3.0 * (time_s > 30.0)
    after = time_s >= 60.0
    voltage_v = 16.0 - 0.002 * time_s - (0.05 + added_ohm * after) * current_a - drop_v * after
    return (time_s * S).astype(np.int64), voltage_v + 0.02 * rng.normal(size=1200), current_a


def test_a_voltage_that_falls_for_good_is_a_sag_with_onset_and_size() -> None:
    (sag,) = battery_sags(*battery(2.5))
    assert sag.from_ns / S == pytest.approx(60.0, abs=0.3)
    assert sag.drop_v == pytest.approx(2.5, rel=0.05)


def test_a_resistance_that_grows_is_a_sag_by_what_it_takes_at_the_current_then() -> None:
    (sag,) = battery_sags(*battery(0.0, added_ohm=0.08))
    assert sag.from_ns / S == pytest.approx(60.0, abs=0.5)
    assert sag.drop_v == pytest.approx(0.08 * 13.0, rel=0.4)  # 13 A at the mean, 8 to 18 as it swings


def test_a_battery_that_only_empties_under_changing_currents_does_not_sag() -> None:
    assert battery_sags(*battery(0.0)) == []


def test_a_voltage_that_falls_under_a_steady_command_is_a_sag() -> None:
    """The motors then draw less, in proportion to the voltage: a current that falls does not explain a fall."""
    rng = np.random.default_rng(3)
    time_s = np.arange(600) * 0.1
    after = time_s >= 30.0
    current_a = (16.0 - 6.0 * after) / 1.5 * (1.0 + 0.002 * rng.normal(size=600))
    voltage_v = 16.0 - 6.0 * after - 0.05 * current_a + 0.02 * rng.normal(size=600)
    (sag,) = battery_sags((time_s * S).astype(np.int64), voltage_v, current_a)
    assert sag.from_ns / S == pytest.approx(30.0, abs=0.3)
    assert sag.drop_v == pytest.approx(6.0, abs=0.5)


@pytest.mark.medium
@pytest.mark.parametrize("row", range(300, 305))
def test_a_sag_is_found_at_each_row(row: int) -> None:
    """The current rises after it, as in a turn, and explains a part of the step."""
    rng = np.random.default_rng(row)
    time_s = np.arange(600) * 0.1
    after = np.arange(600) >= row
    current_a = 20.0 + 5.0 * np.sin(2.0 * time_s) + 40.0 * np.clip((time_s - time_s[row]) / 2.0, 0.0, 1.0)
    voltage_v = 58.7 - 0.03 * current_a - 5.0 * after + 0.02 * rng.normal(size=600)
    (sag,) = battery_sags((time_s * S).astype(np.int64), voltage_v, current_a)
    assert sag.from_ns / S == pytest.approx(time_s[row], abs=0.15)
    assert sag.drop_v == pytest.approx(5.0, rel=0.05)
