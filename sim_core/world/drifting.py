"""Bodies adrift: how they are carried, turned and lifted.

    debris = launched(no_debris(), Launch(...), time_ns, current_ned_mps, surface_down_m)
    debris = drift(debris, dt_s, current_ned_mps, surface_down_m, push)

Horizontally a body follows m (1 + C_a) u' = F + 1/2 rho C_d A |w| w, where w is the velocity of the water, and of its
own swimming, relative to the body (Morison et al. 1950 in its drag and added mass), A its wetted area across or along
the flow. It turns slowly to and fro as eddies turn it, and rides the waves' surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.world.bodies import WATER_KGPM3, Body, BodyKind, body_of
from sim_core.world.rays import NO_BODIES, Bodies

Array = NDArray[float64]

ADDED_ACROSS, ADDED_ALONG = 1.0, 0.1  # of the body's mass: a cylinder half in the water, and a slender one end on
DRAG_ACROSS, DRAG_ALONG = 1.1, 0.8  # of a cylinder across the flow and of its blunt end (Hoerner 1965)
TURN_S = 4.0  # in which a body takes the turning of the water around it
EDDY_RADPS = (0.017, 0.011)  # amplitudes of that turning
EDDY_PERIODS_S = (23.0, 57.0)
_GOLDEN = 0.6180339887498949  # each body's eddies have phases of their own, without a draw


@dataclass(frozen=True, slots=True)
class Launch:
    """One body to put into the water; without a length it is of the usual one of its kind."""

    at_ns: int
    kind: BodyKind
    north_m: float
    east_m: float
    heading_rad: float = 0.0
    length_m: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DebrisState:
    """B bodies at time_ns, in the order in which they came: the number of a body is its place.

    pos_ned_m (B, 3) of their middles, vel_ned_mps (B, 3), yaw_rad and yaw_rate_radps (B,). `scheduled`: how many of the
    waterway's launches have been put into the water.
    """

    time_ns: int
    bodies: tuple[Body, ...]
    pos_ned_m: Array
    vel_ned_mps: Array
    yaw_rad: Array
    yaw_rate_radps: Array
    scheduled: int
    figures: Figures


@dataclass(frozen=True, slots=True, eq=False)
class Figures:
    """What does not change of B bodies, side by side.

    masses_kg (B, 2): along and across, with the added ones. drag_kgpm (B, 2): 1/2 rho C_d A along and across.
    inertia_kgm2, half_axis_m, radius_m, draught_m, middle_m (below the surface), swim_mps: (B,). phases_rad (B, 2).
    """

    masses_kg: Array
    drag_kgpm: Array
    inertia_kgm2: Array
    half_axis_m: Array
    radius_m: Array
    draught_m: Array
    middle_m: Array
    swim_mps: Array
    phases_rad: Array

    @classmethod
    def of(cls, bodies: tuple[Body, ...]) -> Figures:
        def column(name: str) -> Array:
            return np.array([getattr(body, name) for body in bodies], dtype=float64)

        mass, draught, width = column("mass_kg"), column("draught_m"), 2.0 * column("radius_m")
        length = 2.0 * column("half_axis_m") + width
        dynamic = 0.5 * WATER_KGPM3
        number = np.arange(len(bodies))
        return cls(
            masses_kg=np.outer(mass, (1.0 + ADDED_ALONG, 1.0 + ADDED_ACROSS)),
            drag_kgpm=dynamic * np.column_stack([DRAG_ALONG * width * draught, DRAG_ACROSS * length * draught]),
            inertia_kgm2=column("yaw_inertia_kgm2") * (1.0 + ADDED_ACROSS),
            half_axis_m=column("half_axis_m"),
            radius_m=column("radius_m"),
            draught_m=draught,
            middle_m=column("middle_below_surface_m"),
            swim_mps=column("swim_mps"),
            phases_rad=2.0 * math.pi * np.column_stack([number * _GOLDEN % 1.0, number * _GOLDEN**2 % 1.0]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """What B bodies are pushed with: force_ne_n (B, 2), moment_nm (B,) about down."""

    force_ne_n: Array
    moment_nm: Array


def no_debris(time_ns: int = 0) -> DebrisState:
    """Nothing adrift."""
    none = np.empty((0, 3))
    return DebrisState(time_ns, (), none, none, np.empty(0), np.empty(0), 0, Figures.of(()))


def launched(debris: DebrisState, launch: Launch, current_ned_mps: Array, surface_down_m: float) -> DebrisState:
    """With one body more, that drifts with the (3,) current already. Raises ValueError for an impossible length."""
    body = body_of(launch.kind, launch.length_m)
    bodies = (*debris.bodies, body)
    place = [launch.north_m, launch.east_m, surface_down_m + body.middle_below_surface_m]
    swimming = [body.swim_mps * math.cos(launch.heading_rad), body.swim_mps * math.sin(launch.heading_rad), 0.0]
    return replace(
        debris,
        bodies=bodies,
        pos_ned_m=np.concatenate([debris.pos_ned_m, [place]]),
        vel_ned_mps=np.concatenate([debris.vel_ned_mps, [current_ned_mps * (1.0, 1.0, 0.0) + swimming]]),
        yaw_rad=np.append(debris.yaw_rad, launch.heading_rad),
        yaw_rate_radps=np.append(debris.yaw_rate_radps, 0.0),
        figures=Figures.of(bodies),
    )


def drift(
    debris: DebrisState, dt_ns: int, current_ned_mps: Array, surface_down_m: Array, push: Push | None = None
) -> DebrisState:
    """One step later, in a current (B, 3), or (1, 3) for all, under a surface at (B,): semi-implicit Euler.

    The drag is taken implicitly in its speed, u' = w |w| / (1 + |w| dt / l), so that a light body in a long step comes
    to the current and not past it.
    """
    figures, dt_s = debris.figures, dt_ns * 1e-9
    ahead = np.column_stack([np.cos(debris.yaw_rad), np.sin(debris.yaw_rad)])
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    slip = current_ned_mps[:, :2] + figures.swim_mps[:, None] * ahead - debris.vel_ned_mps[:, :2]
    slip_body = np.column_stack([np.vecdot(slip, ahead), np.vecdot(slip, aside)])
    gain = np.abs(slip_body) * figures.drag_kgpm / figures.masses_kg
    acceleration = slip_body * gain / (1.0 + gain * dt_s)
    spin = (_eddies(debris, figures) - debris.yaw_rate_radps) / TURN_S
    if push is not None:
        pushed = np.column_stack([np.vecdot(push.force_ne_n, ahead), np.vecdot(push.force_ne_n, aside)])
        acceleration += pushed / figures.masses_kg
        spin = spin + push.moment_nm / figures.inertia_kgm2
    vel_ned_mps = debris.vel_ned_mps.copy()
    vel_ned_mps[:, :2] += dt_s * (acceleration[:, :1] * ahead + acceleration[:, 1:] * aside)
    yaw_rate = debris.yaw_rate_radps + dt_s * spin
    pos_ned_m = debris.pos_ned_m + dt_s * vel_ned_mps
    down_m = surface_down_m + figures.middle_m
    vel_ned_mps[:, 2] = (down_m - debris.pos_ned_m[:, 2]) / dt_s
    pos_ned_m[:, 2] = down_m
    return replace(
        debris,
        time_ns=debris.time_ns + dt_ns,
        pos_ned_m=pos_ned_m,
        vel_ned_mps=vel_ned_mps,
        yaw_rad=debris.yaw_rad + dt_s * yaw_rate,
        yaw_rate_radps=yaw_rate,
    )


def pushed_at(debris: DebrisState, body: NDArray[np.intp], place_ne_m: Array, force_ne_n: Array) -> Push:
    """K forces (K, 2) at places (K, 2) on bodies (K,), summed by body."""
    lever = place_ne_m - debris.pos_ned_m[body, :2]
    force, moment = np.zeros((len(debris.bodies), 2)), np.zeros(len(debris.bodies))
    np.add.at(force, body, force_ne_n)
    np.add.at(moment, body, lever[:, 0] * force_ne_n[:, 1] - lever[:, 1] * force_ne_n[:, 0])
    return Push(force, moment)


def bodies_at(debris: DebrisState, time_ns: int) -> Bodies:
    """For ray casting: moved on by their velocities from the latest step of theirs to time_ns."""
    if not debris.bodies:
        return NO_BODIES
    late_s = (time_ns - debris.time_ns) * 1e-9
    yaw_rad = debris.yaw_rad + late_s * debris.yaw_rate_radps
    rotation = np.zeros((len(yaw_rad), 3, 3))
    rotation[:, 0, 0] = rotation[:, 1, 1] = np.cos(yaw_rad)
    rotation[:, 1, 0] = np.sin(yaw_rad)
    rotation[:, 0, 1] = -rotation[:, 1, 0]
    rotation[:, 2, 2] = 1.0
    meshes = tuple(body.mesh for body in debris.bodies)
    return Bodies(meshes, debris.pos_ned_m + late_s * debris.vel_ned_mps, debris.vel_ned_mps, rotation)


def _eddies(debris: DebrisState, figures: Figures) -> Array:
    """(B,) how fast the water around each body turns."""
    turns = debris.time_ns * 1e-9 * 2.0 * math.pi / np.array(EDDY_PERIODS_S)
    turning: Array = np.sin(figures.phases_rad + turns) @ np.array(EDDY_RADPS)
    return turning
