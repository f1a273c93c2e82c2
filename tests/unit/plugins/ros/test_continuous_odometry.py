"""The frame `odom`: continuous, with the jumps of the estimate in `map` to `odom`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xitl_cli.plugins.ros.conversion import ContinuousOdometry, rotated

PERIOD_NS = 40_000_000


def test_a_correction_moves_odom_and_not_the_vessel_in_it() -> None:
    """Ahead east at 1 m/s; GNSS moves the estimate by 0.14 m to the north after a second."""
    odometry, velocity = ContinuousOdometry(), np.array([1.0, 0.0, 0.0])
    places = []
    for number in range(51):
        true = np.array([10.0 + number * 0.04, -5.0, 0.0])
        correction = np.array([0.0, 0.14 if number >= 25 else 0.0, 0.0])
        places.append(odometry.update(number * PERIOD_NS, true + correction, velocity))
        assert places[-1] + odometry.origin_map_m == pytest.approx(true + correction)
    assert places[0] == pytest.approx([10.0, -5.0, 0.0])
    assert np.diff(places, axis=0) == pytest.approx(np.tile([0.04, 0.0, 0.0], (50, 1)))
    assert odometry.origin_map_m == pytest.approx([0.0, 0.14, 0.0])


def test_a_circle_closes() -> None:
    """Radius 10 m at 2 m/s, at 25 Hz: the trapezoid's error of a chord is below a millimetre."""
    odometry, rate = ContinuousOdometry(), 0.2
    for number in range(round(2.0 * math.pi / rate * 25) + 1):
        angle = rate * number * PERIOD_NS * 1e-9
        place = 10.0 * np.array([math.sin(angle), -math.cos(angle), 0.0])
        odometry.update(number * PERIOD_NS, place, 2.0 * np.array([math.cos(angle), math.sin(angle), 0.0]))
    assert np.abs(odometry.origin_map_m).max() < 1e-3


def test_an_estimate_that_is_not_finite_changes_nothing() -> None:
    odometry, still = ContinuousOdometry(), np.zeros(3)
    odometry.update(0, np.ones(3), still)
    assert odometry.update(PERIOD_NS, np.full(3, math.nan), still) == pytest.approx(np.ones(3))
    assert odometry.origin_map_m == pytest.approx(still)


def test_rotation_is_scipy_s() -> None:
    turn = Rotation.from_euler("ZYX", [130.0, 12.0, -33.0], degrees=True)
    x, y, z, w = turn.as_quat().tolist()
    vector = np.array([1.0, -2.0, 0.5])
    assert rotated((w, x, y, z), vector) == pytest.approx(turn.apply(vector))
