"""Closed triangle meshes of simple solids, in their own axes about their middle, and how to move and join meshes.

Long ones lie along x. Faces are counter-clockwise from outside: (b - a) x (c - a) points out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy import float64, int32
from numpy.typing import ArrayLike, NDArray

from sim_core.world.materials import Material
from sim_core.world.mesh import Mesh

Array = NDArray[float64]

_BOX_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=int32,
)  # fmt: skip


def box(size_m: tuple[float, float, float], material: Material) -> Mesh:
    """Of size_m along x, y and z."""
    return Mesh(_BOX_CORNERS * np.asarray(size_m), _BOX_FACES, material)


def cylinder(radius_m: float, length_m: float, material: Material, sides: int = 16) -> Mesh:
    """Its axis along x. Flat sides lie inside the true cylinder by up to radius (1 - cos(pi / sides))."""
    half = length_m / 2
    return revolved((-half, -half, half, half), (0.0, radius_m, radius_m, 0.0), material, sides)


def cone(radius_m: float, length_m: float, material: Material, sides: int = 10) -> Mesh:
    """Its base at x = -length / 2, its tip at x = length / 2."""
    half = length_m / 2
    return revolved((-half, -half, half), (0.0, radius_m, 0.0), material, sides)


def capsule(radius_m: float, length_m: float, material: Material, sides: int = 16, rings: int = 4) -> Mesh:
    """A cylinder with hemispheres, along x, length_m over all; rings: in each hemisphere."""
    turn = np.linspace(0.0, math.pi / 2, rings + 1)
    ahead = length_m / 2 - radius_m + radius_m * np.cos(turn[::-1])
    radius = radius_m * np.sin(turn[::-1])
    radius[-1] = 0.0
    return revolved((*-ahead[::-1], *ahead), (*radius[::-1], *radius), material, sides)


def sphere(radius_m: float, material: Material, sides: int = 16, rings: int = 8) -> Mesh:
    """The corners lie on the sphere."""
    return ellipsoid((radius_m, radius_m, radius_m), material, sides, rings)


def ellipsoid(radii_m: tuple[float, float, float], material: Material, sides: int = 16, rings: int = 8) -> Mesh:
    """Of radii_m along x, y and z; rings: from pole to pole along x."""
    turn = np.linspace(0.0, math.pi, rings + 1)
    radius = np.sin(turn)
    radius[[0, -1]] = 0.0
    unit = revolved(-np.cos(turn), radius, material, sides)
    return Mesh(unit.vertices_m * np.asarray(radii_m), unit.faces, material)


def revolved(x_m: ArrayLike, radius_m: ArrayLike, material: Material, sides: int = 16) -> Mesh:
    """What an outline x_m (K,), growing, radius_m (K,), 0 at both ends alone, sweeps as it turns about x."""
    ahead, radius = np.asarray(x_m, dtype=float64), np.asarray(radius_m, dtype=float64)
    turn = 2 * math.pi * np.arange(sides) / sides
    round_m = np.stack([np.zeros(sides), np.cos(turn), np.sin(turn)], axis=-1)
    rings = radius[1:-1, None, None] * round_m + ahead[1:-1, None, None] * np.array([1.0, 0.0, 0.0])
    count = len(rings) * sides
    vertices = np.concatenate([rings.reshape(-1, 3), [[ahead[0], 0.0, 0.0], [ahead[-1], 0.0, 0.0]]])
    here = np.arange(sides)
    following = (here + 1) % sides
    first = np.stack([np.full(sides, count), following, here], axis=-1)
    end = count - sides
    last = np.stack([np.full(sides, count + 1), end + here, end + following], axis=-1)
    faces = [first, last]
    for low in range(0, end, sides):
        high = low + sides
        faces.append(np.stack([low + here, low + following, high + here], axis=-1))
        faces.append(np.stack([low + following, high + following, high + here], axis=-1))
    return Mesh(vertices, np.concatenate(faces).astype(int32), material)


def moved(mesh: Mesh, offset_m: ArrayLike, rotation: ArrayLike | None = None) -> Mesh:
    """The mesh turned by `rotation` (3, 3), own axes to new ones, then shifted by `offset_m` (3,)."""
    vertices = mesh.vertices_m if rotation is None else mesh.vertices_m @ np.asarray(rotation, dtype=float64).T
    return Mesh(vertices + np.asarray(offset_m, dtype=float64), mesh.faces, mesh.material)


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """All of them as one, of the first one's material."""
    first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, first[:-1].tolist(), strict=True)]
    vertices = np.concatenate([mesh.vertices_m for mesh in meshes])
    return Mesh(vertices, np.concatenate(faces).astype(int32), meshes[0].material)


def heading_matrix(heading_rad: float) -> Array:
    """(3, 3) forward, right, down to NED for a body that is level."""
    cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


UPRIGHT = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Turns what lies along x upright, its +x end up."""
