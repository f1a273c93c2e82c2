"""Ray casting in numpy, with closed forms for solids.

For meshes, it uses the test of Moeller and Trumbore (Fast, minimum storage ray/triangle intersection, 1997). The test
covers the clumps of triangles with bounding spheres that a ray passes through. This backend is slower than Embree and
needs no extra package.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy import float32, float64, int16
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array, Array32
from sim_core.world.geometry import MATERIALS, Meeting, Mesh, Solid
from sim_core.world.rays import NO_BODIES, Bodies, Hits, rays_near

_CLUMP = 64
_AT_ONCE = 2_000_000 // _CLUMP
_TINY = 1e-14


class PrimitiveCaster:
    """Casts rays at `solids` and at the triangles of `meshes`, both in NED, and at bodies."""

    def __init__(self, solids: Sequence[Solid] = (), meshes: Sequence[Mesh] = ()) -> None:
        self._solids = tuple(solids)
        self._clumps = [clump for mesh in meshes for clump in _clumps(mesh)]
        self._by_mesh: dict[Mesh, list[_Clump]] = {}
        self.triangles = sum(len(mesh.faces) for mesh in meshes)

    def cast(
        self,
        origin_ned_m: Array32,
        direction_ned: Array32,
        bodies: Bodies = NO_BODIES,
        body_delay_s: Array32 | None = None,
        reach_m: Array32 | None = None,
    ) -> Hits:
        """Return the first hit of each ray; see `RayCaster`. An invalid direction, zero or NaN, hits nothing."""
        origin, direction = origin_ned_m.astype(float64), direction_ned.astype(float64)
        nearest = _Nearest.none(len(origin))
        possible = np.isfinite(np.concatenate([origin, direction], axis=1)).all(axis=1) & direction.any(axis=1)
        direction[~possible] = np.nan  # compares as false in all following tests
        rays = np.flatnonzero(possible)
        for solid in self._solids:
            nearest.keep_nearest(rays, solid.meet(origin[rays], direction[rays]), MATERIALS.index(solid.material))
        for clump in self._clumps:
            rays = clump.rays_near(origin, direction)
            nearest.keep_nearest(rays, clump.meet(origin[rays], direction[rays]), clump.material)
        radius_m = np.array([float(np.linalg.norm(mesh.vertices_m, axis=-1).max()) for mesh in bodies.meshes])
        if bodies.meshes:
            for body, rays in rays_near(origin_ned_m, direction_ned, bodies, radius_m, body_delay_s):
                # In the body's axes
                rotation, relative = bodies.rot_ned_body[body], origin[rays] - bodies.pos_ned_m[body]
                if body_delay_s is not None:
                    relative -= body_delay_s[rays, None] * bodies.vel_ned_mps[body]
                start, along = relative @ rotation, direction[rays] @ rotation
                mesh = bodies.meshes[body]
                if mesh not in self._by_mesh:
                    self._by_mesh[mesh] = list(_clumps(mesh))
                for clump in self._by_mesh[mesh]:
                    range_m, normal = clump.meet(start, along)
                    nearest.keep_nearest(rays, (range_m, normal @ rotation.T), clump.material, body)
        return nearest.hits(direction)


@dataclass(frozen=True, slots=True, eq=False)
class _Nearest:
    """Nearest hits of R rays so far; updated in place."""

    range_m: Array
    normal: Array
    material: NDArray[int16]
    body: NDArray[int16]

    @classmethod
    def none(cls, count: int) -> _Nearest:
        none = np.full(count, -1, dtype=int16)
        return cls(np.full(count, np.inf), np.zeros((count, 3)), none, none.copy())

    def keep_nearest(self, rays: NDArray[np.intp], met: Meeting, material: int, body: int = -1) -> None:
        range_m, normal = met
        nearer = range_m < self.range_m[rays]
        rows = rays[nearer]
        self.range_m[rows], self.normal[rows] = range_m[nearer], normal[nearer]
        self.material[rows], self.body[rows] = material, body

    def hits(self, direction: Array) -> Hits:
        away = np.einsum("ij,ij->i", self.normal, direction) > 0.0
        normal = np.where(away[:, None], -self.normal, self.normal)
        return Hits(self.range_m.astype(float32), normal.astype(float32), self.material, self.body)


@dataclass(frozen=True, slots=True, eq=False)
class _Clump:
    """Triangles close together: corner and two edges (F, 3) each, and their bounding sphere."""

    corner: Array
    edges: tuple[Array, Array]
    normal: Array
    centre: Array
    radius_m: float
    material: int

    def rays_near(self, origin: Array, direction: Array) -> NDArray[np.intp]:
        relative = self.centre - origin
        toward = np.einsum("ij,ij->i", relative, direction)
        square = np.einsum("ij,ij->i", relative, relative)
        near = (square - toward**2 <= self.radius_m**2) & (toward >= -self.radius_m)
        return np.flatnonzero(near)

    def meet(self, origin: Array, direction: Array) -> Meeting:
        """Return range (R,) and normal (R, 3) for rays (R, 3)."""
        range_m, normal = np.full(len(origin), np.inf), np.zeros((len(origin), 3))
        for first in range(0, len(origin), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            met = self._ranges(origin[part], direction[part])
            face = met.argmin(axis=1)
            range_m[part] = met[np.arange(len(met)), face]
            normal[part] = self.normal[face]
        return range_m, normal

    def _ranges(self, origin: Array, direction: Array) -> Array:
        """Return the (R, F) range of each ray to each triangle, inf for none."""
        edge_1, edge_2 = self.edges
        p = np.cross(direction[:, None], edge_2[None])
        determinant = np.einsum("rfi,fi->rf", p, edge_1)
        slanted = np.abs(determinant) > _TINY
        per = 1.0 / np.where(slanted, determinant, 1.0)
        to_origin = origin[:, None] - self.corner[None]
        u = np.einsum("rfi,rfi->rf", to_origin, p) * per
        q = np.cross(to_origin, edge_1[None])
        v = np.einsum("ri,rfi->rf", direction, q) * per
        range_m = np.einsum("rfi,fi->rf", q, edge_2) * per
        inside = slanted & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (range_m >= 0.0)
        met: Array = np.where(inside, range_m, np.inf)
        return met


def _clumps(mesh: Mesh) -> Iterator[_Clump]:
    """Halve the triangles along their longest extent until few remain in each part."""
    corners = mesh.vertices_m[mesh.faces]
    waiting = [np.arange(len(corners))] if len(corners) else []
    while waiting:
        numbers = waiting.pop()
        middle = corners[numbers].mean(axis=1)
        if len(numbers) > _CLUMP:
            order = np.argsort(middle[:, np.ptp(middle, axis=0).argmax()], kind="stable")
            half = len(numbers) // 2
            waiting += [numbers[order[:half]], numbers[order[half:]]]
            continue
        own = corners[numbers]
        edges = own[:, 1] - own[:, 0], own[:, 2] - own[:, 0]
        across = np.cross(*edges)
        length = np.linalg.norm(across, axis=-1, keepdims=True)
        centre = own.reshape(-1, 3).mean(axis=0)
        radius_m = float(np.linalg.norm(own - centre, axis=-1).max())
        normal = across / np.where(length > 0.0, length, 1.0)
        yield _Clump(own[:, 0], edges, normal, centre, radius_m, MATERIALS.index(mesh.material))
