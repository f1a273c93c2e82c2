"""How far apart the two paths are: at the same instant, and whenever."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.compare.common_time import integral
from xitl_cli.logs.compare.path import off_path_m, thinned
from xitl_cli.logs.compare.position import Poses
from xitl_cli.logs.compare.trajectories import (
    Alignment,
    Similarity,
    Statistics,
    Trajectory,
    absolute_errors_m,
    aligned,
    frame_pairs,
    path_pairs,
    relative_errors,
    statistics,
)
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace

Array = NDArray[np.float64]

_FAR_M = 2000.0
_STEP_M = 1.0
_HIGH_M = 2.0
_HIGH_SHARE = 3.0


def moved_poses(poses: Poses, how: Alignment) -> tuple[Trajectory, Similarity | None]:
    """B as it is compared: moved onto A as asked."""
    return aligned(poses.a, poses.b, how)


def trajectory_section(poses: Poses, how: Alignment) -> Section:
    b, moving = moved_poses(poses, how)
    a = poses.a
    apart = b.pos_m - a.pos_m
    level_m = np.hypot(apart[:, 0], apart[:, 1])
    covered_s, iae_x = integral(a.stamp_ns, np.abs(apart[:, 0]))
    _, iae_y = integral(a.stamp_ns, np.abs(apart[:, 1]))
    off_m = off_path_m(b.pos_m[:, :2], thinned(poses.way_a))
    worst = int(np.argmax(level_m))
    facts = [
        Fact("common_time_s", "Common time", round(covered_s, 3), "s"),
        Fact("iae_x_ms", "IAE x (east)", _number(iae_x), "m s"),
        Fact("iae_y_ms", "IAE y (north)", _number(iae_y), "m s"),
        Fact("position_rms_m", "Horizontal distance, RMS", _number(float(np.sqrt(np.mean(level_m**2)))), "m"),
        Fact("position_max_m", "Horizontal distance, most", _number(float(level_m[worst])), "m"),
        Fact("east_max_m", "East, most", _number(float(np.abs(apart[:, 0]).max())), "m"),
        Fact("north_max_m", "North, most", _number(float(np.abs(apart[:, 1]).max())), "m"),
        Fact("path_rms_m", "Off A's path, RMS", _number(float(np.sqrt(np.mean(off_m**2)))), "m"),
        Fact("path_max_m", "Off A's path, most", _number(float(off_m.max())), "m"),
        Fact("alignment", "Alignment of B", how if moving is not None or how == "none" else f"{how}: not possible"),
        *_moved_by(moving),
        Fact("origin", "Zero", _origin(poses.origin)),
    ]
    return Section(
        "trajectory",
        "Trajectory",
        tuple(facts),
        tuple(_findings(poses, how, moving, level_m, apart[:, 2], worst)),
        (_errors_grid(a, b, poses.attitudes),),
        _plots(a, b, apart, level_m, off_m),
        () if poses.attitudes else ("Turns are not compared: one of the logs tells no attitude.",),
    )


def _findings(
    poses: Poses, how: Alignment, moving: Similarity | None, level_m: Array, up_m: Array, worst: int
) -> list[Finding]:
    at = Evidence(poses.sources[0], None, int(poses.a.stamp_ns[worst]), value=f"{level_m[worst]:.2f} m")
    rms = float(np.sqrt(np.mean(level_m**2)))
    found = [
        Finding(
            "trajectory.distance",
            Severity.OK,
            f"B is {rms:.3g} m (RMS) from A at the same instant, at most {level_m[worst]:.3g} m",
            (at,),
        )
    ]
    if how == "none" and float(np.median(level_m)) > _FAR_M:
        found.append(
            Finding(
                "trajectory.elsewhere",
                Severity.WARNING,
                f"The two paths lie {float(np.median(level_m)) / 1000:.1f} km apart: they are of different places",
                (at,),
                "Lay the beginnings over each other with --align origin, or fit B to A with --align se3.",
            )
        )
    up_rms = float(np.sqrt(np.mean(up_m**2)))
    if up_rms > max(_HIGH_M, _HIGH_SHARE * rms):
        high = int(np.argmax(np.abs(up_m)))
        found.append(
            Finding(
                "trajectory.heights",
                Severity.NOTICE,
                f"The heights differ by {up_rms:.1f} m (RMS), at most {abs(up_m[high]):.1f} m, the level places by "
                f"{rms:.2f} m: the errors in space are mostly of height",
                (Evidence(poses.sources[0], None, int(poses.a.stamp_ns[high]), value=f"{up_m[high]:.1f} m up"),),
                "Take the level errors, or compare from when both estimators have their origin with --armed or --from.",
            )
        )
    if how == "none" and not poses.common:
        found.append(
            Finding(
                "trajectory.zeros",
                Severity.WARNING,
                "At least one log does not tell where its local zero is, so the distance includes that of the zeros",
                (at,),
                "Lay the beginnings over each other with --align origin, or fit B to A with --align se3.",
            )
        )
    if how in ("se3", "sim3") and moving is None:
        found.append(
            Finding(
                "trajectory.not_aligned",
                Severity.WARNING,
                f"B could not be fitted to A ({how}): its path is a point or a straight line, so it was left as it is",
                (at,),
                "Use --align origin, or compare logs in which the vessel turns.",
            )
        )
    return found


def _errors_grid(a: Trajectory, b: Trajectory, attitudes: bool) -> Grid:
    level_m = np.hypot(*(b.pos_m - a.pos_m)[:, :2].T)
    rows = [
        ("ATE, level (m)", *_cells(statistics(level_m))),
        ("ATE, in space (m)", *_cells(statistics(absolute_errors_m(a, b)))),
    ]
    for name, pairs in (
        ("RPE, pose to pose", frame_pairs(len(a.pos_m), 1)),
        (f"RPE, {_STEP_M:g} m of B's path", path_pairs(b.pos_m, _STEP_M)),
    ):
        if not len(pairs):
            continue
        moved_m, turned_deg = relative_errors(a, b, pairs)
        rows.append((f"{name} (m)", *_cells(statistics(moved_m))))
        if attitudes:
            rows.append((f"{name} (deg)", *_cells(statistics(turned_deg))))
    names = ("error", "rmse", "max", "mean", "median", "std", "min", "sse", "count")
    return Grid("trajectory.errors", "Absolute and relative trajectory error", names, tuple(rows))


def _cells(found: Statistics | None) -> tuple[float | int | None, ...]:
    if found is None:
        return (None,) * 8
    values = (found.rms, found.most, found.mean, found.median, found.std, found.least, found.sse)
    return (*(_number(value) for value in values), found.count)


def _plots(a: Trajectory, b: Trajectory, apart: Array, level_m: Array, off_m: Array) -> tuple[Plot, ...]:
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


def _moved_by(moving: Similarity | None) -> list[Fact]:
    if moving is None:
        return []
    turned_deg = float(np.degrees(np.arctan2(moving.rotation[1, 0], moving.rotation[0, 0])))
    east, north, up = (round(float(each), 4) for each in moving.translation)
    return [
        Fact("moved_m", "B moved by", f"{east:g} east, {north:g} north, {up:g} up", "m"),
        Fact("turned_deg", "B turned by (anticlockwise)", round(turned_deg, 4), "deg"),
        Fact("scale", "B scaled by", round(moving.scale, 6)),
    ]


def _origin(origin: tuple[float, float, float] | None) -> str | None:
    return None if origin is None else f"{origin[0]:.7f}, {origin[1]:.7f}, {origin[2]:.2f} m"


def _number(value: float) -> float | None:
    return float(f"{value:.9g}") if np.isfinite(value) else None
