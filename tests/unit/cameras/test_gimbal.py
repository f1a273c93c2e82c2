"""Mounts and gimbals of cameras."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_core import frames
from sim_core.frames import Array
from sim_core.sensors.camera_spec import CameraSpec, GimbalSpec
from xitl_cli.plugins.cameras.gimbal import Gimbal
from xitl_cli.plugins.cameras.studio import horizon_px, lens_of


def attitude(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Array:
    rotation: Array = frames.quat_to_matrix(frames.euler_to_quat(np.radians([roll_deg, pitch_deg, yaw_deg])))
    return rotation


@pytest.mark.parametrize(
    ("keys", "ahead_frd"),
    [
        ({}, (1.0, 0.0, 0.0)),
        ({"yaw_deg": 90.0}, (0.0, 1.0, 0.0)),
        ({"pitch_deg": -90.0}, (0.0, 0.0, 1.0)),
        ({"pitch_deg": 30.0}, (math.cos(math.pi / 6), 0.0, -0.5)),
    ],
)
def test_a_fixed_camera_looks_where_its_keys_say(keys: dict[str, float], ahead_frd: tuple[float, ...]) -> None:
    vessel = attitude(5.0, -3.0, 140.0)
    axes = Gimbal(CameraSpec(**keys)).rot_ned_optical(vessel)
    np.testing.assert_allclose(axes[:, 2], vessel @ ahead_frd, atol=1e-12)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)


def test_a_stabilised_gimbal_keeps_the_horizon_level() -> None:
    camera = CameraSpec(gimbal=GimbalSpec())
    gimbal = Gimbal(camera)
    gimbal.command(-10.0, 20.0)
    gimbal.advance(10.0)
    rows = []
    for roll_deg, pitch_deg in ((0.0, 0.0), (12.0, -7.0), (-20.0, 5.0)):
        axes = gimbal.rot_ned_optical(attitude(roll_deg, pitch_deg, 55.0))
        assert math.degrees(math.asin(-axes[2, 2])) == pytest.approx(-10.0)
        rows.append(horizon_px(lens_of(camera), axes))
    level_row = 239.5 - lens_of(camera).focal_px * math.tan(math.radians(10.0))
    np.testing.assert_allclose(rows, level_row, atol=1e-6)


def test_a_gimbal_turns_at_its_rate_to_its_limits() -> None:
    gimbal = Gimbal(CameraSpec(gimbal=GimbalSpec(rate_degps=40.0, yaw_limits_deg=(-30.0, 90.0))))
    gimbal.command(-120.0, -60.0)
    gimbal.advance(0.5)
    assert (gimbal.pitch_deg, gimbal.yaw_deg) == (-20.0, -20.0)
    gimbal.advance(10.0)
    assert (gimbal.pitch_deg, gimbal.yaw_deg) == (-90.0, -30.0)


def test_commands_do_not_turn_a_fixed_camera() -> None:
    gimbal = Gimbal(CameraSpec())
    gimbal.command(-30.0, 45.0)
    gimbal.advance(5.0)
    np.testing.assert_array_equal(gimbal.rot_ned_optical(np.eye(3)), Gimbal(CameraSpec()).rot_ned_optical(np.eye(3)))


def test_a_gimbal_that_is_not_stabilised_leans_with_the_vessel() -> None:
    gimbal = Gimbal(CameraSpec(gimbal=GimbalSpec(stabilised=False)))
    vessel = attitude(15.0, 8.0, 0.0)
    np.testing.assert_allclose(gimbal.rot_ned_optical(vessel)[:, 2], vessel[:, 0], atol=1e-12)
