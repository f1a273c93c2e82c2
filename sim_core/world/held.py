"""Bodies against what stands in the water and against the banks, and what any push does to them."""

from __future__ import annotations

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.world.capsules import Capsules, Numbers, touches
from sim_core.world.contact import bed_normal, pressed_n
from sim_core.world.drifting import DebrisState, Push
from sim_core.world.river import Bed

Array = NDArray[float64]


def held_by(standing: Capsules, bed: Bed | None, debris: DebrisState, dt_s: float) -> list[Push]:
    """What presses on the bodies, in a step of dt_s."""
    bodies = capsules_of(debris)
    figures = debris.figures
    pushes: list[Push] = []
    if len(standing):
        reach = figures.half_axis_m + figures.radius_m
        body, other = np.nonzero(standing.distance_m(debris.pos_ned_m[:, :2]) < reach[:, None])
        touch = touches(bodies, standing, body, other) if len(body) else None
        if touch is not None and len(touch.first):
            pushes.append(_pressed(debris, touch.first, touch.place_ne_m, touch.normal_ne, touch.depth_m, dt_s))
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
            pushes.append(_pressed(debris, aground % len(bodies), ends[aground], out, np.minimum(depth, 0.5), dt_s))
    return pushes


def _pressed(debris: DebrisState, body: Numbers, place: Array, normal: Array, depth: Array, dt_s: float) -> Push:
    mass = debris.figures.masses_kg[body, 0]
    force = pressed_n(normal, depth, body_velocity(debris, body, place), mass, dt_s)
    return push_of(debris, body, place, force)


def together(pushes: list[Push]) -> Push:
    """The sum of one or more."""
    force, moment = pushes[0].force_ne_n, pushes[0].moment_nm
    for push in pushes[1:]:
        force, moment = force + push.force_ne_n, moment + push.moment_nm
    return Push(force, moment)


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


def push_of(debris: DebrisState, body: Numbers, place_ne_m: Array, force_ne_n: Array) -> Push:
    """K forces (K, 2) at places on the bodies."""
    lever = place_ne_m - debris.pos_ned_m[body, :2]
    force, moment = np.zeros((len(debris.bodies), 2)), np.zeros(len(debris.bodies))
    np.add.at(force, body, force_ne_n)
    np.add.at(moment, body, lever[:, 0] * force_ne_n[:, 1] - lever[:, 1] * force_ne_n[:, 0])
    return Push(force, moment)
