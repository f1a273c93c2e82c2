"""Trajectory errors as the literature defines them, equal to those of the tool `evo`.

Absolute and relative error: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012, sec. VI.
Alignment: Umeyama, Least-squares estimation of transformation parameters between two point patterns, IEEE PAMI, 1991.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import xitl_cli.logs.signals as signals
from sim_core.frames import euler_to_quat, ned_to_enu, quat_ned_frd_to_enu_flu, quat_to_matrix
from xitl_cli.logs.compare.pairing import Pairing, common_samples, time_integral
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals import SignalSource

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


def tum_text(trajectory: Trajectory) -> str:
    """Lines `seconds x y z qx qy qz qw`, as evo reads them."""
    seconds = trajectory.stamp_ns // 1_000_000_000
    rest = trajectory.stamp_ns % 1_000_000_000
    quaternions = trajectory.quat_wxyz[:, (1, 2, 3, 0)]
    rows = zip(seconds.tolist(), rest.tolist(), trajectory.pos_m.tolist(), quaternions.tolist(), strict=True)
    return "".join(
        f"{whole}.{part:09d} " + " ".join(f"{value:.9f}" for value in (*place, *turn)) + "\n"
        for whole, part, place, turn in rows
    )


# Distance of two paths: at the same instant, and regardless of time.

_BLOCK = 250_000


def off_path_m(points: Floats, path: Floats) -> Floats:
    """(N,) distance (m) of points (N, 2) from the line through path (M, 2), M at least 1."""
    if len(path) == 1:
        alone: Floats = np.linalg.norm(points - path[0], axis=1)
        return alone
    begins, along = path[:-1], np.diff(path, axis=0)
    lengths = np.maximum(np.sum(along**2, axis=1), 1e-12)
    distance_m = np.empty(len(points))
    block = max(1, _BLOCK // len(begins))
    for first in range(0, len(points), block):
        east, north = (points[first : first + block, axis, None] - begins[:, axis] for axis in (0, 1))
        share = np.clip((east * along[:, 0] + north * along[:, 1]) / lengths, 0.0, 1.0)
        squared = (east - share * along[:, 0]) ** 2 + (north - share * along[:, 1]) ** 2
        distance_m[first : first + block] = np.sqrt(squared.min(axis=1))
    return distance_m


def thinned_path(path: Floats, least_m: float = 0.05, most: int = 2000) -> Floats:
    """Points at least `least_m` from the previous one, at most `most`: a vessel at rest adds none."""
    steps = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    every_m = max(least_m, float(steps[-1]) / most)
    chosen = np.searchsorted(steps, np.arange(0.0, steps[-1], every_m))
    points: Floats = path[np.unique(np.append(chosen, len(path) - 1))]
    return points


_MOST_POSES = 20_000


@dataclass(frozen=True, slots=True)
class PosePair:
    """Poses of both logs at common stamps."""

    a: Trajectory
    """Stamps on A's time; east, north, up (m) about `origin`, attitude FLU in it."""
    b: Trajectory
    """At the stamps of `a`, in the same axes."""
    origin: tuple[float, float, float] | None
    common: bool
    """Whether both are about one position on the Earth. If not, each is about its own zero."""
    attitudes: bool
    """Whether both have attitudes. If not, all are level and heading east."""
    sources: tuple[str, str]
    """Sources of the positions."""
    way_a: Floats
    """(M, 2) east and north of A at all times."""


def common_poses(a: Log, b: Log, pairing: Pairing, of_a: SignalSource, of_b: SignalSource) -> PosePair | None:
    """Poses at common stamps; None if one log has no position, or there is no common time."""
    in_a = signals.position_ned(a, of_a)
    if in_a is None:
        return None
    in_b = signals.position_ned(b, of_b, in_a.origin)
    if in_b is None:
        return None
    matched = common_samples(in_a.path, in_b.path, pairing)
    if matched is None:
        return None
    stamps, ned_a, ned_b = matched
    every = max(1, -(-len(stamps) // _MOST_POSES))
    stamps, ned_a, ned_b = stamps[::every], ned_a[::every], ned_b[::every]
    quat_a = _attitude(a, of_a, stamps, None)
    quat_b = _attitude(b, of_b, stamps, pairing)
    attitudes = quat_a is not None and quat_b is not None
    if quat_a is None or quat_b is None:
        quat_a = quat_b = np.tile([1.0, 0.0, 0.0, 0.0], (len(stamps), 1))
    return PosePair(
        Trajectory(stamps, ned_to_enu(ned_a), quat_a),
        Trajectory(stamps, ned_to_enu(ned_b), quat_b),
        in_a.origin,
        in_a.origin == in_b.origin,
        attitudes,
        (in_a.path.source, in_b.path.source),
        in_a.path.values[:, (1, 0)],
    )


def _attitude(log: Log, of: SignalSource, stamp_ns: Stamps, pairing: Pairing | None) -> Floats | None:
    """(N, 4) FLU to ENU; a missing sample is replaced by the nearest."""
    angles = []
    for angle in (signals.roll(log, of), signals.pitch(log, of), signals.yaw(log, of)):
        if angle is None:
            return None
        moved = angle if pairing is None else pairing.on_a_time(angle)
        clipped_ns = np.clip(stamp_ns, moved.stamp_ns[0], moved.stamp_ns[-1])
        angles.append(np.radians(moved.interpolated(clipped_ns)))
    return quat_ned_frd_to_enu_flu(euler_to_quat(np.stack(angles, axis=1)))


_FAR_M = 2000.0
_APART = ((50.0, Severity.WARNING), (10.0, Severity.NOTICE))  # root mean square (m), the worse first
_STEP_M = 1.0
_HIGH_M = 2.0
_HIGH_SHARE = 3.0


def trajectory_section(poses: PosePair, how: Alignment) -> Section:
    b, moving = align_trajectory(poses.a, poses.b, how)
    a = poses.a
    apart = b.pos_m - a.pos_m
    level_m = np.hypot(apart[:, 0], apart[:, 1])
    covered_s, iae_x = time_integral(a.stamp_ns, np.abs(apart[:, 0]))
    _, iae_y = time_integral(a.stamp_ns, np.abs(apart[:, 1]))
    off_m = off_path_m(b.pos_m[:, :2], thinned_path(poses.way_a))
    worst = int(np.argmax(level_m))
    moved_by: list[Fact] = []
    if moving is not None:
        turned_deg = float(np.degrees(np.arctan2(moving.rotation[1, 0], moving.rotation[0, 0])))
        east, north, up = (round(float(each), 4) for each in moving.translation)
        moved_by.append(Fact("moved_m", "B moved by", f"{east:g} east, {north:g} north, {up:g} up", "m"))
        moved_by.append(Fact("turned_deg", "B turned by (anticlockwise)", round(turned_deg, 4), "deg"))
        moved_by.append(Fact("scale", "B scaled by", round(moving.scale, 6)))
    facts = [
        Fact("common_time_s", "Common time", round(covered_s, 3), "s"),
        Fact("iae_x_ms", "IAE x (east)", _number(iae_x), "m s"),
        Fact("iae_y_ms", "IAE y (north)", _number(iae_y), "m s"),
        Fact("position_rms_m", "Horizontal distance, RMS", _number(float(np.sqrt(np.mean(level_m**2)))), "m"),
        Fact("position_max_m", "Horizontal distance, maximum", _number(float(level_m[worst])), "m"),
        Fact("east_max_m", "East, maximum", _number(float(np.abs(apart[:, 0]).max())), "m"),
        Fact("north_max_m", "North, maximum", _number(float(np.abs(apart[:, 1]).max())), "m"),
        Fact("path_rms_m", "Off A's path, RMS", _number(float(np.sqrt(np.mean(off_m**2)))), "m"),
        Fact("path_max_m", "Off A's path, maximum", _number(float(off_m.max())), "m"),
        Fact("alignment", "Alignment of B", how if moving is not None or how == "none" else f"{how}: not possible"),
        *moved_by,
        Fact(
            "origin",
            "Zero",
            None if poses.origin is None else f"{poses.origin[0]:.7f}, {poses.origin[1]:.7f}, {poses.origin[2]:.2f} m",
        ),
    ]
    return Section(
        "trajectory",
        "Trajectory",
        tuple(facts),
        tuple(_findings(poses, how, moving, level_m, apart[:, 2], worst)),
        (_errors_grid(a, b, poses.attitudes),),
        _plots(a, b, apart, level_m, off_m),
        () if poses.attitudes else ("Rotations are not compared, because one of the logs has no attitude.",),
    )


def _findings(
    poses: PosePair, how: Alignment, moving: Similarity | None, level_m: Floats, up_m: Floats, worst: int
) -> Iterator[Finding]:
    at = Evidence(poses.sources[0], None, int(poses.a.stamp_ns[worst]), value=f"{level_m[worst]:.2f} m")
    rms = float(np.sqrt(np.mean(level_m**2)))
    severity = next((severity for limit_m, severity in _APART if rms >= limit_m), Severity.OK)
    yield Finding(
        "trajectory.distance",
        severity,
        f"B is {rms:.3g} m (RMS) from A at the same instant, at most {level_m[worst]:.3g} m",
        (at,),
        ""
        if severity == Severity.OK
        else "Find on the map where the paths diverge; compare modes and waypoints there.",
    )
    if how == "none" and float(np.median(level_m)) > _FAR_M:
        yield Finding.warning(
            "trajectory.elsewhere",
            f"The two paths lie {float(np.median(level_m)) / 1000:.1f} km apart: they are of different places",
            (at,),
            "Align the first poses with --align origin, or fit B to A with --align se3.",
        )
    up_rms = float(np.sqrt(np.mean(up_m**2)))
    if up_rms > max(_HIGH_M, _HIGH_SHARE * rms):
        high = int(np.argmax(np.abs(up_m)))
        yield Finding.notice(
            "trajectory.heights",
            f"The heights differ by {up_rms:.1f} m (RMS), at most {abs(up_m[high]):.1f} m, the horizontal positions by "
            f"{rms:.2f} m: the errors in space are mostly errors of height",
            (Evidence(poses.sources[0], None, int(poses.a.stamp_ns[high]), value=f"{up_m[high]:.1f} m up"),),
            "Use the horizontal errors, or compare from when both estimators have their origin with --armed or --from.",
        )
    if how == "none" and not poses.common:
        yield Finding.warning(
            "trajectory.zeros",
            "At least one log does not give its local origin, so the distance includes the distance of the origins",
            (at,),
            "Align the first poses with --align origin, or fit B to A with --align se3.",
        )
    if how in ("se3", "sim3") and moving is None:
        yield Finding.warning(
            "trajectory.not_aligned",
            f"B could not be fitted to A ({how}): its path is a point or a straight line, so B was not moved",
            (at,),
            "Use --align origin, or compare logs in which the vessel turns.",
        )


def _errors_grid(a: Trajectory, b: Trajectory, attitudes: bool) -> Grid:
    level_m = np.hypot(*(b.pos_m - a.pos_m)[:, :2].T)
    rows = [
        ("ATE, level (m)", *_cells(error_statistics(level_m))),
        ("ATE, in space (m)", *_cells(error_statistics(absolute_errors_m(a, b)))),
    ]
    for name, pairs in (
        ("RPE, pose to pose", frame_pairs(len(a.pos_m), 1)),
        (f"RPE, {_STEP_M:g} m of B's path", path_pairs(b.pos_m, _STEP_M)),
    ):
        if not len(pairs):
            continue
        moved_m, turned_deg = relative_errors(a, b, pairs)
        rows.append((f"{name} (m)", *_cells(error_statistics(moved_m))))
        if attitudes:
            rows.append((f"{name} (deg)", *_cells(error_statistics(turned_deg))))
    names = ("error", "rmse", "max", "mean", "median", "std", "min", "sse", "count")
    return Grid("trajectory.errors", "Absolute and relative trajectory error", names, tuple(rows))


def _cells(errors: ErrorStatistics | None) -> tuple[float | int | None, ...]:
    if errors is None:
        return (None,) * 8
    values = (errors.rms, errors.most, errors.mean, errors.median, errors.std, errors.least, errors.sse)
    return (*(_number(value) for value in values), errors.count)


def _plots(a: Trajectory, b: Trajectory, apart: Floats, level_m: Floats, off_m: Floats) -> tuple[Plot, ...]:
    return (
        Plot(
            "trajectory.map",
            "Paths",
            "north (m)",
            (Trace("A", a.pos_m[:, 0], a.pos_m[:, 1]), Trace("B", b.pos_m[:, 0], b.pos_m[:, 1])),
            "map",
            "east (m)",
        ),
        Plot(
            "trajectory.apart",
            "B less A at the same instant",
            "m",
            (
                Trace("east", a.stamp_ns, apart[:, 0]),
                Trace("north", a.stamp_ns, apart[:, 1]),
                Trace("distance", a.stamp_ns, level_m),
            ),
        ),
        Plot("trajectory.off_path", "B's distance from A's path", "m", (Trace("off the path", a.stamp_ns, off_m),)),
    )


def _number(value: float) -> float | None:
    return float(f"{value:.9g}") if np.isfinite(value) else None
