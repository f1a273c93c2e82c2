"""Contact of debris with fixed structures and with the banks, and the pull of moorings.

Bodies weigh from grams to tonnes and move in long steps, so spring and damper are implicit. The force is that at the
end of the step, F = k (x + x' dt) + c x', which is stable for any mass and step. Contacts of one body depend on each
other. The solver sweeps over them several times, each with the latest forces of the others. This is projected
Gauss-Seidel with soft constraints (Catto 2011, "Soft Constraints"; Coulomb friction as in Catto 2005, "Iterative
Dynamics").
"""

from __future__ import annotations

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.world.contact import FRICTION, STIFFNESS_NPM, SWING_RADPS, bed_normal
from sim_core.world.debris import DebrisState, Push, capsules_of, pushed_at
from sim_core.world.plan import Capsules, Numbers, touches
from sim_core.world.river import Bed

RELEASE_S = 0.2  # release time of a penetration, c / k: nothing bounces off a boom
_SWEEPS = 4  # two ends of a body converge to 1 % in three


def held_by(standing: Capsules, bed: Bed | None, debris: DebrisState, dt_s: float) -> Push | None:
    """Return the push on the bodies in a step of dt_s, None for none. The velocities in `debris` are those at the end
    of a free step.
    """
    bodies, figures = capsules_of(debris), debris.figures
    # For each touch: body, position, normal, depth and friction.
    parts: list[tuple[Numbers, Array, Array, Array, float]] = []
    if len(standing):
        reach = figures.half_axis_m + figures.radius_m
        body, other = np.nonzero(standing.distance_m(debris.pos_ned_m[:, :2]) < reach[:, None])
        if len(body):
            touch = touches(bodies, standing, body, other)
            parts.append((touch.first, touch.place_ne_m, touch.normal_ne, touch.depth_m, FRICTION))
    if bed is not None:
        ends = np.concatenate([bodies.from_ne_m, bodies.to_ne_m])
        lowest_m = debris.pos_ned_m[:, 2] - figures.middle_m + figures.draught_m
        over = np.tile(lowest_m, 2) - bed.bed_down_m(ends)
        aground = np.flatnonzero(over > 0.0)
        if len(aground):
            normal = bed_normal(bed, ends[aground])
            level = np.sqrt(np.vecdot(normal[:, :2], normal[:, :2]))
            uphill = np.maximum(level, 1e-3)  # a body is not lifted: it is pushed back down the slope
            depth = over[aground] * -normal[:, 2] / uphill
            out = normal[:, :2] / uphill[:, None]
            parts.append((aground % len(bodies), ends[aground], out, np.minimum(depth, 0.5), FRICTION))
    moored = np.flatnonzero(np.isfinite(figures.swing_m))
    if len(moored):
        toward = figures.anchor_ne_m[moored] - debris.pos_ned_m[moored, :2]
        away_m = np.hypot(toward[:, 0], toward[:, 1])
        taut = away_m > figures.swing_m[moored]
        line, away_m = moored[taut], away_m[taut]
        normal = toward[taut] / np.maximum(away_m, 1e-9)[:, None]
        parts.append((line, debris.pos_ned_m[line, :2], normal, away_m - figures.swing_m[line], 0.0))
    if not any(len(body) for body, *_ in parts):
        return None
    frictions = np.concatenate([np.full(len(body), friction) for body, *_, friction in parts])
    body, place, normal, depth = (np.concatenate(column) for column in zip(*(part[:4] for part in parts), strict=True))
    return holding(debris, body, place, normal, depth, frictions, dt_s)


def together(push: Push, other: Push | None) -> Push:
    """Return the sum."""
    if other is None:
        return push
    return Push(push.force_ne_n + other.force_ne_n, push.moment_nm + other.moment_nm)


def holding(
    debris: DebrisState,
    body: Numbers,
    place_ne_m: Array,
    normal_ne: Array,
    depth_m: Array,
    friction: Array,
    dt_s: float,
) -> Push:
    """Return the push of K touches: body (K,), position and unit normal away from the structure (K, 2), depth_m (K,).

    friction: coefficients, (K,), 0 for moorings.

    debris: with the velocities that the bodies would have at the end of a free step.
    """
    turns = [
        _Places.from_touches(
            debris, body[rows], place_ne_m[rows], normal_ne[rows], depth_m[rows] / (RELEASE_S + dt_s), rows
        )
        for rows in _turns(body)
    ]
    yielding_s = dt_s * (RELEASE_S + dt_s)
    velocity = np.column_stack([debris.vel_ned_mps[:, :2], debris.yaw_rate_radps])
    press, rub = np.zeros((2, len(body)))
    for _ in range(_SWEEPS):
        for here in turns:
            softness = np.minimum(1.0 / STIFFNESS_NPM, here.yields_across / SWING_RADPS**2) / yielding_s
            moving, pressed, rubbed = velocity[here.body], press[here.rows], rub[here.rows]
            missing = here.release_mps - np.vecdot(moving, here.across) - softness * pressed
            presses = np.maximum(pressed + missing / (here.yields_across + softness), 0.0)
            moving += (presses - pressed)[:, None] * here.pushed_across
            most = friction[here.rows] * presses
            rubs = np.minimum(np.maximum(rubbed - np.vecdot(moving, here.along) / here.yields_along, -most), most)
            velocity[here.body] = moving + (rubs - rubbed)[:, None] * here.pushed_along
            press[here.rows], rub[here.rows] = presses, rubs
    impulse = press[:, None] * normal_ne + rub[:, None] * _turned(normal_ne)
    return pushed_at(debris, body, place_ne_m, impulse / dt_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """K contacts on bodies (K,) that are all different."""

    rows: Numbers
    """Indices of the contacts among all."""
    body: Numbers
    release_mps: Array
    """Speeds at which the penetrations are to be released, (K,)."""
    across: Array
    """Maps the body's velocity (north, east, yaw rate) to the speed of the contact point along the normal, (K, 3)."""
    along: Array
    """The same at right angles to the normal, (K, 3)."""
    pushed_across: Array
    """Change of the body's velocity per unit impulse along the normal, (K, 3)."""
    pushed_along: Array
    """The same at right angles to the normal, (K, 3)."""
    yields_across: Array
    """Change of the contact point's speed per unit impulse along the normal, (K,)."""
    yields_along: Array
    """The same at right angles to the normal, (K,)."""

    @classmethod
    def from_touches(
        cls, debris: DebrisState, body: Numbers, place_ne_m: Array, normal_ne: Array, release_mps: Array, rows: Numbers
    ) -> _Places:
        across, pushed_across = _rows(debris, body, place_ne_m, normal_ne)
        along, pushed_along = _rows(debris, body, place_ne_m, _turned(normal_ne))
        yields = np.vecdot(across, pushed_across), np.vecdot(along, pushed_along)
        return cls(rows, body, release_mps, across, along, pushed_across, pushed_along, *yields)


def _rows(debris: DebrisState, body: Numbers, place_ne_m: Array, way: Array) -> tuple[Array, Array]:
    figures, yaw = debris.figures, debris.yaw_rad[body]
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    shares = np.column_stack([np.vecdot(way, ahead), np.vecdot(way, _turned(ahead))]) / figures.masses_kg[body]
    lever = place_ne_m - debris.pos_ned_m[body, :2]
    arm = lever[:, 0] * way[:, 1] - lever[:, 1] * way[:, 0]
    shifted = shares[:, :1] * ahead + shares[:, 1:] * _turned(ahead)
    return np.column_stack([way, arm]), np.column_stack([shifted, arm / figures.inertia_kgm2[body]])


def _turned(way: Array) -> Array:
    """Rotate by a quarter turn, from north to east."""
    return np.column_stack([-way[:, 1], way[:, 0]])


def _turns(body: Numbers) -> list[Numbers]:
    """Split the contacts into groups without a repeated body: first the first contact of each body, and so on."""
    order = np.argsort(body, kind="stable")
    rank = np.arange(len(body)) - np.searchsorted(body[order], body[order])
    return [order[rank == turn] for turn in range(int(rank.max()) + 1)]
