"""Ray casting by Intel's Embree, through the package embreex.

All fixed geometry is one tree of triangles. A body keeps a tree in its body axes. The few rays that pass near it are
transformed into those axes, so no tree is rebuilt when the body drifts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import float32, int16, int32

from sim_core.frames import Array32
from sim_core.world.geometry import MATERIALS, Mesh, WorldError
from sim_core.world.rays import NO_BODIES, Bodies, Hits, rays_near

_MISSING = "ray casting needs embreex, which is not installed; pip install 'xitl[perception]'"


class EmbreeCaster:
    """Casts rays at the triangles of `meshes`, in NED, and at bodies.

    Raises:
        WorldError: embreex is not installed.
    """

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        self._still = _Tree(meshes)
        self._by_mesh: dict[Mesh, _Tree] = {}
        self.triangles = self._still.triangles

    def cast(
        self,
        origin_ned_m: Array32,
        direction_ned: Array32,
        bodies: Bodies = NO_BODIES,
        body_delay_s: Array32 | None = None,
        reach_m: Array32 | None = None,
    ) -> Hits:
        """Return the first hit of each ray; see `RayCaster`."""
        origin = np.ascontiguousarray(origin_ned_m, dtype=float32)
        direction = np.ascontiguousarray(direction_ned, dtype=float32)
        hits = self._still.cast(origin, direction, reach_m)
        if not bodies.meshes:
            return hits
        for mesh in bodies.meshes:
            if mesh not in self._by_mesh:
                self._by_mesh[mesh] = _Tree([mesh])
        trees = [self._by_mesh[mesh] for mesh in bodies.meshes]
        radius_m = np.array([tree.radius_m for tree in trees])
        for body, rays in rays_near(origin, direction, bodies, radius_m, body_delay_s):
            # Cast in the body's axes, and keep the hits that are nearer than the earlier ones
            rotation = bodies.rot_ned_body[body]
            relative = origin[rays] - bodies.pos_ned_m[body]
            if body_delay_s is not None:
                relative -= body_delay_s[rays, None] * bodies.vel_ned_mps[body]
            own = trees[body].cast((relative @ rotation).astype(float32), (direction[rays] @ rotation).astype(float32))
            nearer = own.range_m < hits.range_m[rays]
            rows = rays[nearer]
            hits.range_m[rows] = own.range_m[nearer]
            hits.normal_ned[rows] = own.normal_ned[nearer] @ rotation.T
            hits.material[rows] = own.material[nearer]
            hits.body[rows] = body
        return hits


class _Tree:
    """Triangles in Embree, with a table of normals and materials. Its last row is for no hit (number -1)."""

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh  # type: ignore[import-untyped]
            from embreex.rtcore_scene import EmbreeScene  # type: ignore[import-untyped]
        except ImportError:
            raise WorldError(_MISSING) from None
        corners = np.concatenate([np.empty((0, 3, 3)), *(mesh.vertices_m[mesh.faces] for mesh in meshes)])
        self.triangles = len(corners)
        self.radius_m = float(np.max(np.linalg.norm(corners, axis=-1), initial=0.0))
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(across, axis=-1, keepdims=True)
        self._normals = np.zeros((self.triangles + 1, 3), dtype=float32)
        self._normals[:-1] = across / np.where(length > 0.0, length, 1.0)  # 0 for a triangle without an area
        kinds = [np.full(len(mesh.faces), MATERIALS.index(mesh.material)) for mesh in meshes]
        self._materials = np.concatenate([*kinds, [-1]]).astype(int16)
        self._scene: Any = None
        if self.triangles:
            # Each corner once: embreex reads number by number, and most corners belong to six triangles.
            counts = [len(mesh.vertices_m) for mesh in meshes]
            firsts = np.cumsum([0, *counts[:-1]])
            faces = [mesh.faces + first for mesh, first in zip(meshes, firsts, strict=True)]
            vertices = [mesh.vertices_m for mesh in meshes]
            self._scene = EmbreeScene()
            self._kept = TriangleMesh(
                self._scene, np.concatenate(vertices).astype(float32), np.concatenate(faces).astype(int32)
            )

    def cast(self, origin: Array32, direction: Array32, reach_m: Array32 | None = None) -> Hits:
        """Cast rays in the tree's axes; `body` is -1 throughout."""
        count = len(origin)
        none = np.full(count, -1, dtype=int16)
        if self._scene is None or not count:
            return Hits(np.full(count, np.inf, dtype=float32), np.zeros((count, 3), dtype=float32), none, none.copy())
        # A copy, because Embree writes the ranges into it.
        reach = None if reach_m is None else np.array(reach_m, dtype=float32)
        met = self._scene.run(origin, direction, reach, query="INTERSECT", output=1)
        triangle, range_m = met["primID"], met["tfar"]
        range_m[triangle < 0] = np.inf
        normal = self._normals.take(triangle, axis=0, mode="wrap")  # -1 is the last row
        away = np.einsum("ij,ij->i", normal, direction) > 0.0
        toward = np.where(away, float32(-1.0), float32(1.0))
        for axis in range(3):  # by columns: numpy is ten times slower for rows of three
            normal[:, axis] *= toward
        return Hits(range_m, normal, self._materials[triangle], none)
