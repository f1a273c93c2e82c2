"""Trajectory errors as the literature defines them, equal to those of the tool `evo`.

Absolute and relative error: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012, sec. VI.
Alignment: Umeyama, Least-squares estimation of transformation parameters between two point patterns, IEEE PAMI, 1991.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim_core.frames import quat_to_matrix
from xitl_cli.logs.model.table import Floats, Stamps

Alignment = Literal["none", "origin", "se3", "sim3"]


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A path with attitudes."""

    stamp_ns: Stamps
    """(N,) increasing."""
    pos_m: Floats
    """(N, 3) in any one frame."""
    quat_wxyz: Floats
    """(N, 4) body to that frame, unit length."""


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Statistics of errors, which are never negative."""

    count: int
    """Number of errors."""
    rms: float
    mean: float
    median: float
    std: float
    least: float
    most: float
    sse: float
    """Sum of squares."""


@dataclass(frozen=True, slots=True)
class Similarity:
    """x -> scale * rotation @ x + translation. rotation: (3, 3)."""

    rotation: Floats
    translation: Floats
    scale: float = 1.0

    def apply(self, trajectory: Trajectory) -> Trajectory:
        from sim_core.frames import matrix_to_quat

        pos_m = self.scale * trajectory.pos_m @ self.rotation.T + self.translation
        turned = self.rotation @ quat_to_matrix(trajectory.quat_wxyz)
        return Trajectory(trajectory.stamp_ns, pos_m, matrix_to_quat(turned))


def error_statistics(errors: Floats) -> ErrorStatistics | None:
    """Statistics; None without errors."""
    if not len(errors):
        return None
    squares = float(np.sum(errors**2))
    return ErrorStatistics(
        len(errors),
        float(np.sqrt(squares / len(errors))),
        float(np.mean(errors)),
        float(np.median(errors)),
        float(np.std(errors)),
        float(np.min(errors)),
        float(np.max(errors)),
        squares,
    )


def umeyama(source: Floats, target: Floats, *, with_scale: bool = False) -> Similarity | None:
    """Return the least-squares transformation of `source` (N, 3) to `target` (N, 3).

    None if their points do not determine it: all in one position, or on one line.
    """
    if len(source) < 3:
        return None
    from_mean, to_mean = source.mean(axis=0), target.mean(axis=0)
    spread = source - from_mean
    covariance = (target - to_mean).T @ spread / len(source)  # eq. 38
    left, stretch, right = np.linalg.svd(covariance)
    if not stretch[1] > 1e-12 * stretch[0]:  # on one line apart from rounding
        return None
    signs = np.ones(3)
    if np.linalg.det(left) * np.linalg.det(right) < 0.0:
        signs[2] = -1.0  # eq. 39: a rotation, no reflection
    rotation = (left * signs) @ right
    variance = float(np.mean(np.sum(spread**2, axis=1)))
    scale = float(np.sum(stretch * signs)) / variance if with_scale else 1.0  # eq. 42
    return Similarity(rotation, to_mean - scale * rotation @ from_mean, scale)


def align_trajectory(reference: Trajectory, other: Trajectory, how: Alignment) -> tuple[Trajectory, Similarity | None]:
    """Return `other` aligned with `reference`, both with the same stamps, and the transformation (None if not moved).

    how: "origin" makes the first poses equal.
    """
    if how == "none" or not len(other.pos_m):
        return other, None
    if how == "origin":
        first, onto = quat_to_matrix(other.quat_wxyz[0]), quat_to_matrix(reference.quat_wxyz[0])
        rotation = onto @ first.T
        moving = Similarity(rotation, reference.pos_m[0] - rotation @ other.pos_m[0])
    else:
        found = umeyama(other.pos_m, reference.pos_m, with_scale=how == "sim3")
        if found is None:
            return other, None
        moving = found
    return moving.apply(other), moving


def absolute_errors_m(reference: Trajectory, other: Trajectory) -> Floats:
    """(N,) distance of the positions of equal stamps (ATE, in evo: APE of the translation part)."""
    errors: Floats = np.linalg.norm(other.pos_m - reference.pos_m, axis=1)
    return errors


def frame_pairs(count: int, every: int) -> NDArray[np.intp]:
    """(M, 2) indices of poses `every` apart, in consecutive pairs."""
    at = np.arange(0, count, every)
    return np.stack([at[:-1], at[1:]], axis=1)


def path_pairs(pos_m: Floats, length_m: float) -> NDArray[np.intp]:
    """(M, 2) indices of poses between which the path is at least `length_m` long, in consecutive pairs."""
    steps = np.linalg.norm(np.diff(pos_m, axis=0), axis=1)
    chosen, since_m = [0], 0.0
    for index, step_m in enumerate(steps.tolist(), start=1):
        since_m += step_m
        if since_m >= length_m:
            chosen.append(index)
            since_m = 0.0
    at = np.array(chosen, dtype=np.intp)
    return np.stack([at[:-1], at[1:]], axis=1)


def relative_errors(reference: Trajectory, other: Trajectory, pairs: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """(M,) metres and (M,) degrees by which the motion from one pose of a pair to the other differs (RPE).

    These are the translation of the difference of the relative poses, and the angle of its rotation.
    """
    turn_r, move_r = _relative(reference, pairs)
    turn_o, move_o = _relative(other, pairs)
    back = np.swapaxes(turn_r, 1, 2)
    moved = np.einsum("nij,nj->ni", back, move_o - move_r)
    turned = back @ turn_o
    # Use sine and cosine, because each alone is inaccurate near its extremes.
    axis = np.stack(
        [turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0], turned[:, 1, 0] - turned[:, 0, 1]],
        axis=1,
    )
    angle = np.arctan2(np.linalg.norm(axis, axis=1), np.trace(turned, axis1=1, axis2=2) - 1.0)
    return np.linalg.norm(moved, axis=1), np.degrees(angle)


def _relative(trajectory: Trajectory, pairs: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """(M, 3, 3) and (M, 3): the second pose of each pair seen from the first."""
    turns = quat_to_matrix(trajectory.quat_wxyz)
    back = np.swapaxes(turns[pairs[:, 0]], 1, 2)
    moved = trajectory.pos_m[pairs[:, 1]] - trajectory.pos_m[pairs[:, 0]]
    return back @ turns[pairs[:, 1]], np.einsum("nij,nj->ni", back, moved)


def tum_text(trajectory: Trajectory, decimals: int = 9) -> str:
    """Lines `seconds x y z qx qy qz qw`, as evo reads them."""
    seconds = trajectory.stamp_ns // 1_000_000_000
    rest = trajectory.stamp_ns % 1_000_000_000
    quaternions = trajectory.quat_wxyz[:, (1, 2, 3, 0)]
    rows = zip(seconds.tolist(), rest.tolist(), trajectory.pos_m.tolist(), quaternions.tolist(), strict=True)
    return "".join(
        f"{whole}.{part:09d} " + " ".join(f"{value:.{decimals}f}" for value in (*place, *turn)) + "\n"
        for whole, part, place, turn in rows
    )
