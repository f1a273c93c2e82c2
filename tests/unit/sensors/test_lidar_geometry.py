"""Where a lidar's points lie, against planes in closed form, while the vessel moves and turns."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from lidar_scenes import NOTHING, PlaneCaster, SquareOn, accounted, moving, water

from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.sensors.lidar import Lidar, Rosette
from sim_core.sensors.spec import LidarSpec
from sim_core.world import geometry as shapes
from sim_core.world.geometry import WALL, WOOD
from sim_core.world.ray_backends import make_caster
from sim_core.world.rays import Bodies, Scene, ScenePart

EXACT = Lidar(LidarSpec(range_noise_m=0.0, position_frd_m=(0.0, 0.0, 0.0)))


def test_a_wall_ahead_is_flat_and_each_ray_has_the_range_of_its_angle() -> None:
    rng = np.random.default_rng(1)
    scan = EXACT.scan(moving(), PlaneCaster((1.0, 0.0, 0.0), 30.0), water(), rng)
    assert scan.fates.fired == scan.fates.returned == 10_000
    np.testing.assert_allclose(scan.points_frd_m[:, 0], 30.0, atol=2e-5)  # single precision at 37 m
    looking = Rosette(100_000.0).directions(0, 10_000).T
    np.testing.assert_allclose(scan.points_frd_m, looking * (30.0 / looking[:, :1]), atol=2e-5)
    np.testing.assert_allclose(scan.offset_s, np.arange(10_000) * 1e-5, atol=1e-8)


def test_the_mount_is_taken_out() -> None:
    """A sensor turned and off the middle sees the same wall in body axes."""
    turned = Lidar(
        LidarSpec(range_noise_m=0.0, position_frd_m=(1.2, -0.4, -0.9), roll_deg=20.0, pitch_deg=-12.0, yaw_deg=35.0)
    )
    caster = PlaneCaster((1.0, 0.0, 0.0), 30.0)
    scan = turned.scan(moving(), caster, water(), np.random.default_rng(1))
    np.testing.assert_allclose(scan.points_frd_m[:, 0], 30.0, atol=3e-5)
    origin, direction, _ = caster.asked[0]
    np.testing.assert_allclose(origin, np.tile([1.2, -0.4, -0.9], (10_000, 1)), atol=1e-6)
    axis = quat_to_matrix(euler_to_quat(np.radians([20.0, -12.0, 35.0]))) @ [1.0, 0.0, 0.0]
    off = np.degrees(np.arccos(np.clip(direction @ axis, -1.0, 1.0)))
    assert off.max() == pytest.approx(35.2, abs=0.05)


def test_pitch_is_up_positive_and_yaw_to_starboard() -> None:
    for turned, component, sign in (({"pitch_deg": 30.0}, 2, -1.0), ({"yaw_deg": 30.0}, 1, 1.0)):
        caster = PlaneCaster((1.0, 0.0, 0.0), 30.0)
        Lidar(LidarSpec(**turned)).scan(moving(), caster, water(), np.random.default_rng(1))
        assert sign * caster.asked[0][1][:, component].mean() > 0.3


@pytest.mark.parametrize("points_hz", [100_000.0, 99_000.0, 12_345.6, 1000.0])
def test_each_point_is_of_its_own_instant(points_hz: float) -> None:
    """A vessel that drives, rolls, pitches and turns: put where it truly was at each instant, the points are a wall."""
    motion = {
        "start_ns": 3_300_000_000,
        "place_ned_m": (900.0, -400.0, -0.3),
        "velocity_ned_mps": (3.0, 1.0, 0.2),
        "turned_deg": (3.0, -2.0, 10.0),
        "turning_degps": (20.0, -15.0, 40.0),
    }
    normal = np.array([np.cos(0.3), np.sin(0.3), 0.0])
    distance_m = float(normal @ [940.0, -400.0, 0.0])
    lidar = Lidar(LidarSpec(range_noise_m=0.0, points_hz=points_hz, position_frd_m=(1.0, 0.2, -0.8), yaw_deg=5.0))
    caster = PlaneCaster(tuple(normal), distance_m)
    scan = lidar.scan(moving(**motion), caster, water(), np.random.default_rng(1))
    assert scan.fates.fired == pytest.approx(0.1 * points_hz, abs=1)
    assert np.all((scan.offset_s >= 0.0) & (scan.offset_s < 0.1))
    later_s = scan.offset_s.astype(float)[:, None]
    euler = np.radians(np.array(motion["turned_deg"]) + later_s * motion["turning_degps"])
    there = np.array(motion["place_ned_m"]) + later_s * motion["velocity_ned_mps"]
    points = there + np.einsum("nij,nj->ni", quat_to_matrix(euler_to_quat(euler)), scan.points_frd_m)
    # Single precision at 1000 m: 6e-5 m in origin and hit. The chord of a turn of 0.12 degrees in a step: 60 m * 5e-7.
    assert np.abs(points @ normal - distance_m).max() < 4e-4
    # Had all points the pose of the start, they would lie up to 0.3 m off.
    rigid = there[0] + scan.points_frd_m @ quat_to_matrix(euler_to_quat(euler[0])).T
    assert np.abs(rigid @ normal - distance_m).max() > 0.1


def test_frames_follow_each_other_without_a_gap_or_a_point_twice() -> None:
    lidar = Lidar(LidarSpec(range_noise_m=0.0, points_hz=12345.6, position_frd_m=(0.0, 0.0, 0.0)))
    stamps = []
    for number in range(20):
        scan = lidar.scan(moving(number * 100_000_000), SquareOn(10.0, WALL), water(), np.random.default_rng(1))
        stamps.append(number * 0.1 + scan.offset_s.astype(float))
    gaps = np.diff(np.concatenate(stamps)) * 12_345.6
    np.testing.assert_allclose(gaps, 1.0, atol=2e-3)  # single precision of 0.1 s in points: 1e-4


def test_noise_is_along_the_ray_and_as_large_as_it_says() -> None:
    lidar = Lidar(LidarSpec(range_noise_m=0.02, position_frd_m=(0.0, 0.0, 0.0)))
    scan = lidar.scan(moving(), PlaneCaster((1.0, 0.0, 0.0), 25.0), water(), np.random.default_rng(2))
    range_m = np.linalg.norm(scan.points_frd_m.astype(float), axis=1)
    looking = scan.points_frd_m / range_m[:, None]
    off = range_m - 25.0 / looking[:, 0]
    assert off.mean() == pytest.approx(0.0, abs=4 * 0.02 / 100)  # four sigma of the mean of 10 000
    assert off.std() == pytest.approx(0.02, rel=4 / np.sqrt(2 * 10_000))


def test_bodies_are_met_when_their_ray_goes_out() -> None:
    caster = PlaneCaster((1.0, 0.0, 0.0), 25.0)
    bodies = Bodies((None,), np.zeros((1, 3)), np.zeros((1, 3)), np.eye(3)[None])
    scan = EXACT.scan(moving(), caster, water(), np.random.default_rng(2), bodies)
    np.testing.assert_array_equal(caster.asked[0][2], scan.offset_s)


@pytest.mark.parametrize("backend", ["embree", "numpy"])
def test_a_body_that_comes_nearer_is_nearer_at_the_end_of_a_frame(backend: Literal["embree", "numpy"]) -> None:
    if backend == "embree":
        pytest.importorskip("embreex")
    crate = shapes.box((1.0, 12.0, 12.0), WOOD)
    bodies = Bodies((crate,), np.array([[20.5, 0.0, 0.0]]), np.array([[-6.0, 0.0, 0.0]]), np.eye(3)[None])
    wall = shapes.box((1.0, 400.0, 400.0), WALL)
    behind = shapes.moved(wall, (60.5, 0.0, 0.0))
    caster = make_caster(Scene((ScenePart("wall", behind),)), backend)
    scan = EXACT.scan(moving(), caster, water(), np.random.default_rng(1), bodies)
    on_crate = scan.points_frd_m[:, 0] < 30.0
    assert np.count_nonzero(on_crate) > 1000
    np.testing.assert_allclose(scan.points_frd_m[on_crate, 0], 20.0 - 6.0 * scan.offset_s[on_crate], atol=3e-5)
    np.testing.assert_allclose(scan.points_frd_m[~on_crate, 0], 60.0, atol=3e-5)


def test_one_seed_one_cloud() -> None:
    lidar = Lidar(LidarSpec(drop_share=0.1, spray_share=0.01, position_frd_m=(0.0, 0.0, 0.0)))
    one, same, other = (
        lidar.scan(moving(), PlaneCaster((1.0, 0.0, 0.0), 60.0), water(-1.0), np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    for name in ("points_frd_m", "offset_s", "intensity"):
        assert getattr(one, name).tobytes() == getattr(same, name).tobytes()
    assert one.points_frd_m.tobytes() != other.points_frd_m.tobytes()


def test_an_empty_sky_returns_nothing() -> None:
    scan = EXACT.scan(moving(), NOTHING, water(), np.random.default_rng(1))
    assert scan.points_frd_m.shape == (0, 3)
    assert scan.fates.returned == 0
    assert accounted(scan.fates)
