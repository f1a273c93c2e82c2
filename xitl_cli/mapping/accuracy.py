"""Accuracy of an odometry and a map against the truth, for the summary of a run and `xitl map`.

Trajectory errors are those of Sturm et al. (IROS 2012), as evo computes them. They are given after Umeyama's rigid
alignment, which spreads a drift over the path, and with the first poses aligned, as for a user who starts at the truth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import quat_to_matrix
from sim_core.world.structures import LogBoom
from xitl_cli.logs.compare.trajectories import (
    Similarity,
    Trajectory,
    absolute_errors_m,
    align_trajectory,
    error_statistics,
    frame_pairs,
    relative_errors,
    umeyama,
)
from xitl_cli.mapping.clouds import SeenPoints, at

Array = NDArray[np.float64]

NEAR_M = 1.0
"""Largest distance from the true boom: farther points belong to other objects."""
PASSED_M = 30.0
"""Largest distance at which the vessel has passed a float."""
SEEN_POINTS = 5
LEVER_M = 10.0
"""Typical distance from the vessel to mapped objects."""
RPE_S = 1.0


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Accuracy of odometry and map."""

    odometry: dict[str, Any]
    mapping: dict[str, Any]
    moving: Similarity | None
    """Transform from the odometry's frame to NED by its positions; None when the truth does not determine it."""


def perception_sections(
    truth: Trajectory | None, odometry: Trajectory | None, seen: SeenPoints, boom: LogBoom | None
) -> Accuracy:
    """Return the accuracy of a run's odometry (FRD at its start) and of the map in its frame. None: unknown."""
    count = 0 if odometry is None else len(odometry.stamp_ns)
    errors: dict[str, Any] = {
        "poses": count, "rate_hz": None, "path_m": None, "ate_rms_m": None, "ate_max_m": None,
        "anchored_rms_m": None, "anchored_max_m": None, "anchored_level_rms_m": None, "rpe_m": None,
    }  # fmt: skip
    mapping: dict[str, Any] = {
        "points": len(seen.seen_ns), "boom_points": None, "boom_rms_m": None,
        "boom_uncut_points": None, "boom_uncut_rms_m": None, "coverage": None,
    }  # fmt: skip
    moving = None
    if truth is not None and len(truth.stamp_ns) >= 3 and odometry is not None and count >= 3:
        reference, other = matched(truth, odometry)
        span_s = int(odometry.stamp_ns[-1] - odometry.stamp_ns[0]) * 1e-9
        errors["rate_hz"] = round((count - 1) / span_s, 3)
        moving = umeyama(other.pos_m, reference.pos_m)
        if moving is not None:
            errors |= _aligned_errors(reference, moving.apply(other))
        if len(reference.stamp_ns):
            # Errors with the first poses aligned. The level error leaves out the height: a degree of
            # tilt at the start changes it by a metre in sixty.
            moved, _ = align_trajectory(reference, other, "origin")
            absolute = error_statistics(absolute_errors_m(reference, moved))
            level = error_statistics(np.hypot(*(moved.pos_m - reference.pos_m)[:, :2].T))
            assert absolute is not None
            assert level is not None
            errors |= {
                "anchored_rms_m": round(absolute.rms, 4),
                "anchored_max_m": round(absolute.most, 4),
                "anchored_level_rms_m": round(level.rms, 4),
            }
        laying = laid(reference, other)
        if boom is not None and laying is not None:
            points_ned_m = seen.points_odom_m @ laying.rotation.T + laying.translation
            mapping |= boom_section(points_ned_m, reference.pos_m, boom)
            mapping |= uncut_boom_section(points_ned_m, truly_placed(reference, other, seen), boom)
    return Accuracy(errors, mapping, moving)


def matched(truth: Trajectory, odometry: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Return the truth at the odometry's instants, and the odometry at instants with a truth."""
    reference = at(truth, odometry.stamp_ns)
    rows = np.isin(odometry.stamp_ns, reference.stamp_ns)
    return reference, Trajectory(odometry.stamp_ns[rows], odometry.pos_m[rows], odometry.quat_wxyz[rows])


def laid(reference: Trajectory, other: Trajectory) -> Similarity | None:
    """Return the transform of the map that belongs to `other`: its poses, with the same stamps, onto the reference.

    Each pose gives its position and a point LEVER_M along each of its axes. Positions alone would leave the roll about
    a nearly straight path open or random.
    """
    return umeyama(_corners(other), _corners(reference))


def _corners(trajectory: Trajectory) -> Array:
    axes = quat_to_matrix(trajectory.quat_wxyz)
    return np.concatenate([trajectory.pos_m, *(trajectory.pos_m + LEVER_M * axes[:, :, axis] for axis in range(3))])


def truly_placed(reference: Trajectory, other: Trajectory, seen: SeenPoints) -> Array:
    """Return where points (n, 3) would be in NED, placed by the true pose at the time when they were seen."""
    stamps = reference.stamp_ns
    after = np.clip(np.searchsorted(stamps, seen.seen_ns), 1, len(stamps) - 1)
    nearest = after - (seen.seen_ns - stamps[after - 1] < stamps[after] - seen.seen_ns)
    turning = quat_to_matrix(reference.quat_wxyz) @ np.swapaxes(quat_to_matrix(other.quat_wxyz), 1, 2)
    moved = reference.pos_m - np.einsum("nij,nj->ni", turning, other.pos_m)
    placed: Array = np.einsum("nij,nj->ni", turning[nearest], seen.points_odom_m.astype(float)) + moved[nearest]
    return placed


def uncut_boom_section(points_ned_m: Array, true_ned_m: Array, boom: LogBoom) -> dict[str, Any]:
    """Return the distance of the boom's map points (n, 3) from its surface, without a limit.

    The true positions of the points (n, 3) decide which belong to the boom. A map that drifted by metres therefore
    loses none.
    """
    around = _around(true_ned_m, boom)
    near = np.abs(boom.distance_m(true_ned_m[around])) <= NEAR_M if len(around) else np.empty(0, dtype=bool)
    errors = error_statistics(np.abs(boom.distance_m(points_ned_m[around[near]])) if near.any() else np.empty(0))
    return {
        "boom_uncut_points": int(np.count_nonzero(near)),
        "boom_uncut_rms_m": None if errors is None else round(errors.rms, 4),
    }


def _around(points_ned_m: Array, boom: LogBoom) -> NDArray[np.intp]:
    """Return the numbers of the points in the bounding box of a boom, 10 m wider."""
    piles = np.array([[*pile.place_ne_m, 0.0] for pile in boom.piles]).reshape(-1, 3)
    bounds = np.concatenate([boom.ends_ned_m.reshape(-1, 3), piles])
    inside = (points_ned_m > bounds.min(axis=0) - 10.0) & (points_ned_m < bounds.max(axis=0) + 10.0)
    return np.flatnonzero(inside.all(axis=1))


def boom_section(points_ned_m: Array, track_ned_m: Array, boom: LogBoom) -> dict[str, Any]:
    """Return the distance of points (n, 3) near a boom from its surface, and the mapped share of its passed part.

    The passed part is next to a track (m, 3).
    """
    around = points_ned_m[_around(points_ned_m, boom)]
    off_m = boom.distance_m(around) if len(around) else np.empty(0)
    near = np.abs(off_m) <= NEAR_M
    errors = error_statistics(np.abs(off_m[near]))
    # Floats that the vessel passed: near enough to the track and not beyond one of its ends
    middle = boom.centre_ned_m[:, :2]
    track = track_ned_m[:: max(len(track_ned_m) // 1000, 1), :2]
    apart_m = np.linalg.norm(middle[:, None] - track[None], axis=2)
    nearest = np.argmin(apart_m, axis=1)
    passed = (nearest > 0) & (nearest < len(track) - 1) & (apart_m.min(axis=1) <= PASSED_M)
    # Floats with enough points; each point counts for the float with the nearest middle
    count = np.zeros(len(middle), dtype=np.int64)
    near_ne_m = around[near][:, :2]
    for first in range(0, len(near_ne_m), 10_000):
        off_middle_m = np.linalg.norm(near_ne_m[first : first + 10_000, None] - middle[None], axis=2)
        count += np.bincount(np.argmin(off_middle_m, axis=1), minlength=len(count))
    seen = count >= SEEN_POINTS
    return {
        "boom_points": int(np.count_nonzero(near)),
        "boom_rms_m": None if errors is None else round(errors.rms, 4),
        "coverage": round(float(np.mean(seen[passed])), 4) if passed.any() else None,
    }


def apart(first: Trajectory, second: Trajectory) -> dict[str, Any]:
    """Return the distance between two odometries of the same clouds at the same instants, without alignment."""
    # the wire format has instants in whole microseconds
    common, rows, others = np.intersect1d(first.stamp_ns // 1000, second.stamp_ns // 1000, return_indices=True)
    errors = error_statistics(np.linalg.norm(first.pos_m[rows] - second.pos_m[others], axis=1))
    return {
        "poses": len(common),
        "rms_m": None if errors is None else round(errors.rms, 4),
        "max_m": None if errors is None else round(errors.most, 4),
    }


def _aligned_errors(reference: Trajectory, other: Trajectory) -> dict[str, Any]:
    absolute = error_statistics(absolute_errors_m(reference, other))
    period_s = float(np.median(np.diff(reference.stamp_ns))) * 1e-9
    pairs = frame_pairs(len(reference.stamp_ns), max(round(RPE_S / period_s), 1))
    relative = error_statistics(relative_errors(reference, other, pairs)[0]) if len(pairs) else None
    path_m = float(np.linalg.norm(np.diff(reference.pos_m, axis=0), axis=1).sum())
    return {
        "path_m": round(path_m, 3),
        "ate_rms_m": None if absolute is None else round(absolute.rms, 4),
        "ate_max_m": None if absolute is None else round(absolute.most, 4),
        "rpe_m": None if relative is None else round(relative.rms, 4),
    }
