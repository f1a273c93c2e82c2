"""The filters of the odometry against second implementations, by numerical derivatives and matrix exponentials."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from agent.companion.odometry_filters import AidedFilter, AutopilotMotion, LidarOnlyFilter, OdometryFilterState
from agent.companion.water_plane import WaterLevel

DOWN = np.array([0.0, 0.0, 1.0])


def turn(vector: Any) -> Any:
    return Rotation.from_rotvec(vector).as_matrix()


def vector(matrix: Any) -> Any:
    return Rotation.from_matrix(matrix).as_rotvec()


class ErrorState:
    """An error-state filter with numerical derivatives and updates in information form."""

    def __init__(self) -> None:
        self.place, self.rot, self.vel = np.zeros(3), np.eye(3), np.zeros(3)
        self.covariance: Any = np.diag([1e-6] * 6 + [0.04] * 3)
        self.downs: list[Any] = []
        self.heights: list[float] = []

    def predict(self, dt_s: float, motion: AutopilotMotion) -> None:
        doubted = np.linalg.norm(motion.gained_ned_mps) > 10.0 * dt_s

        def ahead(error: Any) -> tuple[Any, Any, Any]:
            rot = turn(error[3:6]) @ self.rot @ motion.turned
            gained = rot @ motion.attitude_ned.T @ motion.gained_ned_mps * (not doubted)
            vel = self.vel + error[6:]
            return self.place + error[:3] + (vel + gained / 2.0) * dt_s, rot, vel + gained

        place, rot, vel = ahead(np.zeros(9))
        columns = []
        for step in 1e-5 * np.eye(9):
            ends = [ahead(sign * step) for sign in (1.0, -1.0)]
            errors = [np.concatenate([end[0] - place, vector(end[1] @ rot.T), end[2] - vel]) for end in ends]
            columns.append((errors[0] - errors[1]) / 2e-5)
        transition = np.stack(columns, axis=1)
        process = np.diag([0.02**2] * 3 + [np.radians(0.15) ** 2] * 3 + [0.05**2] * 3)
        self.covariance = transition @ self.covariance @ transition.T + process * dt_s
        self.covariance[6:, 6:] += np.eye(3) * doubted
        self.place, self.rot, self.vel = place, rot, vel

    def observe(self, jacobian: Any, residual: Any, noise: Any) -> None:
        weight = jacobian.T @ np.linalg.inv(noise)
        self.covariance = np.linalg.inv(np.linalg.inv(self.covariance) + weight @ jacobian)
        error = self.covariance @ weight @ residual
        self.place, self.rot, self.vel = self.place + error[:3], turn(error[3:6]) @ self.rot, self.vel + error[6:]

    def register(self, aligned: Any, solid: Any) -> None:
        around = solid @ self.rot.T
        rows = np.concatenate([np.column_stack([np.eye(3), np.cross(np.eye(3), -point)]) for point in around])
        noise = 0.25 * np.linalg.inv(rows.T @ rows + 1e-3 * np.eye(6)) + np.diag([0.02] * 3 + [0.05] * 2 + [0.001]) ** 2
        residual = np.concatenate([aligned[:3, 3] - self.place, vector(aligned[:3, :3] @ self.rot.T)])
        self.observe(np.eye(6, 9), residual, noise)

    def hold(self, motion: AutopilotMotion, level: WaterLevel | None) -> None:
        down = self.rot @ motion.attitude_ned.T @ DOWN
        self.downs = [*self.downs, down][:50]
        reference = np.mean(self.downs, axis=0)
        reference /= np.linalg.norm(reference)
        side = np.cross(reference, [1.0, 0.2, 0.3])
        axes = np.array([side, np.cross(reference, side)]) / np.linalg.norm(side)
        self.observe(
            np.column_stack([np.zeros((2, 3)), axes, np.zeros((2, 3))]),
            axes @ np.cross(down, reference),
            1e-4 * np.eye(2),
        )
        if level is not None:
            height_m = level.down_m + reference @ self.place
            self.heights = [*self.heights, height_m][:50]
            jacobian = np.concatenate([reference, np.zeros(6)])[None]
            self.observe(jacobian, np.array([np.mean(self.heights) - height_m]), np.array([[0.25**2]]))

    def agrees_with(self, estimate: OdometryFilterState, motion: AutopilotMotion) -> None:
        np.testing.assert_allclose(estimate.pose_odom[:3, 3], self.place, atol=1e-6)
        np.testing.assert_allclose(estimate.pose_odom[:3, :3], self.rot, atol=1e-6)
        np.testing.assert_allclose(estimate.twist_frd, [*(self.rot.T @ self.vel), *motion.rate_frd_radps], atol=1e-6)


def motions(seed: int, count: int) -> list[tuple[float, AutopilotMotion, WaterLevel | None]]:
    """Steps of a body that turns and speeds up, one of them beyond belief, with water now and then."""
    rng = np.random.default_rng(seed)
    attitude = turn(rng.normal(0.0, 0.4, 3))
    steps = []
    for number in range(count):
        turned = turn(rng.normal(0.0, 0.1, 3))
        attitude = attitude @ turned
        gained = rng.normal(0.0, 0.4, 3) * (20.0 if number == count // 2 else 1.0)
        level = WaterLevel(DOWN, rng.normal(0.2, 0.1), np.zeros(3)) if number % 3 else None
        tilted = turn(rng.normal(0.0, 0.01, 3)) @ attitude
        steps.append(
            (
                rng.uniform(0.08, 0.2),
                AutopilotMotion(turned, rng.normal(size=3), tilted, rng.normal(size=3), gained),
                level,
            )
        )
    return steps


@pytest.mark.medium
@pytest.mark.parametrize(("seed", "count"), [(1, 12), (2, 54)])
def test_the_aided_filter_is_that_of_numerical_derivatives(seed: int, count: int) -> None:
    """The references of down and height are means of the first fifty clouds."""
    rng, water = np.random.default_rng(seed), SimpleNamespace(level=None)
    aided, reference = AidedFilter(cast(Any, water)), ErrorState()
    (_, first, _), *steps = motions(seed, count)
    estimate = aided.predict(None, 0.0, first)
    reference.vel = first.attitude_ned.T @ first.vel_ned_mps
    reference.agrees_with(estimate, first)
    for dt_s, motion, water.level in steps:
        estimate = aided.predict(estimate, dt_s, motion)
        reference.predict(dt_s, motion)
        reference.agrees_with(estimate, motion)
        solid = rng.uniform(-15.0, 15.0, (30, 3))
        aligned = np.eye(4)
        aligned[:3, 3] = reference.place + rng.normal(0.0, 0.05, 3)
        aligned[:3, :3] = turn(rng.normal(0.0, 0.01, 3)) @ reference.rot
        corrected = aided.correct(estimate, aligned, solid, dt_s)
        assert corrected is not None
        reference.register(aligned, solid)
        reference.agrees_with(corrected, motion)
        estimate = aided.hold_level(corrected, motion)
        reference.hold(motion, water.level)
        reference.agrees_with(estimate, motion)


@pytest.mark.parametrize("resumes", [False, True])
def test_a_registration_is_refused_beyond_its_gate(resumes: bool) -> None:
    """A metre and 0.1 rad, and three standard deviations of the prediction each."""
    _, motion, _ = motions(3, 1)[0]
    calm = motion._replace(gained_ned_mps=np.zeros(3), turned=np.eye(3))
    reference = ErrorState()
    if resumes:
        reference.covariance = np.diag([0.09] * 3 + [np.radians(2.0) ** 2] * 3 + [0.04] * 3)
    reference.predict(0.5, calm)
    most_m = 1.0 + 3.0 * np.sqrt(np.trace(reference.covariance[:3, :3]))
    most_rad = 0.1 + 3.0 * np.sqrt(np.trace(reference.covariance[3:6, 3:6]))
    for share_m, share_rad in ((0.999, 0.999), (1.001, 0.0), (0.0, 1.001), (-0.999, -0.999)):
        aided = AidedFilter(cast(Any, SimpleNamespace(level=None)))
        before = OdometryFilterState(np.eye(4), np.zeros(6))
        if resumes:
            aided.resume()
        guess = aided.predict(before, 0.5, calm)
        aligned = np.eye(4)
        aligned[:3, 3] = guess.pose_odom[:3, 3] + share_m * most_m * np.array([0.6, 0.0, 0.8])
        aligned[:3, :3] = turn(share_rad * most_rad * np.array([0.0, 0.6, -0.8])) @ guess.pose_odom[:3, :3]
        found = aided.correct(guess, aligned, np.random.default_rng(1).uniform(-9.0, 9.0, (50, 3)), 0.5)
        assert (found is None) == (max(share_m, share_rad) > 1.0)


# -- without the autopilot

GAINS = np.array([0.8, 0.8, 0.3, 0.9, 0.9, 0.9])


def motion_of(twist: Any) -> Any:
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = np.cross(np.eye(3), twist[3:])
    matrix[:3, 3] = twist[:3]
    return np.real(expm(matrix))


def twist_of(motion: Any) -> Any:
    matrix = np.real(logm(motion))
    return np.array([*matrix[:3, 3], matrix[2, 1], matrix[0, 2], matrix[1, 0]])


class AlphaBeta:
    """Constant velocity, levelled and lifted to the water."""

    def __init__(self) -> None:
        self.normals: list[Any] = []
        self.heights: list[float] = []
        self.surface: tuple[Any, float] | None = None

    def predict(self, pose: Any, twist: Any, dt_s: float, level: WaterLevel | None) -> tuple[Any, Any]:
        pose = pose @ motion_of(twist * dt_s)
        if level is not None and self.surface is not None:
            last, height_m = self.surface
            shift_m = height_m - level.down_m - last @ pose[:3, 3]
            pose[:3, :3] = turn(np.cross(pose[:3, :3] @ level.normal_frd, last)) @ pose[:3, :3]
            pose[:3, 3] += shift_m * last
        self.surface = None
        return pose, self.rocked(twist, level)

    @staticmethod
    def rocked(twist: Any, level: WaterLevel | None) -> Any:
        if level is None:
            return twist
        normal = level.normal_frd
        flat = np.eye(3) - np.outer(normal, normal)
        return np.array([*(flat @ twist[:3]), *(0.65 * level.turn_frd_radps + (normal @ twist[3:]) * normal)])

    def correct(self, pose: Any, twist: Any, aligned: Any, dt_s: float, level: WaterLevel | None) -> tuple[Any, Any]:
        surprise = twist_of(np.linalg.inv(pose) @ aligned)
        return pose @ motion_of(GAINS * surprise), self.rocked(
            twist + GAINS**2 / (2.0 - GAINS) * surprise / dt_s, level
        )

    def hold(self, pose: Any, level: WaterLevel | None) -> Any:
        if level is None:
            return pose
        normal = pose[:3, :3] @ level.normal_frd
        self.normals = [*self.normals, normal][:30]
        self.heights = [*self.heights, level.down_m + normal @ pose[:3, 3]][:30]
        reference = np.mean(self.normals, axis=0)
        reference /= np.linalg.norm(reference)
        off_m = np.mean(self.heights) - level.down_m - reference @ pose[:3, 3]
        pose = pose.copy()
        pose[:3, :3] = turn(0.2 * np.cross(normal, reference)) @ pose[:3, :3]
        pose[:3, 3] += 0.4 * off_m * reference
        normal = pose[:3, :3] @ level.normal_frd
        self.surface = normal, level.down_m + normal @ pose[:3, 3]
        return pose


@pytest.mark.medium
def test_the_filter_of_clouds_alone_is_that_of_matrix_exponentials() -> None:
    """The references of the water are means of its first thirty clouds."""
    rng, water = np.random.default_rng(6), SimpleNamespace(level=None)
    alone, reference = LidarOnlyFilter(cast(Any, water)), AlphaBeta()
    estimate = alone.predict(None, 0.0, None)
    np.testing.assert_array_equal(estimate.pose_odom, np.eye(4))
    np.testing.assert_array_equal(estimate.twist_frd, np.zeros(6))
    pose, twist = np.eye(4), np.zeros(6)
    for number in range(50):
        normal = DOWN + rng.normal(0.0, 0.05, 3)
        level = WaterLevel(normal / np.linalg.norm(normal), 0.3 + rng.normal(0.0, 0.05), rng.normal(0.0, 0.1, 3))
        water.level = level if number % 7 else None
        dt_s = rng.uniform(0.08, 0.2)
        if number == 20:
            alone.resume()
            reference.surface = None
        guess = alone.predict(estimate, dt_s, None)
        pose, twist = reference.predict(pose, twist, dt_s, water.level)
        aligned = pose @ motion_of(rng.normal(0.0, 0.05, 6))
        corrected = alone.correct(guess, aligned, np.empty((0, 3)), dt_s)
        assert corrected is not None
        pose, twist = reference.correct(pose, twist, aligned, dt_s, water.level)
        estimate = alone.hold_level(corrected, None)
        pose = reference.hold(pose, water.level)
        np.testing.assert_allclose(estimate.pose_odom, pose, atol=1e-6)
        np.testing.assert_allclose(estimate.twist_frd, twist, atol=1e-6)


@pytest.mark.parametrize(("off_m", "accepted"), [(0.799, True), (0.801, False), (np.nan, False)])
def test_a_surprise_of_more_than_eight_metres_a_second_is_refused(off_m: float, accepted: bool) -> None:
    alone = LidarOnlyFilter(cast(Any, SimpleNamespace(level=None)))
    aligned = np.eye(4)
    aligned[1, 3] = off_m
    guess = OdometryFilterState(np.eye(4), np.zeros(6))
    assert (alone.correct(guess, aligned, np.empty((0, 3)), 0.1) is not None) is accepted
