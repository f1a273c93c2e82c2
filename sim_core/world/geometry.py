"""Materials, triangle meshes of simple shapes and of files, and solids in closed form.

A mesh is closed, in its own axes about its middle; long shapes lie along x. Faces are counter-clockwise from outside:
(b - a) x (c - a) points out.

A solid, in NED, has `meet(origin_m, direction) -> (range_m (R,), normal (R, 3))` for rays (R, 3) with unit directions
in double precision; inf and 0 for no hit. A ray that starts inside hits the far side. Equations: Akenine-Moeller,
Haines and Hoffman, Real-Time Rendering, 4th edition, 22.6 to 22.8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy import float64, int32
from numpy.typing import ArrayLike, NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array, enu_to_ned
from sim_core.mesh_file import MeshFileError, modified_ns, read_triangles
from sim_core.world.spec import MeshFileSpec


@dataclass(frozen=True, slots=True)
class Material:
    """Optical and acoustic properties of a surface."""

    name: str
    reflectivity: float
    """Diffuse reflectivity for light of 905 nm, 0 to 1."""
    backscatter: float
    """Backscatter of sound relative to a rigid wall, 0 to 1."""


CONCRETE = Material("concrete", 0.35, 0.8)
STEEL = Material("steel", 0.45, 1.0)
PLASTIC = Material("plastic", 0.5, 0.4)
WOOD = Material("wood", 0.3, 0.3)
LEAVES = Material("leaves", 0.5, 0.08)
HIDE = Material("hide", 0.25, 0.2)
EARTH = Material("earth", 0.25, 0.25)
ROCK = Material("rock", 0.3, 0.6)
WALL = Material("wall", 0.6, 0.8)
BED = Material("bed", 0.1, 0.15)

MATERIALS = (CONCRETE, STEEL, PLASTIC, WOOD, LEAVES, HIDE, EARTH, ROCK, WALL, BED)
"""Materials by number, as in `Hits.material`."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles of one material.

    The axes depend on the owner: NED for fixed structures; forward, right, down for a body.
    """

    vertices_m: NDArray[float64]
    """Vertices, (V, 3)."""
    faces: NDArray[int32]
    """Indices of vertices, (F, 3), counter-clockwise from outside."""
    material: Material


class WorldError(Exception):
    """A part of the world is not available. The text is one sentence with the problem and its fix."""


_BOX_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=int32,
)  # fmt: skip


def box(size_m: tuple[float, float, float], material: Material) -> Mesh:
    """Return a box of size_m along x, y and z."""
    return Mesh(_BOX_CORNERS * np.asarray(size_m), _BOX_FACES, material)


def cylinder(radius_m: float, length_m: float, material: Material, sides: int = 16) -> Mesh:
    """Return a cylinder along x. Flat sides lie inside the true cylinder by up to radius (1 - cos(pi / sides))."""
    unit = _unit_cylinder(material, sides)
    return Mesh(unit.vertices_m * np.array([length_m, radius_m, radius_m]), unit.faces, material)


@lru_cache(maxsize=16)  # the banks of a river have hundreds of trees and rocks of a few shapes
def _unit_cylinder(material: Material, sides: int) -> Mesh:
    return revolved((-0.5, -0.5, 0.5, 0.5), (0.0, 1.0, 1.0, 0.0), material, sides)


def sphere(radius_m: float, material: Material, sides: int = 16, rings: int = 8) -> Mesh:
    """Return a sphere with the corners on its surface."""
    return ellipsoid((radius_m, radius_m, radius_m), material, sides, rings)


def ellipsoid(radii_m: tuple[float, float, float], material: Material, sides: int = 16, rings: int = 8) -> Mesh:
    """Return an ellipsoid of radii_m along x, y and z; rings: from pole to pole along x."""
    unit = _unit_sphere(material, sides, rings)
    return Mesh(unit.vertices_m * np.asarray(radii_m), unit.faces, material)


@lru_cache(maxsize=16)
def _unit_sphere(material: Material, sides: int, rings: int) -> Mesh:
    turn = np.linspace(0.0, math.pi, rings + 1)
    radius = np.sin(turn)
    radius[[0, -1]] = 0.0
    return revolved(-np.cos(turn), radius, material, sides)


def revolved(x_m: ArrayLike, radius_m: ArrayLike, material: Material, sides: int = 16) -> Mesh:
    """Return the surface of revolution about x of an outline: x_m (K,), growing; radius_m (K,), 0 only at both ends."""
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


def prism(plan_m: ArrayLike, top_m: float, bottom_m: float, material: Material) -> Mesh:
    """Return the prism of a convex polygon of x and y (P, 2), clockwise from above, from top to bottom (z, down)."""
    plan = np.asarray(plan_m, dtype=float64)
    count = len(plan)
    here = np.arange(count)
    following = (here + 1) % count
    top, fan = here, np.column_stack([np.zeros(count - 2, int), here[1:-1], here[2:]])
    faces = [
        np.column_stack([top, count + following, count + here]),
        np.column_stack([top, following, count + following]),
        fan[:, ::-1],
        count + fan,
    ]
    levels = [np.column_stack([plan, np.full(count, level)]) for level in (top_m, bottom_m)]
    return Mesh(np.concatenate(levels), np.concatenate(faces).astype(int32), material)


def moved(mesh: Mesh, offset_m: ArrayLike, rotation: ArrayLike | None = None) -> Mesh:
    """Return the mesh rotated by `rotation` (3, 3), old axes to new ones, then shifted by `offset_m` (3,)."""
    vertices = mesh.vertices_m if rotation is None else mesh.vertices_m @ np.asarray(rotation, dtype=float64).T
    return Mesh(vertices + np.asarray(offset_m, dtype=float64), mesh.faces, mesh.material)


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """Merge meshes into one, with the material of the first."""
    first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, first[:-1].tolist(), strict=True)]
    vertices = np.concatenate([mesh.vertices_m for mesh in meshes])
    return Mesh(vertices, np.concatenate(faces).astype(int32), meshes[0].material)


def heading_matrix(heading_rad: float) -> Array:
    """Return the (3, 3) matrix from forward, right, down to NED for a level body."""
    cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


UPRIGHT = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Rotates shapes along x upright, with their +x end up."""


LARGEST_M = 2000.0
"""Largest size that is not suspected to be in millimetres."""
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def import_mesh(spec: MeshFileSpec) -> tuple[Mesh, str | None]:
    """Return the mesh in NED, and a warning if it seems to be in millimetres.

    A heading turns the file's axes clockwise as seen from above: its y axis, initially north, then points along the
    heading.

    Raises:
        WorldError: no such file, another format, no triangles, or coordinates that are not numbers.
    """
    return _imported_mesh(spec, modified_ns(spec.file))


@lru_cache(maxsize=16)
def _imported_mesh(spec: MeshFileSpec, stamp_ns: int) -> tuple[Mesh, str | None]:
    path = Path(spec.file)
    try:
        vertices, faces = read_triangles(path)
    except MeshFileError as error:
        raise WorldError(f"{path} {error}") from error
    if not len(faces):
        raise WorldError(f"{path} has no triangles; export it again, as a mesh of triangles")
    if not np.isfinite(vertices).all():
        raise WorldError(f"{path} has vertices that are not numbers; repair the mesh and export it again")
    own = spec.scale * (vertices if spec.up == "z" else vertices @ _Y_UP.T)
    extent_m = float(np.ptp(own[faces].reshape(-1, 3), axis=0).max())
    warning = None
    if extent_m > LARGEST_M:
        warning = f"{path} is {extent_m:.0f} m across; if it is in millimetres, give it scale: {spec.scale / 1000:g}"
    turned = enu_to_ned(own) @ heading_matrix(math.radians(spec.heading_deg)).T
    material = next(material for material in MATERIALS if material.name == spec.material)
    return Mesh(turned + np.array(spec.position_ned_m), faces, material), warning


Meeting: TypeAlias = tuple[Array, Array]
_PARALLEL = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """All points x with normal . x = offset_m. Rays can hit either side."""

    normal: Array
    """Unit vector, (3,)."""
    offset_m: float
    material: Material

    def meet(self, origin_m: Array, direction: Array) -> Meeting:
        """Intersect rays; see the module."""
        toward = direction @ self.normal
        slanted = np.abs(toward) > _PARALLEL
        range_m = (self.offset_m - origin_m @ self.normal) / np.where(slanted, toward, 1.0)
        return _of(np.where(slanted & (range_m >= 0.0), range_m, np.inf), np.broadcast_to(self.normal, direction.shape))


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """A sphere."""

    centre_m: Array
    """Centre, (3,)."""
    radius_m: float
    material: Material

    def meet(self, origin_m: Array, direction: Array) -> Meeting:
        """Intersect rays; see the module."""
        relative = origin_m - self.centre_m
        half = np.einsum("ij,ij->i", relative, direction)
        inner = half**2 - np.einsum("ij,ij->i", relative, relative) + self.radius_m**2
        # The lesser of -half -+ sqrt(inner) that is not behind
        root = np.sqrt(np.maximum(inner, 0.0))
        nearest = np.where(-half - root >= 0.0, -half - root, -half + root)
        hit = (inner >= 0.0) & (nearest >= 0.0)
        normal = (relative + np.where(hit, nearest, 0.0)[:, None] * direction) / self.radius_m
        return _of(np.where(hit, nearest, np.inf), normal)


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A box."""

    centre_m: Array
    """Centre, (3,)."""
    size_m: Array
    """Size along the box axes, (3,)."""
    rotation: Array
    """Box axes to NED, (3, 3)."""
    material: Material

    def meet(self, origin_m: Array, direction: Array) -> Meeting:
        """Intersect rays by the slab method."""
        relative, own = (origin_m - self.centre_m) @ self.rotation, direction @ self.rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = np.stack([(-self.size_m / 2 - relative) / own, (self.size_m / 2 - relative) / own])
        parallel = np.abs(own) <= _PARALLEL
        outside = parallel & (np.abs(relative) > self.size_m / 2)
        entry = np.where(parallel, np.where(outside, np.inf, -np.inf), sides.min(axis=0))
        leave = np.where(parallel, np.where(outside, -np.inf, np.inf), sides.max(axis=0))
        enters, leaves = entry.max(axis=1), leave.min(axis=1)
        inside = enters < 0.0
        hit = (enters <= leaves) & (leaves >= 0.0)
        range_m = np.where(hit, np.where(inside, leaves, enters), np.inf)
        axis = np.where(inside, leave.argmin(axis=1), entry.argmax(axis=1))
        normal = np.zeros_like(own)
        rows = np.arange(len(own))
        normal[rows, axis] = -np.sign(own[rows, axis])
        return _of(range_m, normal @ self.rotation.T)


@dataclass(frozen=True, slots=True, eq=False)
class Cylinder:
    """A cylinder with flat ends."""

    centre_m: Array
    """Centre, (3,)."""
    axis: Array
    """Unit vector along the axis, (3,)."""
    radius_m: float
    length_m: float
    material: Material

    def meet(self, origin_m: Array, direction: Array) -> Meeting:
        """Intersect rays with the round side and the two ends."""
        relative = origin_m - self.centre_m
        along, toward = relative @ self.axis, direction @ self.axis
        across, sideways = relative - along[:, None] * self.axis, direction - toward[:, None] * self.axis
        square = np.einsum("ij,ij->i", sideways, sideways)
        slanted = square > _PARALLEL
        per_square = 1.0 / np.where(slanted, square, 1.0)
        half = np.einsum("ij,ij->i", across, sideways) * per_square
        rest = (np.einsum("ij,ij->i", across, across) - self.radius_m**2) * per_square
        root = np.sqrt(np.maximum(half**2 - rest, 0.0))
        range_m, normal = np.full(len(along), np.inf), np.zeros_like(direction)
        for candidate in (-half - root, -half + root):
            on = slanted & (half**2 >= rest) & (candidate >= 0.0)
            on &= np.abs(along + candidate * toward) <= self.length_m / 2
            nearer = on & (candidate < range_m)
            range_m = np.where(nearer, candidate, range_m)
            side = (across + candidate[:, None] * sideways) / self.radius_m
            normal = np.where(nearer[:, None], side, normal)
        lengthwise = np.abs(toward) > _PARALLEL
        for end in (-1.0, 1.0):
            candidate = (end * self.length_m / 2 - along) / np.where(lengthwise, toward, 1.0)
            place = across + candidate[:, None] * sideways
            on = lengthwise & (candidate >= 0.0) & (np.einsum("ij,ij->i", place, place) <= self.radius_m**2)
            nearer = on & (candidate < range_m)
            range_m = np.where(nearer, candidate, range_m)
            normal = np.where(nearer[:, None], end * self.axis, normal)
        return _of(range_m, normal)


Solid: TypeAlias = Plane | Sphere | Box | Cylinder


def _of(range_m: Array, normal: Array) -> Meeting:
    return range_m, np.where(np.isfinite(range_m)[:, None], normal, 0.0)
