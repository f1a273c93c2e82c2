"""Odometry on clouds of known motion, and what it does with clouds that are no good."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from scipy.linalg import expm

from agent.companion.odometry import LidarOdometry, OdometryError
from agent.companion.rigid_motion import deskew, exponential, inverse, logarithm
from agent.companion.water_plane import WaterPlane
from tests.unit.companion import river_scans

TWISTS = [
    np.array([1.0, -2.0, 0.5, 0.3, -0.2, 0.9]),
    np.array([3.0, 0.0, 0.0, 0.0, 0.0, 1e-9]),
    np.array([0.1, 0.2, 0.3, 2.0, 1.0, -1.0]),
]


@pytest.mark.parametrize("twist", TWISTS)
def test_the_exponential_is_that_of_matrices(twist: np.ndarray) -> None:
    x, y, z = twist[3:]
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    generator[:3, 3] = twist[:3]
    np.testing.assert_allclose(exponential(twist), expm(generator), atol=1e-9)
    np.testing.assert_allclose(logarithm(exponential(twist)), twist, atol=1e-9)
    np.testing.assert_allclose(inverse(exponential(twist)) @ exponential(twist), np.eye(4), atol=1e-12)


def test_points_are_brought_to_one_instant() -> None:
    twist = np.array([3.0, 0.5, -0.2, 0.3, -0.4, 0.6])
    points = np.random.default_rng(1).uniform(-50, 50, (200, 3))
    lag = np.linspace(-0.1, 0.0, 200)
    exact = np.array([(exponential(twist * t) @ [*p, 1.0])[:3] for p, t in zip(points, lag, strict=True)])
    got = deskew(points.astype(np.float32), lag.astype(np.float32), twist)
    np.testing.assert_allclose(got, exact, atol=0.01)  # third order: (0.78 * 0.1)^3 / 6 of 87 m is 7 mm


@pytest.fixture(scope="module")
def drive() -> list[tuple[int, np.ndarray, np.ndarray]]:
    rng, stands = np.random.default_rng(3), river_scans.poles()
    return [(k * 100_000_000, *river_scans.scan(0.1 * k, stands, rng)) for k in range(60)]


@pytest.mark.medium
def test_it_follows_a_known_motion(drive: list) -> None:
    odometry = LidarOdometry()
    placed = [odometry.register(*cloud) for cloud in drive]
    assert None not in placed
    assert (odometry.poses, odometry.poses_refused, odometry.points_refused) == (60, 0, 0)
    stamps_s = np.array([one.stamp_ns for one in placed]) * 1e-9
    place, attitude = river_scans.pose(stamps_s)
    first = np.eye(4)
    first[:3, :3], first[:3, 3] = attitude[0], place[0]
    errors = [(first @ one.pose_odom)[:3, 3] - where for one, where in zip(placed, place, strict=True)]
    # 12 m of way; the target for a whole mission is 1 %, and here every pole is in sight.
    assert np.linalg.norm(errors, axis=1).max() < 0.25
    assert placed[-1].vel_frd_mps[0] == pytest.approx(river_scans.SPEED_MPS, abs=0.3)


@pytest.mark.medium
def test_water_is_kept_out_of_what_it_hands_on(drive: list) -> None:
    odometry = LidarOdometry()
    for stamp_ns, points, offset in drive[:20]:
        placed = odometry.register(stamp_ns, points, offset)
        assert placed is not None
        assert np.count_nonzero(placed.kept) == len(placed.points_frd_m)
        place, attitude = river_scans.pose(stamp_ns * 1e-9 + offset)
        wet = place[:, 2] + np.einsum("nj,nj->n", attitude[:, 2], points) > -0.06  # three sigma of the range noise
        assert np.count_nonzero(wet & placed.kept) < 0.01 * np.count_nonzero(wet)


@pytest.mark.medium
def test_the_same_clouds_give_the_same_poses(drive: list) -> None:
    one, other = LidarOdometry(), LidarOdometry()
    for cloud in drive[:15]:
        here, there = one.register(*cloud), other.register(*cloud)
        assert here.pose_odom.tobytes() == there.pose_odom.tobytes()


@pytest.mark.medium
def test_a_lost_cloud_is_a_longer_step(drive: list) -> None:
    odometry = LidarOdometry()
    placed = [odometry.register(*cloud) for number, cloud in enumerate(drive[:40]) if number not in (20, 21, 30)][-1]
    place, _ = river_scans.pose(np.array([drive[0][0] * 1e-9 + 0.1, placed.stamp_ns * 1e-9]))
    way = np.linalg.norm(place[1] - place[0])
    assert np.linalg.norm(placed.pose_odom[:3, 3]) == pytest.approx(way, abs=0.25)
    assert odometry.poses_refused == 0


@pytest.mark.medium
def test_bad_clouds_are_refused_and_counted(drive: list) -> None:
    odometry = LidarOdometry()
    stamp_ns, points, offset = drive[0]
    empty = np.empty((0, 3), np.float32)
    assert odometry.register(0, empty, np.empty(0, np.float32)) is None
    assert odometry.register(0, points[:10], offset[:10]) is None
    assert odometry.poses_refused == 2
    bad = points.copy()
    bad[:7, 1], bad[7:9, 0] = np.nan, np.inf
    late = offset.copy()
    late[9:12] = 5.0
    assert odometry.register(stamp_ns, bad, late) is not None
    assert odometry.points_refused == 12
    assert odometry.register(stamp_ns, points, offset) is None  # not later than the one before
    before = odometry.pose_at(stamp_ns + 100_000_000)
    stamp_ns, points, offset = drive[1]
    jumped = points + np.array([0.0, 0.0, 30.0], np.float32)  # nothing of it is where anything was
    odometry.register(stamp_ns, jumped, offset)
    assert np.isfinite(odometry.pose_at(stamp_ns)).all()
    assert np.linalg.norm(odometry.pose_at(stamp_ns)[:3, 3] - before[:3, 3]) < 1.0


def test_points_count_from_the_first_to_the_last_of_a_second_and_within_the_range() -> None:
    """What lies outside of the range of 1 m to 50 m is left out, but it is no bad point."""
    odometry = LidarOdometry(max_range_m=50.0)
    offset_s = np.array([0.0, 1.0, -1e-6, 1.00001, 0.5, 0.5, 0.5, 0.5], dtype=np.float32)
    points = np.array([[5.0, 0.0, 0.0]] * 4 + [[0.6, 0.8, 0.0], [30.0, 40.0, 0.0], [0.5, 0.8, 0.0], [30.0, 40.1, 0.0]])
    odometry.register(0, points.astype(np.float32), offset_s)
    assert odometry.points_refused == 2
    assert (odometry.poses, odometry.poses_refused) == (0, 1), "too few points"


def test_without_kiss_icp_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kiss_icp.config", None)
    with pytest.raises(OdometryError, match=r"pip install 'xitl\[perception\]'"):
        LidarOdometry()


def test_the_water_is_told_from_a_wall_beside_it() -> None:
    rng = np.random.default_rng(5)
    flat = rng.uniform([2, -4, 0], [8, 4, 0], (500, 3))
    flat[:, 2] = 0.3 + 0.03 * flat[:, 0] - 0.02 * flat[:, 1] + rng.normal(0, 0.04, 500)
    wall = np.column_stack([rng.uniform(3, 15, 300), np.full(300, 6.0), rng.uniform(-3, 0.0, 300)])
    points = np.concatenate([flat, wall]).astype(np.float32)
    wet = WaterPlane().water_mask(points, np.zeros(len(points), dtype=np.float32))
    assert wet[:500].mean() > 0.99
    assert wet[500:].mean() < 0.1


def test_the_water_of_one_cloud_says_how_the_body_rolls() -> None:
    """Level water 0.5 m below, seen while the body rolls at 0.4 rad/s, pitches at -0.2 and goes down at 0.1 m/s."""
    rng = np.random.default_rng(2)
    count = 2000
    forward, right = rng.uniform(2.0, 8.0, count), rng.uniform(-4.0, 4.0, count)
    lag = rng.uniform(-0.1, 0.0, count)
    # down in the body, to the first order of angles: those of the sum are below 1e-3
    down = 0.5 - 0.1 * lag - 0.4 * lag * right - 0.2 * lag * forward
    plane = WaterPlane()
    assert plane.water_mask(np.column_stack([forward, right, down]).astype(np.float32), lag.astype(np.float32)).all()
    assert plane.level is not None
    np.testing.assert_allclose(plane.level.turn_frd_radps, [0.4, -0.2, 0.0], atol=2e-3)
    assert plane.level.down_m == pytest.approx(0.5, abs=1e-3)
