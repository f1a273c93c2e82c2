"""Both positions at the same instants, in one local frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_core.frames import euler_to_quat, ned_to_enu, quat_ned_frd_to_enu_flu
from xitl_cli.logs import signals
from xitl_cli.logs.compare.common_time import Pairing, match
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.logs.log import Log
from xitl_cli.logs.signals import Of

Array = NDArray[np.float64]

_MOST_POSES = 20_000


@dataclass(frozen=True, slots=True)
class Poses:
    """a, b: the same stamps, on A's time; east, north, up (m) about `origin`, attitude FLU in it. sources: of places.

    common: whether both are about one place on the Earth; if not, each is about a zero of its own. attitudes: whether
    both tell theirs; if not, all are level and heading east. way_a: (M, 2) east and north of A at all times.
    """

    a: Trajectory
    b: Trajectory
    origin: tuple[float, float, float] | None
    common: bool
    attitudes: bool
    sources: tuple[str, str]
    way_a: Array


def poses(a: Log, b: Log, pairing: Pairing, of_a: Of, of_b: Of) -> Poses | None:
    """None where one does not tell its position, or they have no common time."""
    in_a = signals.position_ned(a, of_a)
    if in_a is None:
        return None
    in_b = signals.position_ned(b, of_b, in_a.origin)
    if in_b is None:
        return None
    matched = match(in_a.path, in_b.path, pairing)
    if matched is None:
        return None
    stamps, ned_a, ned_b = matched
    every = max(1, -(-len(stamps) // _MOST_POSES))
    stamps, ned_a, ned_b = stamps[::every], ned_a[::every], ned_b[::every]
    quat_a = _attitude(a, of_a, stamps, None)
    quat_b = _attitude(b, of_b, stamps, pairing)
    told = quat_a is not None and quat_b is not None
    if quat_a is None or quat_b is None:
        quat_a = quat_b = np.tile([1.0, 0.0, 0.0, 0.0], (len(stamps), 1))
    return Poses(
        Trajectory(stamps, ned_to_enu(ned_a), quat_a),
        Trajectory(stamps, ned_to_enu(ned_b), quat_b),
        in_a.origin,
        in_a.origin == in_b.origin,
        told,
        (in_a.path.source, in_b.path.source),
        in_a.path.values[:, (1, 0)],
    )


def _attitude(log: Log, of: Of, stamp_ns: NDArray[np.int64], pairing: Pairing | None) -> Array | None:
    """(N, 4) FLU to ENU; where a sample is missing the nearest one."""
    angles = []
    for found in (signals.roll(log, of), signals.pitch(log, of), signals.yaw(log, of)):
        if found is None:
            return None
        moved = found if pairing is None else pairing.moved(found)
        held = np.clip(stamp_ns, moved.stamp_ns[0], moved.stamp_ns[-1])
        angles.append(np.radians(moved.at(held)))
    return quat_ned_frd_to_enu_flu(euler_to_quat(np.stack(angles, axis=1)))
