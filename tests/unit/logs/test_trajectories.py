"""Trajectory errors against the tool `evo`, which the field measures with."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_core.frames import euler_to_quat
from xitl_cli.logs.compare.trajectories import (
    Trajectory,
    absolute_errors_m,
    align_trajectory,
    error_statistics,
    frame_pairs,
    path_pairs,
    relative_errors,
    tum_text,
    umeyama,
)

metrics = pytest.importorskip("evo.core.metrics", reason="needs evo: pip install 'xitl[test]'")
from evo.core.trajectory import PoseTrajectory3D  # type: ignore[import-untyped]  # noqa: E402
from evo.tools import file_interface  # type: ignore[import-untyped]  # noqa: E402

NAMES = {"rms": "rmse", "mean": "mean", "median": "median", "std": "std", "least": "min", "most": "max", "sse": "sse"}


def walk(seed: int, count: int = 300, noise_m: float = 0.0) -> Trajectory:
    """A path that winds and climbs, with an attitude that has nothing to do with it."""
    rng = np.random.default_rng(seed)
    steps = rng.normal((0.5, 0.1, 0.02), 0.4, (count, 3))
    pos_m = np.cumsum(steps, axis=0) + rng.normal(0.0, noise_m, (count, 3))
    euler = np.cumsum(rng.normal(0.0, 0.05, (count, 3)), axis=0)
    return Trajectory(np.arange(count, dtype=np.int64) * 100_000_000, pos_m, euler_to_quat(euler))


def disturbed(trajectory: Trajectory, seed: int, scale: float = 1.0) -> Trajectory:
    """Elsewhere, turned, and with errors."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-math.pi, math.pi)
    turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    pos_m = scale * trajectory.pos_m @ turn.T + rng.normal(0.0, 5.0, 3) + rng.normal(0.0, 0.3, trajectory.pos_m.shape)
    euler = rng.normal(0.0, 0.02, trajectory.pos_m.shape)
    return Trajectory(trajectory.stamp_ns, pos_m, euler_to_quat(euler))


def of_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(trajectory.pos_m, trajectory.quat_wxyz, trajectory.stamp_ns * 1e-9)


def same(errors: np.ndarray, metric: object) -> None:
    found, theirs = error_statistics(errors), metric.get_all_statistics()  # type: ignore[attr-defined]
    assert found is not None
    assert found.count == len(metric.error)  # type: ignore[attr-defined]
    for ours, name in NAMES.items():
        assert getattr(found, ours) == pytest.approx(theirs[name], rel=1e-9, abs=1e-9), ours


@pytest.mark.medium
@pytest.mark.parametrize("how", ["none", "origin", "se3", "sim3"])
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_absolute_errors_are_those_of_evo(how: str, seed: int) -> None:
    reference = walk(seed)
    other = disturbed(reference, seed + 1, scale=1.3)
    theirs_reference, theirs = of_evo(reference), of_evo(other)
    if how == "origin":
        theirs.align_origin(theirs_reference)
    elif how != "none":
        theirs.align(theirs_reference, correct_scale=how == "sim3")
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((theirs_reference, theirs))
    moved, _ = align_trajectory(reference, other, how)  # type: ignore[arg-type]
    same(absolute_errors_m(reference, moved), ape)


@pytest.mark.medium
@pytest.mark.parametrize(("delta", "unit"), [(1, "frames"), (7, "frames"), (1.0, "meters"), (5.0, "meters")])
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_relative_errors_are_those_of_evo(delta: float, unit: str, seed: int) -> None:
    reference, other = walk(seed), disturbed(walk(seed), seed + 1)
    pairs = frame_pairs(300, int(delta)) if unit == "frames" else path_pairs(other.pos_m, delta)
    moved, turned_deg = relative_errors(reference, other, pairs)
    for errors, relation in (
        (moved, metrics.PoseRelation.translation_part),
        (turned_deg, metrics.PoseRelation.rotation_angle_deg),
    ):
        rpe = metrics.RPE(relation, delta, metrics.Unit[unit])
        rpe.process_data((of_evo(reference), of_evo(other)))
        same(errors, rpe)


def test_evo_reads_the_same_trajectory_from_our_file(tmp_path: Path) -> None:
    reference = walk(3)
    (tmp_path / "a.tum").write_text(tum_text(reference))
    read = file_interface.read_tum_trajectory_file(str(tmp_path / "a.tum"))
    assert read.timestamps == pytest.approx(reference.stamp_ns * 1e-9, abs=1e-9)
    assert read.positions_xyz == pytest.approx(reference.pos_m, abs=1e-9)
    assert read.orientations_quat_wxyz == pytest.approx(reference.quat_wxyz, abs=1e-9)


def test_a_shifted_circle_is_off_by_its_shift() -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 200)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(200)], axis=1) * 20.0
    level = np.tile([1.0, 0.0, 0.0, 0.0], (200, 1))
    stamps = np.arange(200, dtype=np.int64)
    reference, other = Trajectory(stamps, circle, level), Trajectory(stamps, circle + np.array([3.0, 4.0, 0.0]), level)
    found = error_statistics(absolute_errors_m(reference, other))
    assert found is not None
    assert (found.rms, found.most, found.least) == pytest.approx((5.0, 5.0, 5.0))
    moved, moving = align_trajectory(reference, other, "se3")
    assert moving is not None
    assert moving.translation == pytest.approx([-3.0, -4.0, 0.0], abs=1e-9)
    assert absolute_errors_m(reference, moved) == pytest.approx(np.zeros(200), abs=1e-9)


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.outer(np.arange(5.0), (1.0, 2.0, 0.0)), np.zeros((2, 3))])
def test_what_leaves_a_rotation_open_is_not_aligned(points: np.ndarray) -> None:
    assert umeyama(points, points + 1.0) is None
