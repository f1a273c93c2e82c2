"""Poses between and beyond an autopilot's samples, their limits, and rotations against scipy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from agent.companion.pose_history import PoseHistory, VehiclePose
from agent.companion.rigid_motion import (
    cross_matrix,
    quaternion_from_euler,
    quaternion_of,
    quaternion_product,
    rotation_matrix,
    rotation_vector,
    turn_quaternion,
)

MS, S = 1_000_000, 1_000_000_000
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def quaternion(rotation: Rotation) -> np.ndarray:
    x, y, z, w = rotation.as_quat().tolist()
    return np.array([w, x, y, z])


def turned(degrees: float) -> np.ndarray:
    return quaternion(Rotation.from_euler("z", degrees, degrees=True))


def yaw_deg(pose: VehiclePose | None) -> float:
    assert pose is not None
    return float(np.degrees(np.arctan2(pose.rot_ned_frd[1, 0], pose.rot_ned_frd[0, 0])))


def history(*samples: tuple[int, float, float]) -> PoseHistory:
    """At these instants in milliseconds: a yaw in degrees and a position to the north, at 2 m/s and 40°/s."""
    kept = PoseHistory()
    for at_ms, yaw, north_m in samples:
        kept.add_attitude(at_ms * MS, turned(yaw), np.array([0.0, 0.0, np.radians(40.0)]))
        kept.add_position(at_ms * MS, np.array([north_m, 1.0, -1.0]), np.array([2.0 + north_m, 0.0, 0.0]))
    return kept


def test_between_samples_both_are_interpolated() -> None:
    kept = history((1000, 10.0, 3.0), (1100, 14.0, 5.0), (1300, 10.0, 1.0))
    for at_ms, yaw, north_m in (
        (1000, 10.0, 3.0),
        (1025, 11.0, 3.5),
        (1100, 14.0, 5.0),
        (1250, 11.0, 2.0),
        (1300, 10.0, 1.0),
    ):
        pose = kept.pose_at(at_ms * MS)
        assert pose is not None
        assert yaw_deg(pose) == pytest.approx(yaw, abs=2e-3)  # along the chord
        np.testing.assert_allclose(pose.pos_ned_m, [north_m, 1.0, -1.0])
        np.testing.assert_allclose(pose.vel_ned_mps, [2.0 + north_m, 0.0, 0.0])
        np.testing.assert_allclose(pose.rot_ned_frd @ pose.rot_ned_frd.T, np.eye(3), atol=1e-12)
    assert kept.newest_ns == 1300 * MS


def test_a_quaternion_and_its_negative_are_one_attitude() -> None:
    kept = PoseHistory()
    for at_ms, quat in ((0, turned(-10.0)), (100, -3.0 * turned(10.0))):  # of any length
        kept.add_attitude(at_ms * MS, quat, np.zeros(3))
        kept.add_position(at_ms * MS, np.zeros(3), np.zeros(3))
    assert yaw_deg(kept.pose_at(50 * MS)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("after_ns", "known"), [(0, True), (500 * MS, True), (500 * MS + 1, False), (-1, False)])
def test_half_a_second_is_extrapolated_and_nothing_before_the_first(after_ns: int, known: bool) -> None:
    kept = history((1000, 10.0, 3.0))
    pose = kept.pose_at(S + after_ns)
    assert (pose is not None) is known
    if pose is not None:
        assert yaw_deg(pose) == pytest.approx(10.0 + 40.0 * after_ns * 1e-9)
        np.testing.assert_allclose(pose.pos_ned_m, [3.0 + 5.0 * after_ns * 1e-9, 1.0, -1.0])


@pytest.mark.parametrize(("gap_ms", "known"), [(1500, True), (1501, False)])
def test_a_gap_of_more_than_a_second_and_a_half_is_not_bridged(gap_ms: int, known: bool) -> None:
    kept = history((1000, 0.0, 0.0), (1000 + gap_ms, 0.0, 0.0))
    assert (kept.pose_at(1100 * MS) is not None) is known
    assert kept.pose_at((1000 + gap_ms) * MS) is not None


def test_samples_of_five_seconds_are_kept() -> None:
    kept = history(*((100 * number, 0.0, 0.0) for number in range(61)))
    assert [kept.pose_at(at_ns) is not None for at_ns in (S - 1, S)] == [False, True]
    assert kept.steady_attitude_at(S) is not None
    assert kept.steady_attitude_at(S - 1) is None


@pytest.mark.parametrize(
    ("quat", "rate"), [((np.nan, 0.0, 0.0, 0.0), 0.0), ((0.3, 0.0, 0.3, 0.0), 0.0), ((1.0, 0.0, 0.0, 0.0), np.inf)]
)
def test_attitudes_that_are_none_and_samples_that_go_back_are_left_out(quat: tuple[float, ...], rate: float) -> None:
    kept = history((1000, 10.0, 3.0))
    kept.add_attitude(1100 * MS, np.array(quat), np.full(3, rate))
    kept.add_attitude(1000 * MS, turned(90.0), np.zeros(3))
    kept.add_position(1000 * MS, np.full(3, 9.0), np.zeros(3))
    kept.add_position(1100 * MS, np.array([np.nan, 0.0, 0.0]), np.zeros(3))
    kept.add_position(1100 * MS, np.zeros(3), np.array([0.0, np.inf, 0.0]))
    assert kept.newest_ns == S
    assert yaw_deg(kept.pose_at(S)) == pytest.approx(10.0)


def test_what_is_known_of_one_alone_is_no_pose() -> None:
    kept = PoseHistory()
    assert kept.newest_ns is None
    kept.add_attitude(2 * S, LEVEL, np.zeros(3))
    assert (kept.newest_ns, kept.pose_at(2 * S)) == (None, None)
    kept.add_position(S, np.zeros(3), np.zeros(3))
    assert kept.newest_ns == S
    kept.clear()
    assert (kept.newest_ns, kept.epoch, kept.steady_attitude_at(2 * S)) == (None, 1, None)


@pytest.mark.parametrize(
    ("after_ms", "jump_deg", "steady_deg"),
    [
        (100, 1.3, 5.3),  # up to 1° and a tenth of the turn of 4°, it is a turn
        (100, 1.5, 4.0),  # a step: only the rates count
        (100, -1.5, 4.0),
        (100, -1.3, 2.7),
        (299, 3.0, 11.96),
        (299, 2.1, 14.06),
        (301, 30.0, 42.04),  # too long after the sample before to compare
    ],
)
def test_steps_of_the_estimator_are_left_out_of_the_steady_attitude(
    after_ms: int, jump_deg: float, steady_deg: float
) -> None:
    """It turns at 40°/s, and its estimate jumps besides."""
    kept = history((1000, 0.0, 0.0), (1000 + after_ms, 0.04 * after_ms + jump_deg, 0.0))
    steady: Any = kept.steady_attitude_at((1000 + after_ms) * MS)
    assert np.degrees(np.arctan2(steady[1, 0], steady[0, 0])) == pytest.approx(steady_deg, abs=1e-6)
    assert yaw_deg(kept.pose_at((1000 + after_ms) * MS)) == pytest.approx(0.04 * after_ms + jump_deg)


def test_rotations_are_those_of_scipy() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        first, second = (
            Rotation.random(random_state=int(rng.integers(9999))),
            Rotation.random(random_state=int(rng.integers(9999))),
        )
        quats = [quaternion(first), quaternion(second)]
        np.testing.assert_allclose(rotation_matrix(quats[0]), first.as_matrix(), atol=1e-12)
        product = quaternion_product(*quats)
        assert abs(product @ quaternion(first * second)) == pytest.approx(1.0)
        np.testing.assert_allclose(rotation_matrix(product), (first * second).as_matrix(), atol=1e-12)
        assert abs(np.array(quaternion_of(first.as_matrix())) @ quats[0]) == pytest.approx(1.0)
        vector = first.as_rotvec()
        np.testing.assert_allclose(rotation_vector(first.as_matrix()), vector, atol=1e-6)
        other = rng.normal(size=3)
        np.testing.assert_allclose(cross_matrix(vector) @ other, np.cross(vector, other), atol=1e-12)
        after = first * Rotation.from_rotvec(0.3 * other)
        np.testing.assert_allclose(
            rotation_matrix(turn_quaternion(quats[0], 0.3 * other)), after.as_matrix(), atol=1e-9
        )
        yaw, pitch, roll = rng.uniform(-1.5, 1.5, 3)
        euler = Rotation.from_euler("ZYX", [yaw, pitch, roll])
        np.testing.assert_allclose(
            rotation_matrix(quaternion_from_euler(roll, pitch, yaw)), euler.as_matrix(), atol=1e-12
        )
    np.testing.assert_allclose(turn_quaternion(LEVEL, np.zeros(3)), LEVEL)
