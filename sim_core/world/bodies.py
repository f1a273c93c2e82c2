"""What drifts: trunks, branches, rafts of plants and animals, by kind and length.

    body_of(BodyKind.TRUNK, length_m=None) -> Body

Proportions are those of the usual size scaled by the length. Axes of a body: forward along its length, right, down,
about its middle; how deep the middle lies follows from mass and mesh (see afloat.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import numpy as np

from sim_core.world.afloat import volume_below_m3, waterline_m
from sim_core.world.materials import HIDE, LEAVES, WOOD, Material
from sim_core.world.mesh import Mesh
from sim_core.world.shapes import cylinder, ellipsoid, merged, moved

WATER_KGPM3 = 997.8
Point = tuple[float, float, float]


class BodyKind(IntEnum):
    """Numbered as XITL_BODY_KIND."""

    TRUNK = 0
    BRANCH = 1
    PLANTS = 2
    ANIMAL = 3


USUAL_LENGTH_M = {BodyKind.TRUNK: 5.0, BodyKind.BRANCH: 3.0, BodyKind.PLANTS: 2.5, BodyKind.ANIMAL: 1.2}

# Of the volume, with what is wet and what is air in it. A drifting trunk lies 60 to 90 % under; a raft of water
# hyacinth is mostly air; a capybara swims with back and head out.
_DENSITY_KGPM3 = {BodyKind.TRUNK: 750.0, BodyKind.BRANCH: 800.0, BodyKind.PLANTS: 340.0, BodyKind.ANIMAL: 640.0}
_SWIM_MPS = {BodyKind.ANIMAL: 0.25}
_MATERIAL: dict[BodyKind, Material] = {
    BodyKind.TRUNK: WOOD,
    BodyKind.BRANCH: WOOD,
    BodyKind.PLANTS: LEAVES,
    BodyKind.ANIMAL: HIDE,
}


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """One thing afloat.

    middle_below_surface_m: depth of the middle at rest; draught_m, height_m: how far it reaches below and above the
    surface. In plan it is a capsule: all points within radius_m of an axis of +-half_axis_m along forward.
    """

    kind: BodyKind
    length_m: float
    mesh: Mesh
    mass_kg: float
    yaw_inertia_kgm2: float
    middle_below_surface_m: float
    draught_m: float
    height_m: float
    half_axis_m: float
    radius_m: float
    swim_mps: float


@lru_cache(maxsize=256)
def body_of(kind: BodyKind, length_m: float | None = None) -> Body:
    """A body of a kind, of the usual length unless given. The same arguments give the same object and mesh.

    Raises ValueError for a length that is no length.
    """
    length = USUAL_LENGTH_M[kind] if length_m is None else length_m
    if not (math.isfinite(length) and 0.1 <= length <= 50.0):
        raise ValueError(f"a {kind.name.lower()} of {length} m; give a length from 0.1 to 50 m")
    scale = length / USUAL_LENGTH_M[kind]
    mesh, half_axis_m, radius_m = _SHAPES[kind](scale, _MATERIAL[kind])
    low = float(mesh.vertices_m[:, 2].min())
    mass_kg = _DENSITY_KGPM3[kind] * volume_below_m3(mesh, low)
    waterline = waterline_m(mesh, mass_kg / WATER_KGPM3)
    width_m = 2.0 * radius_m
    return Body(
        kind=kind,
        length_m=length,
        mesh=mesh,
        mass_kg=mass_kg,
        yaw_inertia_kgm2=mass_kg * (length**2 + width_m**2) / 12.0,
        middle_below_surface_m=-waterline,
        draught_m=float(mesh.vertices_m[:, 2].max()) - waterline,
        height_m=waterline - low,
        half_axis_m=half_axis_m,
        radius_m=radius_m,
        swim_mps=_SWIM_MPS.get(kind, 0.0),
    )


def _trunk(scale: float, material: Material) -> tuple[Mesh, float, float]:
    radius = 0.25 * scale
    return cylinder(radius, 5.0 * scale, material, sides=20), 2.5 * scale - radius, radius


def _branch(scale: float, material: Material) -> tuple[Mesh, float, float]:
    """A limb under the water and twigs that stand up out of it."""
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
}
