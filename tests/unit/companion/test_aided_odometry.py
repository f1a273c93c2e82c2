"""The odometry with an autopilot's attitude and velocity: past water that shows nothing, and through a heel."""

from __future__ import annotations

import numpy as np
import pytest

from agent.companion.odometry import LidarOdometry
from agent.companion.odometry_filters import (
    AidedFilter,
    AutopilotMotion,
    AutopilotMotionSource,
    OdometryFilterState,
    _information,
)
from agent.companion.pose_history import PoseHistory
from agent.companion.rigid_motion import exponential, logarithm, quaternion_from_euler, rotation_matrix
from agent.companion.settings import TUNED
from agent.companion.water_plane import WaterLevel, WaterPlane
from tests.unit.companion import river_scans

STEP_NS = 100_000_000
BLIND = range(20, 45)
"""Clouds that see nothing but water: the vessel looks away from the poles for 2.5 s, or 5 m."""


def turning(t_s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """In place of river_scans.pose: a vessel that swerves while it sees nothing, rolls, and heaves."""
    t = np.atleast_1d(np.asarray(t_s, dtype=float))
    place = np.stack([2.0 * t, 1.5 - 1.5 * np.cos(0.8 * t), -0.15 + 0.03 * np.sin(2.0 * t)], axis=-1)
    angles = np.stack([0.06 * np.sin(6.0 * t), 0.02 * np.sin(5.0 * t), 0.5 * np.sin(0.8 * t)], axis=-1)
    return place, np.array([rotation_matrix(quaternion_from_euler(*row)) for row in angles])


def told(before_ns: int | None, begin_ns: int, end_ns: int) -> AutopilotMotion:
    """The true motion of it."""

    def velocity(stamp_ns: int) -> np.ndarray:
        ends = turning(np.array([stamp_ns - 1_000_000, stamp_ns + 1_000_000]) * 1e-9)[0]
        return (ends[1] - ends[0]) / 2e-3

    then_ns = end_ns if before_ns is None else before_ns
    attitudes = turning(np.array([then_ns, begin_ns, end_ns]) * 1e-9)[1]
    motion = np.eye(4)
    motion[:3, :3] = attitudes[1].T @ attitudes[2]
    rate = logarithm(motion)[3:] / ((end_ns - begin_ns) * 1e-9)
    return AutopilotMotion(
        attitudes[0].T @ attitudes[2], rate, attitudes[2], velocity(end_ns), velocity(end_ns) - velocity(then_ns)
    )


Drive = list[tuple[int, np.ndarray, np.ndarray]]


@pytest.fixture(scope="module")
def drives() -> tuple[Drive, Drive]:
    """With a spell of seeing nothing, and without."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(river_scans, "pose", turning)
        rng, stands, nothing = np.random.default_rng(3), river_scans.poles(), np.empty((0, 3))
        seeing = [(k * STEP_NS, *river_scans.scan(0.1 * k, stands, rng)) for k in range(60)]
        blind = [
            (k * STEP_NS, *river_scans.scan(0.1 * k, nothing, rng)) if k in BLIND else seeing[k] for k in range(60)
        ]
    return blind, seeing


@pytest.fixture
def drive(drives: tuple[Drive, Drive]) -> Drive:
    return drives[0]


def off_m(odometry: LidarOdometry, drive: Drive) -> float:
    """How far the last pose is from the true one, seen from the first."""
    placed = [one for one in (odometry.register(*cloud) for cloud in drive) if one is not None]
    place, attitude = turning(np.array([placed[0].stamp_ns, placed[-1].stamp_ns]) * 1e-9)
    true_m = attitude[0].T @ (place[1] - place[0])
    return float(np.linalg.norm(placed[-1].pose_odom[:3, 3] - true_m))


@pytest.mark.slow
def test_it_finds_its_way_past_water_that_shows_nothing(drive: Drive) -> None:
    aided, alone = LidarOdometry(motion=told), LidarOdometry()
    # As without a blind spell (test_lidar_odometry): what the clouds after it add.
    assert off_m(aided, drive) < 0.25 < off_m(alone, drive)
    assert (aided.poses, aided.poses_refused, aided.unaided) == (60 - len(BLIND), len(BLIND), 0)
    assert alone.unaided == 60


@pytest.mark.medium
def test_a_ping_in_a_blind_spell_is_placed_by_the_autopilots_motion(drive: Drive) -> None:
    aided, alone = LidarOdometry(motion=told), LidarOdometry()
    stamp_ns = BLIND[-1] * STEP_NS
    place, attitude = turning(np.array([0.1, stamp_ns * 1e-9]))
    true_m = attitude[0].T @ (place[1] - place[0])
    off = []
    for odometry in (aided, alone):
        for cloud in drive[: BLIND[-1]]:
            odometry.register(*cloud)
        pose = odometry.pose_at(stamp_ns)
        assert pose is not None
        off.append(float(np.linalg.norm(pose[:3, 3] - true_m)))
    assert off[0] < 0.25 < off[1]


@pytest.mark.medium
def test_an_autopilot_that_falls_silent_and_speaks_again_leaves_the_clouds_in_between(
    drives: tuple[Drive, Drive],
) -> None:
    def now_and_then(before_ns: int | None, begin_ns: int, end_ns: int) -> AutopilotMotion | None:
        return None if 20 * STEP_NS < end_ns < 40 * STEP_NS else told(before_ns, begin_ns, end_ns)

    odometry = LidarOdometry(motion=now_and_then)
    assert off_m(odometry, drives[1]) < 0.5
    assert (odometry.poses_refused, odometry.unaided) == (0, 20)


@pytest.mark.medium
def test_the_same_clouds_and_words_give_the_same_poses(drive: Drive) -> None:
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
    np.testing.assert_allclose(_information(points), jacobian.T @ jacobian + 1e-3 * np.eye(6), rtol=1e-4, atol=1e-2)


def motion(gained: np.ndarray) -> AutopilotMotion:
    return AutopilotMotion(np.eye(3), np.zeros(3), np.eye(3), gained, gained)


def covariance(inertial: AidedFilter) -> np.ndarray:
    """Covariance (9, 9) of place, attitude and velocity."""
    return inertial._covariance


def test_many_points_are_believed_and_few_are_not() -> None:
    """Two observations of one place weigh by the inverse of their variances: Kalman's gain of a scalar."""
    rng = np.random.default_rng(5)
    aligned = np.eye(4)
    aligned[0, 3] = 0.3
    moved = []
    for count in (40, 4000):
        inertial = AidedFilter(WaterPlane())
        before = OdometryFilterState(np.eye(4), np.zeros(6))
        inertial.predict(None, 0.0, motion(np.zeros(3)))
        guess = inertial.predict(before, 1.0, motion(np.zeros(3)))
        points = rng.uniform(-20.0, 20.0, (count, 3))
        found = inertial.correct(guess, aligned, points - points.mean(axis=0), 1.0)
        assert found is not None
        moved.append(found.pose_odom[0, 3])
        prior = TUNED.aided_initial_place_m2 + TUNED.aided_initial_vel_m2ps2 + 0.02**2
        assert moved[-1] == pytest.approx(0.3 * prior / (prior + 0.5**2 / count + 0.02**2), rel=0.02)
    assert moved[0] < moved[1] < 0.3


@pytest.mark.parametrize(("place_m", "turn_rad"), [(9.0, 0.0), (0.0, 0.9), (np.nan, 0.0)])
def test_a_registration_that_found_something_else_is_refused(place_m: float, turn_rad: float) -> None:
    inertial = AidedFilter(WaterPlane())
    guess = inertial.predict(OdometryFilterState(np.eye(4), np.zeros(6)), 0.1, motion(np.zeros(3)))
    aligned = exponential(np.array([0.0, 0.0, 0.0, 0.0, 0.0, turn_rad]))
    aligned[0, 3] = place_m
    assert inertial.correct(guess, aligned, np.ones((50, 3)), 0.1) is None


def test_a_velocity_that_jumps_is_not_believed_and_what_it_was_before_is_doubted() -> None:
    inertial = AidedFilter(WaterPlane())
    guess = inertial.predict(OdometryFilterState(np.eye(4), np.zeros(6)), 0.1, motion(np.array([40.0, 0.0, 0.0])))
    np.testing.assert_array_equal(guess.twist_frd, np.zeros(6))
    assert covariance(inertial)[6, 6] > 1.0


def test_a_registration_that_joined_nothing_says_nothing() -> None:
    inertial = AidedFilter(WaterPlane())
    guess = inertial.predict(OdometryFilterState(np.eye(4), np.zeros(6)), 1.0, motion(np.zeros(3)))
    before = covariance(inertial).copy()
    assert inertial.correct(guess, guess.pose_odom.copy(), np.ones((50, 3)), 1.0) is guess
    np.testing.assert_array_equal(covariance(inertial), before)


def test_what_was_observed_is_known_better_and_its_covariance_stays_one() -> None:
    inertial, rng = AidedFilter(WaterPlane()), np.random.default_rng(8)
    estimate = inertial.predict(None, 0.0, motion(np.zeros(3)))
    for _ in range(200):
        estimate = inertial.predict(estimate, 0.1, motion(np.zeros(3)))
        before = np.diag(covariance(inertial)).copy()
        aligned = np.eye(4)
        aligned[:3, 3] += rng.normal(0.0, 0.02, 3)
        found = inertial.correct(estimate, aligned, rng.uniform(-20.0, 20.0, (100, 3)), 0.1)
        assert found is not None
        assert (np.diag(covariance(inertial)) < before).all()
        assert np.linalg.eigvalsh(covariance(inertial))[0] > 0.0
        estimate = found
    assert np.linalg.norm(estimate.pose_odom[:3, 3]) < 0.1


@pytest.mark.parametrize("tilt_rad", [-0.1, 0.1])
def test_it_is_levelled_to_where_the_autopilot_says_that_down_is(tilt_rad: float) -> None:
    """It begins level for as long as down is learnt; then the estimate is tilted, and the autopilot's is not."""
    inertial = AidedFilter(WaterPlane())
    estimate = inertial.predict(None, 0.0, motion(np.zeros(3)))
    for _ in range(60):
        estimate = inertial.hold_level(inertial.predict(estimate, 0.1, motion(np.zeros(3))), motion(np.zeros(3)))
    tilted = exponential(np.array([0.0, 0.0, 0.0, tilt_rad, -tilt_rad, 0.2]))
    inertial.resume()
    estimate = OdometryFilterState(tilted, np.zeros(6))
    for _ in range(100):
        estimate = inertial.hold_level(inertial.predict(estimate, 0.1, motion(np.zeros(3))), motion(np.zeros(3)))
    down = estimate.pose_odom[:3, 2]
    assert np.linalg.norm(down[:2]) < TUNED.aided_down_rad
    heading = np.arctan2(estimate.pose_odom[1, 0], estimate.pose_odom[0, 0])
    assert heading == pytest.approx(np.arctan2(tilted[1, 0], tilted[0, 0]), abs=0.02)  # which down says nothing of


@pytest.mark.parametrize("lifted_m", [-0.8, 0.8])
def test_its_height_is_held_to_the_water(lifted_m: float) -> None:
    water = WaterPlane()
    water.level = WaterLevel(np.array([0.0, 0.0, 1.0]), 0.15, np.zeros(3))
    inertial = AidedFilter(water)
    estimate = inertial.predict(None, 0.0, motion(np.zeros(3)))
    for step in range(200):
        if step == 60:
            pose = estimate.pose_odom.copy()
            pose[2, 3] += lifted_m
            inertial.resume()
            estimate = OdometryFilterState(pose, np.zeros(6))
        estimate = inertial.hold_level(inertial.predict(estimate, 0.1, motion(np.zeros(3))), motion(np.zeros(3)))
    assert abs(estimate.pose_odom[2, 3]) < TUNED.aided_height_m


def test_speed_is_gained_in_the_frame_of_the_odometry() -> None:
    """The odometry began with the bow to the east: what is gained to the north is gained to port."""
    east = rotation_matrix(quaternion_from_euler(0.0, 0.0, np.pi / 2.0))
    gained = AutopilotMotion(np.eye(3), np.zeros(3), east, np.zeros(3), np.array([0.5, 0.0, 0.0]))
    guess = AidedFilter(WaterPlane()).predict(OdometryFilterState(np.eye(4), np.zeros(6)), 0.1, gained)
    np.testing.assert_allclose(guess.twist_frd[:3], [0.0, -0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(guess.pose_odom[:3, 3], [0.0, -0.025, 0.0], atol=1e-12)


def as_it_is(stamp_ns: int) -> int:
    return stamp_ns


def history(yaw_step_rad: float) -> PoseHistory:
    """4 s at 25 Hz: 0.3 rad/s to starboard, 0.5 m/s faster each second, and a step of the estimator's yaw at 2 s."""
    kept = PoseHistory()
    for number in range(100):
        t_s = 0.04 * number
        yaw = 0.3 * t_s + (yaw_step_rad if t_s >= 2.0 else 0.0)
        kept.add_attitude(number * 40_000_000, quaternion_from_euler(0.02, -0.01, yaw), np.array([0.003, 0.006, 0.3]))
        kept.add_position(number * 40_000_000, np.zeros(3), np.array([1.0 + 0.5 * t_s, 0.0, 0.0]))
    return kept


@pytest.mark.parametrize("step_rad", [0.0, 0.6, -2.5])
def test_an_estimator_that_finds_north_has_not_turned_the_body(step_rad: float) -> None:
    found = AutopilotMotionSource(history(step_rad), as_it_is).motion_between(
        1_900_000_000, 2_000_000_000, 2_100_000_000
    )
    assert found is not None
    yaw = float(np.arctan2(found.turned[1, 0], found.turned[0, 0]))
    assert yaw == pytest.approx(0.06, abs=1e-3)
    assert found.rate_frd_radps[2] == pytest.approx(0.3, abs=0.01)
    np.testing.assert_allclose(found.gained_ned_mps, [0.1, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(
        found.attitude_ned, rotation_matrix(quaternion_from_euler(0.02, -0.01, 0.63 + step_rad)), atol=1e-6
    )


def test_what_the_autopilot_has_not_told_is_not_made_up() -> None:
    assert AutopilotMotionSource(PoseHistory(), as_it_is).motion_between(0, 100, 200) is None
    motions = AutopilotMotionSource(history(0.0), as_it_is)
    assert motions.motion_between(1_900_000_000, 2_000_000_000, 9_000_000_000) is None
    assert motions.motion_between(-900_000_000, 2_000_000_000, 2_100_000_000) is None


def test_what_comes_late_is_made_up_for() -> None:
    """Velocities twice a second, clouds ten times: what is gained adds up to what was gained, 0.5 m/s each second."""
    kept, motions, gained, end_ns = PoseHistory(), [], 0.0, None
    source = AutopilotMotionSource(kept, as_it_is)
    for number in range(50):
        stamp_ns = number * STEP_NS
        kept.add_attitude(stamp_ns, quaternion_from_euler(0.0, 0.0, 0.0), np.zeros(3))
        if number % 5 == 0:
            kept.add_position(stamp_ns, np.zeros(3), np.array([0.5 * stamp_ns * 1e-9, 0.0, 0.0]))
        motions.append(source.motion_between(end_ns, stamp_ns, stamp_ns))
        end_ns = stamp_ns
    gained = sum(one.gained_ned_mps[0] for one in motions if one is not None)
    assert None not in motions
    assert gained == pytest.approx(0.5 * 4.5, abs=1e-9)


def test_a_long_silence_is_bridged_by_what_was_told_last() -> None:
    kept = PoseHistory()
    source = AutopilotMotionSource(kept, as_it_is)
    kept.add_attitude(0, quaternion_from_euler(0.0, 0.0, 0.0), np.zeros(3))
    kept.add_position(0, np.zeros(3), np.array([2.0, 0.0, 0.0]))
    assert source.motion_between(None, 0, 0) is not None
    assert source.motion_between(0, 3_000_000_000, 3_000_000_000) is None
    for stamp_ns in (8_000_000_000, 8_040_000_000):
        kept.add_attitude(stamp_ns, quaternion_from_euler(0.0, 0.0, 1.0), np.zeros(3))
        kept.add_position(stamp_ns, np.zeros(3), np.zeros(3))
    found = source.motion_between(0, 8_000_000_000, 8_040_000_000)
    assert found is not None
    np.testing.assert_allclose(found.gained_ned_mps, [-2.0, 0.0, 0.0])
    kept.clear()
    kept.add_attitude(0, quaternion_from_euler(0.0, 0.0, 0.0), np.zeros(3))
    kept.add_position(0, np.zeros(3), np.zeros(3))
    assert source.motion_between(8_040_000_000, 0, 0) is None  # of an autopilot that began anew


def test_crests_are_told_from_what_stands_where_down_is_known() -> None:
    """Water 0.6 m below a body that heels by 6 degrees: at 18 m to the side it is 1.9 m off its plane."""
    rng = np.random.default_rng(6)
    heel = rotation_matrix(quaternion_from_euler(np.radians(6.0), 0.0, 0.0))
    azimuth = rng.uniform(-0.7, 0.7, 3000)
    reach = np.concatenate([rng.uniform(2.0, 9.0, 2000), rng.uniform(13.0, 19.0, 1000)])
    water = np.stack([reach * np.cos(azimuth), reach * np.sin(azimuth), 0.6 + rng.normal(0.0, 0.05, 3000)], axis=1)
    pole = np.stack([np.full(200, 15.0), np.full(200, 4.0), rng.uniform(-2.0, 0.2, 200)], axis=1)
    points = (np.concatenate([water, pole]) @ heel).astype(np.float32)
    lag = np.zeros(len(points), dtype=np.float32)
    plane = WaterPlane()
    wet = plane.water_mask(points, lag)
    # seen 0.1 s before the cloud's end, from a body that rolls: by then it has rolled into where `heel` is
    rolls = np.array([0.5, 0.0, 0.0])
    earlier = rotation_matrix(quaternion_from_euler(-0.05, 0.0, 0.0))
    crests = plane.crest_mask((points @ earlier).astype(np.float32), lag - np.float32(0.1), heel[2], rolls)
    assert wet[:2000].all()
    assert crests[2000:3000].all()
    assert not crests[:2000].any()
    assert not (wet | crests)[3000:].any()
