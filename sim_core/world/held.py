"""Bodies in plan, and where they touch what stands in the water and the banks."""

from __future__ import annotations

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.world.capsules import Capsules, Numbers, touches
from sim_core.world.contact import bed_normal
from sim_core.world.drifting import DebrisState, Push
from sim_core.world.holding import holding
from sim_core.world.river import Bed

Array = NDArray[float64]


def held_by(standing: Capsules, bed: Bed | None, debris: DebrisState, dt_s: float) -> Push | None:
    """What presses on the bodies in a step of dt_s, which they would end with the velocities in `debris`, were they not
    held; None for nothing.
    """
    bodies, figures = capsules_of(debris), debris.figures
    # Of each touch: which body, where, the normal and how deep.
    found: list[tuple[Numbers, Array, Array, Array]] = []
    if len(standing):
        reach = figures.half_axis_m + figures.radius_m
        body, other = np.nonzero(standing.distance_m(debris.pos_ned_m[:, :2]) < reach[:, None])
        if len(body):
            touch = touches(bodies, standing, body, other)
            found.append((touch.first, touch.place_ne_m, touch.normal_ne, touch.depth_m))
    if bed is not None:
        ends = np.concatenate([bodies.from_ne_m, bodies.to_ne_m])
        lowest_m = debris.pos_ned_m[:, 2] - figures.middle_m + figures.draught_m
        over = np.tile(lowest_m, 2) - bed.bed_down_m(ends)
        aground = np.flatnonzero(over > 0.0)
        if len(aground):
            normal = bed_normal(bed, ends[aground])
            level = np.sqrt(np.vecdot(normal[:, :2], normal[:, :2]))
            uphill = np.maximum(level, 1e-3)  # a body is not lifted: it is pushed back the way it came up
            depth = over[aground] * -normal[:, 2] / uphill
            out = normal[:, :2] / uphill[:, None]
            found.append((aground % len(bodies), ends[aground], out, np.minimum(depth, 0.5)))
    if not any(len(each[0]) for each in found):
        return None
    body, place, normal, depth = (np.concatenate(column) for column in zip(*found, strict=True))
    return holding(debris, body, place, normal, depth, dt_s)


def together(one: Push, other: Push | None) -> Push:
    """The sum."""
    if other is None:
        return one
    return Push(one.force_ne_n + other.force_ne_n, one.moment_nm + other.moment_nm)


def capsules_of(debris: DebrisState) -> Capsules:
    """The bodies in plan."""
    axis = np.column_stack([np.cos(debris.yaw_rad), np.sin(debris.yaw_rad)]) * debris.figures.half_axis_m[:, None]
    place = debris.pos_ned_m[:, :2]
    return Capsules(place - axis, place + axis, debris.figures.radius_m, ("",) * len(place))


def body_velocity(debris: DebrisState, body: Numbers, place_ne_m: Array) -> Array:
    """(K, 2) velocity of the bodies' matter at places."""
    lever = place_ne_m - debris.pos_ned_m[body, :2]
    turning = debris.yaw_rate_radps[body, None] * np.column_stack([-lever[:, 1], lever[:, 0]])
    velocity: Array = debris.vel_ned_mps[body, :2] + turning
    return velocity
