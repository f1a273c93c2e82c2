"""Hulls as the sensors of other vessels see them: triangles for rays, and upright sides for range sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.frames import Array
from sim_core.vessel.sections import hull_shape
from sim_core.vessel.spec import VesselSpec
from sim_core.world.geometry import PLASTIC, Mesh, merged
from sim_core.world.plan import Walls, convex_hull


@dataclass(frozen=True, slots=True, eq=False)
class SeenHull:
    """Visible shape of a vessel in body axes, with E sides."""

    mesh: Mesh
    """Mesh of all hulls of the vessel."""
    from_frd_m: Array
    """First ends of the sides, halfway between top and bottom, (E, 3)."""
    span_frd_m: Array
    """Vectors to the second ends, (E, 3)."""
    half_height_m: Array
    """Half the height of the sides, (E,)."""

    @classmethod
    def of_model(cls, model: VesselSpec) -> SeenHull:
        """Return the shape of a vessel's demi-hulls. Raises the same errors as `hull_shape`."""
        shapes = [hull_shape(hull) for hull in model.demi_hulls]
        return cls.of_meshes([Mesh(shape.vertices_m, shape.faces, PLASTIC) for shape in shapes])

    @classmethod
    def of_meshes(cls, meshes: list[Mesh]) -> SeenHull:
        """Return the shape of meshes, with the convex outline of each as sides."""
        corners, following, half = [], [], []
        for mesh in meshes:
            plan = convex_hull(mesh.vertices_m[:, :2])
            top_m, bottom_m = float(mesh.vertices_m[:, 2].min()), float(mesh.vertices_m[:, 2].max())
            corners.append(np.column_stack([plan, np.full(len(plan), 0.5 * (top_m + bottom_m))]))
            following.append(np.roll(corners[-1], -1, axis=0))
            half.append(np.full(len(plan), 0.5 * (bottom_m - top_m)))
        start = np.concatenate(corners)
        return cls(merged(meshes), start, np.concatenate(following) - start, np.concatenate(half))

    def walls(self, pos_ned_m: Array, rot_ned_frd: Array) -> Walls:
        """Return its upright sides at its present pose."""
        start = self.from_frd_m @ rot_ned_frd.T + pos_ned_m
        span = self.span_frd_m @ rot_ned_frd.T
        middle_m = start[:, 2] + 0.5 * span[:, 2]
        return Walls(start[:, :2], span[:, :2], middle_m - self.half_height_m, middle_m + self.half_height_m)
