"""The odometry with an autopilot's attitude and velocity: past water that shows nothing, and through a heel."""

from __future__ import annotations

import numpy as np
import pytest

from agent.companion.estimate import Estimate, Motion
from agent.companion.inertial import BEGUN, MOST_GAIN_MPS2, Inertial, _borne, motion_of
from agent.companion.odometry import LidarOdometry
from agent.companion.pose_history import PoseHistory, quaternion, rotation
from agent.companion.rigid import exponential, logarithm
from agent.companion.water_plane import WaterPlane
from tests.unit.companion import river_scans

STEP_NS = 100_000_000
BLIND = range(20, 45)
"""Clouds that see nothing but water: the vessel looks away from the poles for 2.5 s, or 5 m."""


def told(before_ns: int | None, begin_ns: int, end_ns: int) -> Motion:
    """The true motion of river_scans."""

    def velocity(stamp_ns: int) -> np.ndarray:
        ends = river_scans.pose(np.array([stamp_ns - 1_000_000, stamp_ns + 1_000_000]) * 1e-9)[0]
        return (ends[1] - ends[0]) / 2e-3

    then_ns = end_ns if before_ns is None else before_ns
    attitudes = river_scans.pose(np.array([then_ns, begin_ns, end_ns]) * 1e-9)[1]
    motion = np.eye(4)
    motion[:3, :3] = attitudes[1].T @ attitudes[2]
    rate = logarithm(motion)[3:] / ((end_ns - begin_ns) * 1e-9)
    return Motion(
        attitudes[0].T @ attitudes[2], rate, attitudes[2], velocity(end_ns), velocity(end_ns) - velocity(then_ns)
    )


@pytest.fixture(scope="module")
def drive() -> list[tuple[int, np.ndarray, np.ndarray]]:
    rng, stands, nothing = np.random.default_rng(3), river_scans.poles(), np.empty((0, 3))
    return [(k * STEP_NS, *river_scans.scan(0.1 * k, nothing if k in BLIND else stands, rng)) for k in range(60)]


def off_m(odometry: LidarOdometry, drive: list) -> float:
    """How far the last pose is from the true one, seen from the first."""
    placed = [one for one in (odometry.register(*cloud) for cloud in drive) if one is not None]
    place, attitude = river_scans.pose(np.array([placed[0].stamp_ns, placed[-1].stamp_ns]) * 1e-9)
    true_m = attitude[0].T @ (place[1] - place[0])
    return float(np.linalg.norm(placed[-1].pose_odom[:3, 3] - true_m))


def test_it_finds_its_way_past_water_that_shows_nothing(drive: list) -> None:
    odometry = LidarOdometry(motion=told)
    # As without a blind spell (test_lidar_odometry): what the clouds after it add.
    assert off_m(odometry, drive) < 0.25
    assert (odometry.poses, odometry.poses_refused) == (60 - len(BLIND), len(BLIND))


def test_a_ping_in_a_blind_spell_is_placed_by_the_autopilots_motion(drive: list) -> None:
    odometry = LidarOdometry(motion=told)
    for cloud in drive[: BLIND[-1]]:
        odometry.register(*cloud)
    stamp_ns = BLIND[-1] * STEP_NS
    place, _ = river_scans.pose(np.array([STEP_NS, stamp_ns]) * 1e-9)
    pose = odometry.pose_at(stamp_ns)
    assert pose is not None
    assert np.linalg.norm(pose[:3, 3]) == pytest.approx(np.linalg.norm(place[1] - place[0]), abs=0.3)


def test_an_autopilot_that_falls_silent_and_speaks_again_leaves_the_clouds_in_between() -> None:
    def now_and_then(before_ns: int | None, begin_ns: int, end_ns: int) -> Motion | None:
        return None if 20 * STEP_NS < end_ns < 40 * STEP_NS else told(before_ns, begin_ns, end_ns)

    rng, stands = np.random.default_rng(3), river_scans.poles()
    drive = [(k * STEP_NS, *river_scans.scan(0.1 * k, stands, rng)) for k in range(60)]
    odometry = LidarOdometry(motion=now_and_then)
    assert off_m(odometry, drive) < 0.25
    assert odometry.poses_refused == 0


def test_the_same_clouds_and_words_give_the_same_poses(drive: list) -> None:
    one, other = LidarOdometry(motion=told), LidarOdometry(motion=told)
    for cloud in drive[:15]:
        here, there = one.register(*cloud), other.register(*cloud)
        assert here is not None
        assert there is not None
        assert here.pose_odom.tobytes() == there.pose_odom.tobytes()


def test_points_bear_what_their_jacobian_says() -> None:
    points = np.random.default_rng(4).uniform(-20.0, 20.0, (40, 3))
    columns = []
    for axis in range(6):
        small = np.zeros(6)
        small[axis] = 1e-6
        motion = exponential(small)
        columns.append(((points @ motion[:3, :3].T + motion[:3, 3] - points) * 1e6).ravel())
    jacobian = np.stack(columns, axis=1)
    np.testing.assert_allclose(_borne(points), jacobian.T @ jacobian + 1e-3 * np.eye(6), rtol=1e-4, atol=1e-2)


def motion(gained: np.ndarray) -> Motion:
    return Motion(np.eye(3), np.zeros(3), np.eye(3), gained, gained)


def test_many_points_are_believed_and_few_are_not() -> None:
    """Two observations of one place weigh by the inverse of their variances: Kalman's gain of a scalar."""
    rng = np.random.default_rng(5)
    aligned = np.eye(4)
    aligned[0, 3] = 0.3
    moved = []
    for count in (40, 4000):
        inertial = Inertial(WaterPlane())
        before = Estimate(np.eye(4), np.zeros(6))
        inertial.predicted(None, 0.0, motion(np.zeros(3)))
        guess = inertial.predicted(before, 1.0, motion(np.zeros(3)))
        points = rng.uniform(-20.0, 20.0, (count, 3))
        found = inertial.corrected(guess, aligned, points - points.mean(axis=0), 1.0)
        assert found is not None
        moved.append(found.pose_odom[0, 3])
        prior = BEGUN[0, 0] + BEGUN[6, 6] + 0.02**2
        assert moved[-1] == pytest.approx(0.3 * prior / (prior + 0.5**2 / count + 0.02**2), rel=0.02)
    assert moved[0] < moved[1] < 0.3


@pytest.mark.parametrize(("place_m", "turn_rad"), [(9.0, 0.0), (0.0, 0.9), (np.nan, 0.0)])
def test_a_registration_that_found_something_else_is_refused(place_m: float, turn_rad: float) -> None:
    inertial = Inertial(WaterPlane())
    guess = inertial.predicted(Estimate(np.eye(4), np.zeros(6)), 0.1, motion(np.zeros(3)))
    aligned = exponential(np.array([0.0, 0.0, 0.0, 0.0, 0.0, turn_rad]))
    aligned[0, 3] = place_m
    assert inertial.corrected(guess, aligned, np.ones((50, 3)), 0.1) is None


def test_a_velocity_that_jumps_does_not_throw_it() -> None:
    inertial = Inertial(WaterPlane())
    guess = inertial.predicted(Estimate(np.eye(4), np.zeros(6)), 0.1, motion(np.array([40.0, 0.0, 0.0])))
    assert np.linalg.norm(guess.twist_frd[:3]) == pytest.approx(0.1 * MOST_GAIN_MPS2)


def history(yaw_step_rad: float) -> PoseHistory:
    """4 s at 25 Hz: 0.3 rad/s to starboard, 0.5 m/s faster each second, and a step of the estimator's yaw at 2 s."""
    kept = PoseHistory()
    for number in range(100):
        t_s = 0.04 * number
        yaw = 0.3 * t_s + (yaw_step_rad if t_s >= 2.0 else 0.0)
        kept.turned(number * 40_000_000, quaternion(0.02, -0.01, yaw), np.array([0.003, 0.006, 0.3]))
        kept.placed(number * 40_000_000, np.zeros(3), np.array([1.0 + 0.5 * t_s, 0.0, 0.0]))
    return kept


@pytest.mark.parametrize("step_rad", [0.0, 0.6, -2.5])
def test_an_estimator_that_finds_north_has_not_turned_the_body(step_rad: float) -> None:
    found = motion_of(history(step_rad), 1_900_000_000, 2_000_000_000, 2_100_000_000)
    assert found is not None
    yaw = float(np.arctan2(found.turned[1, 0], found.turned[0, 0]))
    assert yaw == pytest.approx(0.06, abs=1e-3)
    assert found.rate_frd_radps[2] == pytest.approx(0.3, abs=0.01)
    np.testing.assert_allclose(found.gained_ned_mps, [0.1, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.attitude_ned, rotation(quaternion(0.02, -0.01, 0.63 + step_rad)), atol=1e-6)


def test_what_the_autopilot_has_not_told_is_not_made_up() -> None:
    assert motion_of(PoseHistory(), 0, 100, 200) is None
    kept = history(0.0)
    assert motion_of(kept, 1_900_000_000, 2_000_000_000, 9_000_000_000) is None
    assert motion_of(kept, -900_000_000, 2_000_000_000, 2_100_000_000) is None


def test_crests_are_told_from_what_stands_where_down_is_known() -> None:
    """Water 0.6 m below a body that heels by 6 degrees: at 18 m to the side it is 1.9 m off its plane."""
    rng = np.random.default_rng(6)
    heel = rotation(quaternion(np.radians(6.0), 0.0, 0.0))
    azimuth = rng.uniform(-0.7, 0.7, 3000)
    reach = np.concatenate([rng.uniform(2.0, 9.0, 2000), rng.uniform(13.0, 19.0, 1000)])
    water = np.stack([reach * np.cos(azimuth), reach * np.sin(azimuth), 0.6 + rng.normal(0.0, 0.05, 3000)], axis=1)
    pole = np.stack([np.full(200, 15.0), np.full(200, 4.0), rng.uniform(-2.0, 0.2, 200)], axis=1)
    points = (np.concatenate([water, pole]) @ heel).astype(np.float32)
    lag = np.zeros(len(points), dtype=np.float32)
    plane = WaterPlane()
    wet = plane.of(points, lag)
    crests = plane.crests(points, lag, heel[2], np.zeros(3))
    assert wet[:2000].all()
    assert crests[2000:3000].all()
    assert not crests[:2000].any()
    assert not (wet | crests)[3000:].any()
