"""Odometry against the motion it starts from, and its drift against a random walk's variance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from motion import at_rest, swinging

from sim_core.frames import quat_to_matrix
from sim_core.sensors.odometry import Odometry
from sim_core.sensors.spec import OdometrySpec


def test_without_errors_it_is_the_motion_since_its_start_in_the_axes_of_then() -> None:
    rng = np.random.default_rng(1)
    odometry = Odometry(OdometrySpec())
    state, first = odometry.measure(odometry.initial(1, rng), swinging(1.0), rng)
    np.testing.assert_allclose(first.pos_local_m, 0.0, atol=1e-12)
    start, now = swinging(1.0), swinging(4.0)
    _, sample = odometry.measure(state, now, rng)
    yaw = math.atan2(start.rot_ned_frd[0, 1, 0], start.rot_ned_frd[0, 0, 0])
    turn = np.array([[math.cos(yaw), math.sin(yaw), 0], [-math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    np.testing.assert_allclose(sample.pos_local_m[0], turn @ (now.pos_ned_m - start.pos_ned_m)[0], atol=1e-12)
    np.testing.assert_allclose(quat_to_matrix(sample.quat_local_frd)[0], turn @ now.rot_ned_frd[0], atol=1e-12)
    np.testing.assert_allclose(sample.vel_frd_mps[0], now.rot_ned_frd[0].T @ now.vel_ned_mps[0], atol=1e-12)
    np.testing.assert_allclose(sample.gyro_frd_radps, now.gyro_frd_radps)


@pytest.mark.medium
def test_drift_grows_with_the_root_of_time_and_it_says_how_far() -> None:
    """0.1 m and 0.5 degrees a root second over 16 s: 0.4 m and 2 degrees; of 3000 within 5 % (3.9 sigma)."""
    rng = np.random.default_rng(3)
    odometry = Odometry(OdometrySpec(rate_hz=10.0, drift_mprts=0.1, yaw_drift_degprts=0.5))
    state, truth = odometry.initial(3000, rng), at_rest(3000)
    for _ in range(161):
        state, sample = odometry.measure(state, truth, rng)
    assert sample.pos_local_m[:, 0].std() == pytest.approx(0.4, rel=0.05)
    assert sample.position_deviation_m[0] == pytest.approx(0.4)
    rotation = quat_to_matrix(sample.quat_local_frd)
    yaw_deg = np.degrees(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
    assert yaw_deg.std() == pytest.approx(2.0, rel=0.05)
    assert math.degrees(sample.yaw_deviation_rad[0]) == pytest.approx(2.0)


@pytest.mark.medium
def test_a_drifting_heading_bends_the_way_and_moves_nothing_behind() -> None:
    """At 1 m/s north each step stays 0.1 m long; the way ends aside by v s t^1.5 / sqrt(3): of 3000 within 5 %."""
    rng = np.random.default_rng(6)
    odometry = Odometry(OdometrySpec(rate_hz=10.0, yaw_drift_degprts=0.5))
    state = odometry.initial(3000, rng)
    places = []
    for number in range(401):
        state, sample = odometry.measure(state, at_rest(3000, pos_ned_m=(0.1 * number, 0.0, 0.0)), rng)
        places.append(sample.pos_local_m)
    np.testing.assert_allclose(np.linalg.norm(np.diff(places, axis=0), axis=2), 0.1, atol=1e-12)
    assert places[-1][:, 1].std() == pytest.approx(math.radians(0.5) * 40.0**1.5 / math.sqrt(3.0), rel=0.05)


def test_the_first_sample_has_not_wandered_yet() -> None:
    odometry = Odometry(OdometrySpec(rate_hz=1.0, drift_mprts=5.0, yaw_drift_degprts=40.0))
    rng = np.random.default_rng(5)
    _, sample = odometry.measure(odometry.initial(50, rng), at_rest(50), rng)
    np.testing.assert_allclose(sample.pos_local_m, 0.0, atol=1e-12)
    np.testing.assert_allclose(sample.quat_local_frd[:, 3], 0.0, atol=1e-12)
    assert (sample.position_deviation_m[0], sample.yaw_deviation_rad[0]) == (0.0, 0.0)


def test_white_noise_is_that_of_the_configuration() -> None:
    rng = np.random.default_rng(4)
    odometry = Odometry(
        OdometrySpec(position_noise_m=0.05, velocity_noise_mps=0.02, attitude_noise_deg=0.3, rate_noise_radps=0.01)
    )
    _, sample = odometry.measure(odometry.initial(4000, rng), at_rest(4000), rng)
    assert sample.pos_local_m.std() == pytest.approx(0.05, rel=0.03)
    assert sample.vel_frd_mps.std() == pytest.approx(0.02, rel=0.03)
    assert sample.gyro_frd_radps.std() == pytest.approx(0.01, rel=0.03)
    assert np.degrees(2.0 * sample.quat_local_frd[:, 1:]).std() == pytest.approx(0.3, rel=0.03)
    kinds = [sample.pos_local_m, sample.vel_frd_mps, sample.gyro_frd_radps, sample.quat_local_frd[:, 1:]]
    related = np.corrcoef(np.concatenate(kinds, axis=1), rowvar=False) - np.eye(12)
    assert np.abs(related).max() < 0.07  # 4.4 sigma of 4000 independent draws


def test_what_cannot_be_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"OdometrySpec.drift_mprts = -0.1"):
        Odometry(OdometrySpec(drift_mprts=-0.1))
