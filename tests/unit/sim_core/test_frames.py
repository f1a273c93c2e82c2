"""Attitudes against scipy's rotations; frame changes against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core import frames

ROTATIONS = Rotation.random(500, random_state=3)
QUATS = ROTATIONS.as_quat()[:, [3, 0, 1, 2]]


def test_matrix_agrees_with_scipy() -> None:
    np.testing.assert_allclose(frames.quat_to_matrix(QUATS), ROTATIONS.as_matrix(), atol=1e-14)


def test_matrix_keeps_leading_axes() -> None:
    assert frames.quat_to_matrix(QUATS.reshape(5, 100, 4)).shape == (5, 100, 3, 3)
    assert frames.quat_to_matrix(QUATS[0]).shape == (3, 3)


def test_quaternion_comes_back_from_matrix() -> None:
    half_turns = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [1, 0, 0, 0]])  # where the trace is smallest
    quats = np.concatenate([QUATS, half_turns])
    back = frames.matrix_to_quat(frames.quat_to_matrix(quats))
    np.testing.assert_allclose(np.abs((back * quats).sum(axis=1)), 1.0, atol=1e-14)
    assert (back[:, 0] >= 0.0).all()


def test_euler_angles_agree_with_scipy() -> None:
    yaw_pitch_roll = ROTATIONS.as_euler("ZYX")
    np.testing.assert_allclose(frames.quat_to_euler(QUATS), yaw_pitch_roll[:, ::-1], atol=1e-7)
    back = frames.euler_to_quat(yaw_pitch_roll[:, ::-1])
    np.testing.assert_allclose(frames.quat_to_matrix(back), ROTATIONS.as_matrix(), atol=1e-12)


def test_product_turns_right_then_left() -> None:
    other = ROTATIONS[::-1]
    product = frames.quat_multiply(QUATS, QUATS[::-1])
    np.testing.assert_allclose(frames.quat_to_matrix(product), (ROTATIONS * other).as_matrix(), atol=1e-13)
    identity = frames.quat_multiply(QUATS, frames.quat_conjugate(QUATS))
    np.testing.assert_allclose(identity, np.tile([1.0, 0, 0, 0], (len(QUATS), 1)), atol=1e-14)


def test_ned_enu_and_frd_flu() -> None:
    np.testing.assert_array_equal(frames.ned_to_enu(np.array([[1.0, 2.0, 3.0]])), [[2.0, 1.0, -3.0]])
    np.testing.assert_array_equal(frames.enu_to_ned(np.array([[2.0, 1.0, -3.0]])), [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(frames.frd_to_flu(np.array([1.0, 2.0, 3.0])), [1.0, -2.0, -3.0])
    np.testing.assert_array_equal(frames.flu_to_frd(np.array([1.0, -2.0, -3.0])), [1.0, 2.0, 3.0])


def test_attitude_in_enu_turns_the_same_vectors() -> None:
    v_frd = np.random.default_rng(1).standard_normal((len(QUATS), 3))
    in_ned = np.einsum("nij,nj->ni", ROTATIONS.as_matrix(), v_frd)
    enu_flu = frames.quat_to_matrix(frames.quat_ned_frd_to_enu_flu(QUATS))
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", enu_flu, frames.frd_to_flu(v_frd)), frames.ned_to_enu(in_ned), atol=1e-13
    )


def test_a_boat_heading_north_has_enu_yaw_of_90_degrees() -> None:
    enu_flu = frames.quat_ned_frd_to_enu_flu(np.array([[1.0, 0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(frames.quat_to_euler(enu_flu), [[0.0, 0.0, np.pi / 2]], atol=1e-15)


@pytest.mark.parametrize(("angle", "wrapped"), [(3.5, 3.5 - 2 * np.pi), (-np.pi, -np.pi), (np.pi, -np.pi), (0.1, 0.1)])
def test_wrap(angle: float, wrapped: float) -> None:
    assert frames.wrap_pi(np.array([angle]))[0] == pytest.approx(wrapped)


def test_normalize() -> None:
    np.testing.assert_allclose(frames.quat_normalize(3.0 * QUATS), QUATS, atol=1e-15)
