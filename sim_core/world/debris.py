"""Floating bodies: trunks, branches, rafts of plants, animals, planks, plastic and buoys; their draft and motion.

    make_body(BodyKind.TRUNK, length_m=None) -> Body
    debris = launched(no_debris(), Launch(...), current_ned_mps, surface_down_m, water_kgpm3)
    debris = drift(debris, dt_ns, current_ned_mps, surface_down_m, push)

A body has the proportions of the usual size, scaled by its length. Its axes are forward along its length, right and
down, about its middle. Mass and mesh give the depth of the middle. The volume below a level plane follows from the
divergence theorem with the field (0, 0, max(z - level, 0)). It is the sum over the triangles of their signed area seen
from above times the mean of max(z - level, 0) over each. No triangle is cut.

Horizontally a body follows m (1 + C_a) u' = F + 1/2 rho C_d A |w| w (Morison et al. 1950, with its drag and added
mass). w is the velocity of the water, plus the swimming velocity, relative to the body. A is the wetted area across or
along the flow. Eddies turn the body slowly back and forth, and it floats on the waves' surface.

Wind adds the leeway of a body whose drag in air and water balance, (rho_a A_a / (rho_w A_w))^0.5 of the wind
(Richardson 1997, "Drifting in the wind: leeway error in shipdrift data"). A_a and A_w are the projected areas above and
below the water. A mooring is a line that becomes taut at a distance from its anchor.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import IntEnum
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.frames import Array
from sim_core.world.geometry import (
    HIDE,
    LEAVES,
    PLASTIC,
    STEEL,
    UPRIGHT,
    WOOD,
    Material,
    Mesh,
    box,
    cylinder,
    ellipsoid,
    merged,
    moved,
    revolved,
)
from sim_core.world.plan import Capsules, Numbers
from sim_core.world.rays import NO_BODIES, Bodies
from sim_core.world.spec import BuoyColour, BuoyShape


def volume_below_m3(mesh: Mesh, level_m: float) -> float:
    """Return the volume below `level_m` (z, down, greater than), in the mesh's axes."""
    corner = mesh.vertices_m[mesh.faces]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    seen_m2 = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    return float(seen_m2 @ _mean_depth_m(corner[:, :, 2] - level_m))


def waterline_m(mesh: Mesh, volume_m3: float) -> float:
    """Return the down coordinate of the water surface in the mesh's axes at a displacement of `volume_m3`.

    Raises ValueError if the mesh has less volume: it would sink.
    """
    top, bottom = float(mesh.vertices_m[:, 2].min()), float(mesh.vertices_m[:, 2].max())
    if not 0.0 < volume_m3 < volume_below_m3(mesh, top):
        raise ValueError(f"a body that displaces {volume_m3:.3g} m3 afloat has {volume_below_m3(mesh, top):.3g} m3")
    for _ in range(60):  # bisection to rounding
        middle = 0.5 * (top + bottom)
        if volume_below_m3(mesh, middle) > volume_m3:
            top = middle
        else:
            bottom = middle
    return 0.5 * (top + bottom)


def _mean_depth_m(depth_m: Array) -> Array:
    """Return the (F,) mean over triangles of the positive part of a linear depth, from the corners' (F, 3).

    Corners are a <= b <= c. If only a < 0, the cut-off part is a pyramid of height -a on the share a^2 / ((b - a) (c -
    a)) of the area. The case of only c > 0 is similar.
    """
    a, b, c = np.sort(depth_m, axis=1).T
    mean = np.where(a >= 0.0, (a + b + c) / 3.0, 0.0)
    one_dry = (a < 0.0) & (b >= 0.0) & (c > 0.0)
    one_wet = (b < 0.0) & (c > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(one_dry, (a + b + c) / 3.0 - a**3 / (3.0 * (b - a) * (c - a)), mean)
        wet: Array = np.where(one_wet, c**3 / (3.0 * (c - a) * (c - b)), mean)
    return wet


USUAL_WATER_KGPM3 = Water().density_kgpm3
Point = tuple[float, float, float]


class BodyKind(IntEnum):
    """Kinds, numbered like XITL_BODY_KIND."""

    TRUNK = 0
    BRANCH = 1
    PLANTS = 2
    ANIMAL = 3
    PLANK = 4
    PLASTIC = 5
    BUOY = 6


USUAL_LENGTH_M = {
    BodyKind.TRUNK: 5.0,
    BodyKind.BRANCH: 3.0,
    BodyKind.PLANTS: 2.5,
    BodyKind.ANIMAL: 1.2,
    BodyKind.PLANK: 2.4,
    BodyKind.PLASTIC: 0.9,
    BodyKind.BUOY: 0.8,
}
"""Of a buoy, the diameter."""

# Densities of the whole volume, with its water and air. A drifting trunk lies 60 to 90 % under water. A raft of water
# hyacinth is mostly air. A capybara swims with back and head above water. Plastic is an empty drum.
_DENSITY_KGPM3 = {
    BodyKind.TRUNK: 750.0,
    BodyKind.BRANCH: 800.0,
    BodyKind.PLANTS: 340.0,
    BodyKind.ANIMAL: 640.0,
    BodyKind.PLANK: 600.0,
    BodyKind.PLASTIC: 120.0,
    BodyKind.BUOY: 400.0,
}
_SWIM_MPS = {BodyKind.ANIMAL: 0.25}
_MATERIAL: dict[BodyKind, Material] = {
    BodyKind.TRUNK: WOOD,
    BodyKind.BRANCH: WOOD,
    BodyKind.PLANTS: LEAVES,
    BodyKind.ANIMAL: HIDE,
    BodyKind.PLANK: WOOD,
    BodyKind.PLASTIC: PLASTIC,
    BodyKind.BUOY: STEEL,
}


@dataclass(frozen=True, slots=True)
class BuoyForm:
    """Shape and equipment of a buoy."""

    shape: BuoyShape = "can"
    colour: BuoyColour = "red"
    reflector_m2: float = 0.0
    """Radar cross section of its reflector."""


@dataclass(frozen=True, slots=True)
class Mooring:
    """A line from an anchor. It is taut at swing_m from the anchor, in plan."""

    north_m: float
    east_m: float
    swing_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """One floating body. In plan it is a capsule."""

    kind: BodyKind
    length_m: float
    mesh: Mesh
    mass_kg: float
    yaw_inertia_kgm2: float
    middle_below_surface_m: float
    """Depth of the middle at rest."""
    draught_m: float
    """Extent below the surface."""
    height_m: float
    """Extent above the surface."""
    half_axis_m: float
    """Half length of the capsule's axis along forward."""
    radius_m: float
    """Radius of the capsule."""
    drag_kgpm: tuple[float, float]
    """1/2 rho C_d A along and across."""
    swim_mps: float
    windage: float
    """Leeway, as a share of the wind."""
    buoy: BuoyForm | None = None
    mooring: Mooring | None = None
    """None: it drifts."""


def make_body(
    kind: BodyKind,
    length_m: float | None = None,
    water_kgpm3: float = USUAL_WATER_KGPM3,
    buoy: BuoyForm | None = None,
) -> Body:
    """Return a body of a kind, of the usual length unless given, afloat in water of a density. buoy: for a BUOY.

    The same arguments give the same object and mesh.

    Raises ValueError for an invalid length.
    """
    return _make_body(kind, length_m, water_kgpm3, buoy)


@lru_cache(maxsize=256)
def _make_body(kind: BodyKind, length_m: float | None, water_kgpm3: float, buoy: BuoyForm | None) -> Body:
    length = USUAL_LENGTH_M[kind] if length_m is None else length_m
    if not (math.isfinite(length) and 0.1 <= length <= 50.0):
        raise ValueError(f"a {kind.name.lower()} of {length} m; give a length from 0.1 to 50 m")
    scale = length / USUAL_LENGTH_M[kind]
    if kind is BodyKind.BUOY:
        buoy = buoy or BuoyForm()
        mesh, half_axis_m, radius_m = _buoy(length, buoy.shape)
    else:
        mesh, half_axis_m, radius_m = _SHAPES[kind](scale, _MATERIAL[kind])
    low = float(mesh.vertices_m[:, 2].min())
    mass_kg = _DENSITY_KGPM3[kind] * volume_below_m3(mesh, low)
    waterline = waterline_m(mesh, mass_kg / water_kgpm3)
    draught_m = float(mesh.vertices_m[:, 2].max()) - waterline
    width_m = 2.0 * radius_m
    across_m2 = DRAG_ACROSS * (2.0 * half_axis_m + width_m) * draught_m
    drag_m2 = across_m2 if buoy is not None else DRAG_ALONG * width_m * draught_m, across_m2  # a buoy is round
    return Body(
        kind=kind,
        length_m=length,
        mesh=mesh,
        mass_kg=mass_kg,
        yaw_inertia_kgm2=mass_kg * (length**2 + width_m**2) / 12.0,
        middle_below_surface_m=-waterline,
        draught_m=draught_m,
        height_m=waterline - low,
        half_axis_m=half_axis_m,
        radius_m=radius_m,
        drag_kgpm=(0.5 * water_kgpm3 * drag_m2[0], 0.5 * water_kgpm3 * drag_m2[1]),
        swim_mps=_SWIM_MPS.get(kind, 0.0),
        windage=_leeway(mesh, waterline, water_kgpm3),
        buoy=buoy,
    )


AIR_KGPM3 = 1.225


def _leeway(mesh: Mesh, waterline_m: float, water_kgpm3: float) -> float:
    """Return the balance of drag in air and water, from the areas of the sides that face right."""
    corner = mesh.vertices_m[mesh.faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    aside_m2 = 0.25 * np.abs(across[:, 1])  # a closed surface shows each side once
    a, b, c = np.sort(corner[:, :, 2], axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        one_dry = (waterline_m - a) ** 2 / ((b - a) * (c - a))
        one_wet = 1.0 - (c - waterline_m) ** 2 / ((c - a) * (c - b))
    above = np.where(
        waterline_m <= a, 0.0, np.where(waterline_m >= c, 1.0, np.where(waterline_m <= b, one_dry, one_wet))
    )
    dry_m2, all_m2 = float(aside_m2 @ above), float(aside_m2.sum())
    return math.sqrt(AIR_KGPM3 * dry_m2 / (water_kgpm3 * max(all_m2 - dry_m2, 1e-9)))


def _trunk(scale: float, material: Material) -> tuple[Mesh, float, float]:
    radius = 0.25 * scale
    return cylinder(radius, 5.0 * scale, material, sides=20), 2.5 * scale - radius, radius


def _branch(scale: float, material: Material) -> tuple[Mesh, float, float]:
    """A limb under the water and twigs that reach out of it."""
    feet = (-1.1, -0.7, -0.3, 0.0, 0.3, 0.65, 1.0, 1.3)
    heights = (0.35, 0.45, 0.55, 0.6, 0.5, 0.55, 0.4, 0.3)
    sides = (0.25, -0.25, 0.08, -0.15, 0.25, -0.2, 0.13, -0.1)
    twigs = [
        _twig((foot, 0.0, 0.0), (foot + 0.15, side, -height), 0.02, material)
        for foot, height, side in zip(feet, heights, sides, strict=True)
    ]
    limb = cylinder(0.09, 3.0, material, sides=12)
    return _scaled(merged([limb, *twigs]), scale), 1.3 * scale, 0.2 * scale


def _plants(scale: float, material: Material) -> tuple[Mesh, float, float]:
    radii = (1.25 * scale, 1.05 * scale, 0.25 * scale)
    return ellipsoid(radii, material, sides=24, rings=10), 0.2 * scale, 1.05 * scale


def _animal(scale: float, material: Material) -> tuple[Mesh, float, float]:
    back = moved(ellipsoid((0.45, 0.2, 0.27), material), (-0.15, 0.0, 0.0))
    head = moved(ellipsoid((0.2, 0.1, 0.12), material, sides=12), (0.4, 0.0, -0.18))
    return _scaled(merged([back, head]), scale), 0.4 * scale, 0.2 * scale


def _plank(scale: float, material: Material) -> tuple[Mesh, float, float]:
    return box((2.4 * scale, 0.22 * scale, 0.06 * scale), material), 1.09 * scale, 0.11 * scale


def _drum(scale: float, material: Material) -> tuple[Mesh, float, float]:
    return cylinder(0.29 * scale, 0.9 * scale, material, sides=20), 0.18 * scale, 0.29 * scale


_BUOY_OUTLINES: dict[BuoyShape, tuple[tuple[float, float], ...]] = {
    "can": ((0.0, 0.0), (0.0, 0.5), (1.3, 0.5), (1.3, 0.0)),
    "cone": ((0.0, 0.0), (0.0, 0.5), (0.7, 0.5), (1.6, 0.0)),
    "sphere": tuple((0.5 - 0.5 * math.cos(a), 0.5 * math.sin(a)) for a in np.linspace(0.0, math.pi, 13).tolist()),
    "pillar": ((0.0, 0.0), (0.0, 0.5), (0.6, 0.5), (0.7, 0.18), (2.6, 0.18), (2.6, 0.0)),
    "spar": ((0.0, 0.0), (0.0, 0.5), (8.0, 0.5), (8.0, 0.0)),
}
"""Height above the bottom and radius, for a diameter of 1."""
_BUOY_RINGS = 24


def _buoy(diameter_m: float, shape: BuoyShape) -> tuple[Mesh, float, float]:
    """A surface of revolution, with rings at which its colour may change."""
    outline = diameter_m * np.array(_BUOY_OUTLINES[shape])
    outline[[0, -1], 1] = 0.0
    step_m = outline[-1, 0] / _BUOY_RINGS
    points = [outline[:1]]
    for low, high in pairwise(outline):
        parts = max(math.ceil((high[0] - low[0]) / step_m - 1e-9), 1)
        points.append(low + np.linspace(0.0, 1.0, parts + 1)[1:, None] * (high - low))
    height_m, radius_m = np.concatenate(points).T
    upright = moved(revolved(height_m, radius_m, _MATERIAL[BodyKind.BUOY], sides=20), (0.0, 0.0, 0.0), UPRIGHT)
    return upright, 0.01 * diameter_m, 0.49 * diameter_m


def _twig(foot_m: Point, tip_m: Point, radius_m: float, material: Material) -> Mesh:
    """A thin cylinder from foot to tip."""
    foot, tip = np.array(foot_m), np.array(tip_m)
    length = float(np.linalg.norm(tip - foot))
    along = (tip - foot) / length
    right = np.cross(along, (1.0, 0.0, 0.0))
    right /= np.linalg.norm(right)
    axes = np.column_stack([along, right, np.cross(along, right)])
    return moved(cylinder(radius_m, length, material, sides=5), 0.5 * (foot + tip), axes)


def _scaled(mesh: Mesh, scale: float) -> Mesh:
    return Mesh(np.ascontiguousarray(mesh.vertices_m * scale), mesh.faces, mesh.material)


_SHAPES = {
    BodyKind.TRUNK: _trunk,
    BodyKind.BRANCH: _branch,
    BodyKind.PLANTS: _plants,
    BodyKind.ANIMAL: _animal,
    BodyKind.PLANK: _plank,
    BodyKind.PLASTIC: _drum,
}


ADDED_ACROSS, ADDED_ALONG = 1.0, 0.1  # of the body's mass: a cylinder half in the water, and a slender body end on
DRAG_ACROSS, DRAG_ALONG = 1.1, 0.8  # of a cylinder across the flow and of its blunt end (Hoerner 1965)
TURN_S = 4.0  # time constant of a body that follows the rotation of the water
EDDY_RADPS = (0.017, 0.011)  # amplitudes of that rotation
EDDY_PERIODS_S = (23.0, 57.0)
_GOLDEN = 0.6180339887498949  # gives each body's eddies different phases without a random draw


@dataclass(frozen=True, slots=True)
class Launch:
    """One body to put into the water."""

    at_ns: int
    kind: BodyKind
    north_m: float
    east_m: float
    heading_rad: float = 0.0
    length_m: float | None = None
    """None for the usual length of the kind. Of a buoy, the diameter."""
    windage: float | None = None
    """Leeway as a share of the wind; None for that of the shape."""
    buoy: BuoyForm | None = None
    swing_m: float | None = None
    """Moored at its place by a line that is taut at this distance; None: it drifts."""


@dataclass(frozen=True, slots=True, eq=False)
class DebrisState:
    """B bodies at time_ns, in the order of their launch. The number of a body is its index."""

    time_ns: int
    bodies: tuple[Body, ...]
    pos_ned_m: Array
    """Positions of the middles, (B, 3)."""
    vel_ned_mps: Array
    """Velocities, (B, 3)."""
    yaw_rad: Array
    """Headings, (B,)."""
    yaw_rate_radps: Array
    """Yaw rates, (B,)."""
    scheduled: int
    """Number of the waterway's launches already in the water."""
    figures: Figures


_ADRIFT = Mooring(0.0, 0.0, math.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Figures:
    """Constants of B bodies as arrays."""

    masses_kg: Array
    """Masses along and across, added mass included, (B, 2)."""
    drag_kgpm: Array
    """Value of `Body`, (B, 2)."""
    inertia_kgm2: Array
    """Yaw inertia, (B,)."""
    half_axis_m: Array
    """Value of `Body`, (B,)."""
    radius_m: Array
    """Value of `Body`, (B,)."""
    draught_m: Array
    """Value of `Body`, (B,)."""
    middle_m: Array
    """Depth of the middle below the surface, (B,)."""
    swim_mps: Array
    """Swimming speeds, (B,)."""
    phases_rad: Array
    """Phases of the eddies, (B, 2)."""
    windage: Array
    """Value of `Body`, (B,)."""
    anchor_ne_m: Array
    """Anchors, (B, 2), and 0 for bodies that drift."""
    swing_m: Array
    """Value of `Mooring`, (B,), and inf for bodies that drift."""

    @classmethod
    def from_bodies(cls, bodies: tuple[Body, ...]) -> Figures:
        def column(name: str) -> Array:
            return np.array([getattr(body, name) for body in bodies], dtype=float64)

        number = np.arange(len(bodies))
        moorings = [body.mooring or _ADRIFT for body in bodies]
        return cls(
            masses_kg=np.outer(column("mass_kg"), (1.0 + ADDED_ALONG, 1.0 + ADDED_ACROSS)),
            drag_kgpm=column("drag_kgpm").reshape(-1, 2),
            inertia_kgm2=column("yaw_inertia_kgm2") * (1.0 + ADDED_ACROSS),
            half_axis_m=column("half_axis_m"),
            radius_m=column("radius_m"),
            draught_m=column("draught_m"),
            middle_m=column("middle_below_surface_m"),
            swim_mps=column("swim_mps"),
            phases_rad=2.0 * math.pi * np.column_stack([number * _GOLDEN % 1.0, number * _GOLDEN**2 % 1.0]),
            windage=column("windage"),
            anchor_ne_m=np.array([[line.north_m, line.east_m] for line in moorings]).reshape(-1, 2),
            swing_m=np.array([line.swing_m for line in moorings]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """Force and moment on B bodies."""

    force_ne_n: Array
    """Horizontal force, (B, 2)."""
    moment_nm: Array
    """Moment about down, (B,)."""


def no_debris() -> DebrisState:
    """Return a state without bodies."""
    none = np.empty((0, 3))
    return DebrisState(0, (), none, none, np.empty(0), np.empty(0), 0, Figures.from_bodies(()))


def launched(
    debris: DebrisState,
    launch: Launch,
    current_ned_mps: Array,
    surface_down_m: float,
    water_kgpm3: float = USUAL_WATER_KGPM3,
) -> DebrisState:
    """Add one body that drifts with the (3,) current, or is moored. Raises ValueError for an impossible length."""
    body = make_body(launch.kind, launch.length_m, water_kgpm3, launch.buoy)
    if launch.windage is not None:
        body = replace(body, windage=launch.windage)
    if launch.swing_m is not None:
        body = replace(body, mooring=Mooring(launch.north_m, launch.east_m, launch.swing_m))
        current_ned_mps = np.zeros(3)
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
        figures=Figures.from_bodies(bodies),
    )


def drift(
    debris: DebrisState, dt_ns: int, current_ned_mps: Array, surface_down_m: Array, push: Push | None = None
) -> DebrisState:
    """Advance one step under a surface at (B,), in a current (B, 3), or (1, 3) for all. The method is semi-implicit
    Euler.

    The drag is implicit in the speed, u' = w |w| / (1 + |w| dt / l). A light body in a long step therefore approaches
    the current without overshoot.
    """
    # Drag along and across the body
    figures, dt_s = debris.figures, dt_ns * 1e-9
    ahead = np.column_stack([np.cos(debris.yaw_rad), np.sin(debris.yaw_rad)])
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    slip = current_ned_mps[:, :2] + figures.swim_mps[:, None] * ahead - debris.vel_ned_mps[:, :2]
    slip_body = np.column_stack([np.vecdot(slip, ahead), np.vecdot(slip, aside)])
    gain = np.abs(slip_body) * figures.drag_kgpm / figures.masses_kg
    acceleration = slip_body * gain / (1.0 + gain * dt_s)
    # Rotation with the eddies around the body
    eddy_rad = figures.phases_rad + debris.time_ns * 1e-9 * 2.0 * math.pi / np.array(EDDY_PERIODS_S)
    spin = (np.sin(eddy_rad) @ np.array(EDDY_RADPS) - debris.yaw_rate_radps) / TURN_S
    # Push of contacts
    if push is not None:
        pushed = np.column_stack([np.vecdot(push.force_ne_n, ahead), np.vecdot(push.force_ne_n, aside)])
        acceleration += pushed / figures.masses_kg
        spin = spin + push.moment_nm / figures.inertia_kgm2
    # Velocity, then position; the height follows the surface
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
    """Sum K forces (K, 2) at places (K, 2) on bodies (K,) by body."""
    lever = place_ne_m - debris.pos_ned_m[body, :2]
    force, moment = np.zeros((len(debris.bodies), 2)), np.zeros(len(debris.bodies))
    np.add.at(force, body, force_ne_n)
    np.add.at(moment, body, lever[:, 0] * force_ne_n[:, 1] - lever[:, 1] * force_ne_n[:, 0])
    return Push(force, moment)


def bodies_at(debris: DebrisState, time_ns: int) -> Bodies:
    """Return the bodies for ray casting, moved by their velocities from their latest step to time_ns."""
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


def capsules_of(debris: DebrisState) -> Capsules:
    """Return the bodies in plan."""
    axis = np.column_stack([np.cos(debris.yaw_rad), np.sin(debris.yaw_rad)]) * debris.figures.half_axis_m[:, None]
    place = debris.pos_ned_m[:, :2]
    return Capsules(place - axis, place + axis, debris.figures.radius_m, ("",) * len(place))


def body_velocity(debris: DebrisState, body: Numbers, place_ne_m: Array) -> Array:
    """Return the (K, 2) velocity of points of the bodies at places."""
    lever = place_ne_m - debris.pos_ned_m[body, :2]
    turning = debris.yaw_rate_radps[body, None] * np.column_stack([-lever[:, 1], lever[:, 0]])
    velocity: Array = debris.vel_ned_mps[body, :2] + turning
    return velocity
