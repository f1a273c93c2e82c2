"""The estimate of an estimator without errors: each value of the true motion in its place."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.kinematics import Kinematics
from xitl_cli.run.nodes.direct_control import true_estimate


def motion(attitude: Rotation) -> Kinematics:
    x, y, z, w = attitude.as_quat().tolist()
    row = np.arange(1.0, 4.0)[None]
    return Kinematics(
        pos_ned_m=row,
        vel_ned_mps=10.0 * row,
        acc_ned_mps2=0.0 * row,
        quat_ned_frd=np.array([[w, x, y, z]]),
        rot_ned_frd=attitude.as_matrix()[None],
        gyro_frd_radps=0.1 * row,
        angular_acc_frd_radps2=0.0 * row,
    )


@pytest.mark.parametrize("yaw_pitch_roll_deg", [(200.0, 10.0, -30.0), (-100.0, -80.0, 170.0), (45.0, 0.0, 5.0)])
def test_the_angles_are_those_of_the_attitude(yaw_pitch_roll_deg: tuple[float, float, float]) -> None:
    attitude = Rotation.from_euler("ZYX", yaw_pitch_roll_deg, degrees=True)
    estimate = true_estimate(123, motion(attitude))
    yaw, pitch, roll = attitude.as_euler("ZYX").tolist()
    assert (estimate.roll_rad, estimate.pitch_rad, estimate.yaw_rad) == pytest.approx((roll, pitch, yaw), abs=1e-12)
    x, y, z, w = attitude.as_quat().tolist()
    assert estimate.quat_ned_frd == pytest.approx((w, x, y, z))
    assert estimate.stamp_ns == 123
    assert estimate.gyro_frd_radps == pytest.approx((0.1, 0.2, 0.3))
    assert estimate.pos_ned_m == (1.0, 2.0, 3.0)
    assert estimate.vel_ned_mps == (10.0, 20.0, 30.0)


def test_a_bow_that_points_up_has_a_pitch_of_a_right_angle() -> None:
    """The sine may exceed 1 by rounding."""
    upright = motion(Rotation.identity())
    upright.rot_ned_frd[0] = [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [-1.0 - 1e-15, 0.0, 0.0]]
    assert true_estimate(0, upright).pitch_rad == pytest.approx(0.5 * math.pi)
