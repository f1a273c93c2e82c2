"""Errors of an odometry against evo on the same TUM files, and of a map against a boom whose surface is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.tools import file_interface

from sim_core.frames import euler_to_quat, matrix_to_quat, quat_to_matrix
from sim_core.world.structures import LogBoom
from xitl_cli.logs.compare.trajectories import Trajectory, umeyama
from xitl_cli.mapping.accuracy import apart, boom_section, laid, matched, perception_sections, truly_placed
from xitl_cli.mapping.clouds import SeenPoints, at
from xitl_cli.mapping.map_files import write_tum

NOTHING = SeenPoints(np.empty((0, 3), np.float32), np.empty(0, np.int64))


def seen_at(points, stamp_ns) -> SeenPoints:
    return SeenPoints(points.astype(np.float32), np.broadcast_to(stamp_ns, len(points)).astype(np.int64))


def wandering(count: int = 400, off_m: float = 0.0, turned: bool = False) -> Trajectory:
    """A pass at 10 Hz with some noise, in a frame of its own if `turned`."""
    rng = np.random.default_rng(4)
    t = np.arange(count) * 0.1
    place = np.stack([2.5 * t, 3 * np.sin(0.1 * t), 0.1 * np.sin(t)], axis=-1) + off_m * rng.standard_normal((count, 3))
    euler = np.stack([0.03 * np.sin(t), 0.02 * np.cos(t), 0.1 * np.sin(0.1 * t)], axis=-1)
    if turned:
        c, s = np.cos(0.7), np.sin(0.7)
        place = place @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [40.0, -7.0, 1.0]
        euler = euler + np.array([0, 0, 0.7])
    return Trajectory((t * 1e9).astype(np.int64) + 50_000_000, place, euler_to_quat(euler))


def read_both(folder: Path):
    """Truth and odometry as evo reads them."""
    return sync.associate_trajectories(
        file_interface.read_tum_trajectory_file(folder / "truth.tum"),
        file_interface.read_tum_trajectory_file(folder / "odometry.tum"),
    )


def test_errors_are_those_of_evo(tmp_path: Path) -> None:
    truth, odometry = wandering(turned=True), wandering(off_m=0.1)
    found = perception_sections(truth, odometry, NOTHING, None).odometry
    reference, other = matched(truth, odometry)
    for name, trajectory in (("truth", reference), ("odometry", other)):
        write_tum(tmp_path / f"{name}.tum", trajectory)
    reference, other = read_both(tmp_path)
    other.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, other))
    assert found["ate_rms_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), abs=5e-5)
    assert found["ate_max_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.max), abs=5e-5)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    reference, other = read_both(tmp_path)
    other.align_origin(reference)
    ape.process_data((reference, other))
    assert found["anchored_rms_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), abs=5e-5)
    assert found["anchored_max_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.max), abs=5e-5)
    assert found["anchored_rms_m"] > found["ate_rms_m"]
    rpe = metrics.RPE(metrics.PoseRelation.translation_part, delta=10, delta_unit=metrics.Unit.frames)
    rpe.process_data((reference, other))
    assert found["rpe_m"] == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), abs=5e-5)
    assert found["path_m"] == pytest.approx(reference.path_length, abs=1e-3)
    assert found["rate_hz"] == pytest.approx(10.0)
    assert all(found[name] == round(found[name], 4) for name in found if name.endswith("_m")), "tenths of a millimetre"


def test_poses_in_between_and_none_outside() -> None:
    whole = wandering(200)
    half = Trajectory(whole.stamp_ns[::2], whole.pos_m[::2], whole.quat_wxyz[::2])
    between = at(half, whole.stamp_ns)
    assert len(between.stamp_ns) == 199  # the last lies behind the end
    # Half a step of 0.1 s: r w^2 dt^2 / 2 with at most 0.1 m at 1 rad/s and 3 m at 0.1 rad/s.
    np.testing.assert_allclose(between.pos_m, whole.pos_m[:199], atol=1e-3)


def line() -> LogBoom:
    return LogBoom.along_points([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0]], float_length_m=6.0, float_radius_m=0.5)


def test_points_on_the_boom_are_on_it_and_noise_is_told() -> None:
    rng = np.random.default_rng(6)
    north, turn = rng.uniform(0.5, 59.5, 4000), rng.uniform(np.pi, 2 * np.pi, 4000)
    off = rng.normal(0.0, 0.05, 4000)
    round_m = 0.5 + off
    points = np.column_stack([north, round_m * np.cos(turn), round_m * np.sin(turn)])
    points = points[np.abs(north % 6.0 - 3.0) < 2.5]  # clear of the gaps
    track = np.column_stack([np.linspace(-20, 80, 300), np.full(300, -9.0), np.zeros(300)])
    found = boom_section(np.concatenate([points, [[30.0, 20.0, 0.0]]]), track, line())
    assert found["boom_points"] == len(points)
    assert found["boom_rms_m"] == pytest.approx(0.05, rel=0.05)  # one in sqrt(2 * 3300) is 1.2 %
    assert found["coverage"] == 1.0


def test_coverage_counts_what_was_passed_and_seen() -> None:
    north = np.repeat(np.arange(3.0, 33.0, 6.0), 20)  # five of the ten floats
    points = np.column_stack([north, np.full(len(north), -0.5), np.zeros(len(north))])
    track = np.column_stack([np.linspace(-20, 80, 300), np.full(300, -9.0), np.zeros(300)])
    assert boom_section(points, track, line())["coverage"] == pytest.approx(0.5)
    half = track[track[:, 0] < 30.0]
    assert boom_section(points, half, line())["coverage"] == pytest.approx(1.0)
    assert boom_section(points, track + np.array([0, -100.0, 0]), line())["coverage"] is None


def test_nothing_known_is_nothing_told() -> None:
    found = perception_sections(None, None, NOTHING, None)
    assert (found.odometry["poses"], found.odometry["ate_rms_m"], found.mapping["points"]) == (0, None, 0)
    assert found.moving is None


def test_two_odometries_are_compared_at_common_instants() -> None:
    one = wandering(100)
    other = Trajectory(one.stamp_ns[10:], one.pos_m[10:] + np.array([0.03, 0.0, 0.04]), one.quat_wxyz[10:])
    assert apart(one, other) == {"poses": 90, "rms_m": 0.05, "max_m": 0.05}
    assert umeyama(one.pos_m, one.pos_m) is not None


def test_a_map_along_a_straight_way_is_laid_by_its_poses_as_frames() -> None:
    """Places on a line but for millimetres say nothing of a roll about it; the attitudes do."""
    rng = np.random.default_rng(9)
    count = 300
    track = np.column_stack([np.linspace(-20, 80, count), np.full(count, -9.0), np.zeros(count)])
    still = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    stamps = np.arange(count, dtype=np.int64) * 100_000_000
    noisy = track + rng.normal(0.0, 0.002, (count, 3))
    north, turn = rng.uniform(0.5, 59.5, 2000), rng.uniform(np.pi, 2 * np.pi, 2000)
    points = np.column_stack([north, 0.5 * np.cos(turn), 0.5 * np.sin(turn)])
    points = points[np.abs(north % 6.0 - 3.0) < 2.5]
    truth, odometry = Trajectory(stamps, track, still), Trajectory(stamps, noisy, still)
    found = perception_sections(truth, odometry, seen_at(points, stamps[0]), line())
    assert found.mapping["boom_rms_m"] == pytest.approx(0.0, abs=2e-3)


def test_a_map_that_drifts_by_metres_keeps_its_boom_without_the_cut() -> None:
    """The odometry goes off to one side and the other by 3 m; what is a metre off the boom is cut, and told beside."""
    rng = np.random.default_rng(5)
    count = 300
    stamps = np.arange(count, dtype=np.int64) * 100_000_000
    track = np.column_stack([np.linspace(-20, 80, count), np.full(count, -9.0), np.zeros(count)])
    still = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    off = np.column_stack([np.zeros(count), 3.0 * np.sin(np.arange(count) * 3.0 * np.pi / count), np.zeros(count)])
    when = rng.integers(0, count, 6000)
    turn = rng.uniform(1.2 * np.pi, 1.8 * np.pi, len(when))
    on_boom = np.column_stack([track[when, 0], 0.5 * np.cos(turn), 0.5 * np.sin(turn)])
    kept = (on_boom[:, 0] > 0.5) & (on_boom[:, 0] < 59.5) & (np.abs(on_boom[:, 0] % 6.0 - 3.0) < 2.5)
    elsewhere = on_boom[kept][:50] + np.array([0.0, 30.0, 0.0])
    mapped = np.concatenate([on_boom[kept] + off[when[kept]], elsewhere])
    seen = seen_at(mapped, stamps[np.concatenate([when[kept], np.zeros(50, dtype=int)])])
    found = perception_sections(Trajectory(stamps, track, still), Trajectory(stamps, track + off, still), seen, line())
    assert found.mapping["boom_uncut_points"] == np.count_nonzero(kept)
    assert found.mapping["boom_points"] < np.count_nonzero(kept)
    assert found.mapping["boom_uncut_rms_m"] > 1.2 * found.mapping["boom_rms_m"]
    for name in ("boom_uncut_rms_m", "boom_rms_m"):
        assert found.mapping[name] == round(found.mapping[name], 4) != round(found.mapping[name], 3)
    assert found.odometry["anchored_max_m"] == pytest.approx(np.abs(off).max(), abs=1e-3)
    assert found.odometry["anchored_level_rms_m"] == found.odometry["anchored_rms_m"]  # it goes off sideways


def turned_trajectory(euler: np.ndarray, pos_m: np.ndarray, step_ns: int = 100_000_000) -> Trajectory:
    return Trajectory(np.arange(len(pos_m), dtype=np.int64) * step_ns, pos_m, euler_to_quat(euler))


def test_points_are_placed_by_the_true_pose_nearest_in_time() -> None:
    """A map point is where the true body had what the odometry's body saw."""
    rng = np.random.default_rng(2)
    truth, odometry = (turned_trajectory(rng.uniform(-1, 1, (4, 3)), rng.uniform(-9, 9, (4, 3))) for _ in range(2))
    body = rng.uniform(-20, 20, (8, 3))
    seen_ns = np.array([-5, 0, 49, 51, 149, 151, 300, 400]) * 1_000_000
    poses = [0, 0, 0, 1, 1, 2, 3, 3]
    turns = [quat_to_matrix(trajectory.quat_wxyz) for trajectory in (odometry, truth)]
    points = [turns[0][pose] @ point + odometry.pos_m[pose] for pose, point in zip(poses, body, strict=True)]
    placed = truly_placed(truth, odometry, SeenPoints(np.array(points), seen_ns))
    expected = [turns[1][pose] @ point + truth.pos_m[pose] for pose, point in zip(poses, body, strict=True)]
    np.testing.assert_allclose(placed, expected, atol=1e-9)


def test_a_map_is_laid_by_places_and_axes_alike() -> None:
    """Two turns about one place: their ends are ten metres from it, so that a turn weighs as much as ten metres."""
    rng = np.random.default_rng(3)
    euler, pos_m = rng.uniform(-1, 1, (5, 3)), rng.uniform(-9, 9, (5, 3))
    turn = quat_to_matrix(euler_to_quat(np.array([[0.3, -0.2, 2.0]])))[0]
    shift = np.array([4.0, 5.0, -6.0])
    odometry = turned_trajectory(euler, pos_m)
    turned = quat_to_matrix(odometry.quat_wxyz)
    truth = Trajectory(odometry.stamp_ns, pos_m @ turn.T + shift, matrix_to_quat(turn @ turned))
    found = laid(truth, odometry)
    assert found is not None
    np.testing.assert_allclose(found.rotation, turn, atol=1e-9)
    np.testing.assert_allclose(found.translation, shift, atol=1e-9)
    # One pose: only its axes determine the rotation.
    alone = laid(*(Trajectory(t.stamp_ns[:1], t.pos_m[:1], t.quat_wxyz[:1]) for t in (truth, odometry)))
    assert alone is not None
    np.testing.assert_allclose(alone.rotation, turn, atol=1e-9)


def test_an_odometry_that_climbs_has_no_level_error() -> None:
    north = np.arange(21) * 0.5
    still = np.tile([1.0, 0.0, 0.0, 0.0], (21, 1))
    stamps = np.arange(21, dtype=np.int64) * 250_000_000
    east, off_m = np.abs(north - 5.0), 0.1 * np.arange(21)  # two legs
    truth = Trajectory(stamps, np.column_stack([north, east, 0 * north]), still)
    climbs = Trajectory(stamps, np.column_stack([north, east, off_m]), still)
    found = perception_sections(truth, climbs, NOTHING, None).odometry
    assert (found["poses"], found["rate_hz"], found["path_m"]) == (21, 4.0, 14.142)
    assert found["anchored_level_rms_m"] == 0.0
    assert found["anchored_max_m"] == pytest.approx(2.0)
    assert found["anchored_rms_m"] == pytest.approx(0.1 * np.sqrt(20.0 * 41.0 / 6.0), abs=1e-4)
    assert found["rpe_m"] == pytest.approx(0.4), "four steps are a second"
    sideways = Trajectory(stamps, np.column_stack([north, east + off_m, 0 * north]), still)
    assert (
        perception_sections(truth, sideways, NOTHING, None).odometry["anchored_level_rms_m"] == found["anchored_rms_m"]
    )


@pytest.mark.parametrize(("truths", "poses"), [(2, 9), (9, 2), (3, 9), (9, 3)])
def test_errors_need_three_poses_of_both(truths: int, poses: int) -> None:
    whole = wandering(9)
    truth, odometry = (
        Trajectory(whole.stamp_ns[:count], whole.pos_m[:count], whole.quat_wxyz[:count]) for count in (truths, poses)
    )
    found = perception_sections(truth, odometry, NOTHING, None)
    assert found.odometry["poses"] == poses
    assert (
        (found.odometry["rate_hz"] is not None)
        == (found.odometry["anchored_rms_m"] is not None)
        == (min(truths, poses) > 2)
    )


@pytest.mark.parametrize(
    ("points", "side_m", "since_m", "coverage"),
    [
        (5, -29.9, -20.0, 0.1),
        (4, -29.9, -20.0, 0.0),
        (5, -30.1, -20.0, None),  # farther than 30 m: not passed
        (5, -9.0, 0.0, 0.1),
        (5, -9.0, 10.0, 0.0),  # the vessel was beyond the first two floats from its start on
    ],
)
def test_coverage_is_of_passed_floats_with_five_points(
    points: int, side_m: float, since_m: float, coverage: float | None
) -> None:
    """Points of the first of ten floats: on it, and one more than a metre off."""
    on_float = np.column_stack([np.linspace(2.0, 4.0, points), np.full(points, -0.5), np.zeros(points)])
    track = np.column_stack(
        [np.arange(since_m, 80.0, 0.2), np.full(round((80.0 - since_m) * 5), side_m), 0 * np.arange(since_m, 80.0, 0.2)]
    )
    found = boom_section(np.concatenate([on_float, [(3.0, -1.52, 0.0)]]), track, line())
    assert (found["boom_points"], found["coverage"]) == (points, coverage)
    near = boom_section(np.concatenate([on_float, [(3.0, -1.48, 0.0)]]), track, line())
    assert near["boom_points"] == points + 1
    assert near["boom_rms_m"] == pytest.approx(0.98 / np.sqrt(points + 1), abs=0.02)


@pytest.mark.parametrize(("until_m", "coverage"), [(20.1, 0.3333), (21.1, 0.3333), (21.3, 0.25)])
def test_floats_beyond_the_end_of_a_track_are_not_passed(until_m: float, coverage: float) -> None:
    """Floats of 6 m: the middle of the fourth is at 21 m. Only the first was seen."""
    north = np.arange(-20.0, until_m, 0.2)
    on_float = np.column_stack([np.linspace(2.0, 4.0, 5), np.full(5, -0.5), np.zeros(5)])
    track = np.column_stack([north, np.full(len(north), -9.0), np.zeros(len(north))])
    assert boom_section(on_float, track, line())["coverage"] == coverage


def test_common_instants_are_equal_microseconds() -> None:
    one = wandering(10)
    other = Trajectory(one.stamp_ns // 1000 * 1000 + 999, one.pos_m + np.array([0.0, 0.12346, 0.0]), one.quat_wxyz)
    assert apart(one, other) == {"poses": 10, "rms_m": 0.1235, "max_m": 0.1235}
    later = Trajectory(other.stamp_ns + 1, other.pos_m, other.quat_wxyz)
    assert apart(one, later) == {"poses": 0, "rms_m": None, "max_m": None}
