"""Triangles of shapes: vertices (V, 3) and faces (F, 3), counter-clockwise as seen from outside, z up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sim_core.frames import quat_to_matrix
from xitl_cli.plugins.view.model import Array, Colour, Faces, Points, SceneMesh


class Geometry(NamedTuple):
    """Triangles without a colour."""

    vertices_m: Points
    faces: Faces

    def placed(self, position_m: Sequence[float], attitude_wxyz: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> Geometry:
        """Return the shape after a rotation and then a shift."""
        turned = self.vertices_m @ quat_to_matrix(np.asarray(attitude_wxyz, dtype=np.float64)).T
        return Geometry((turned + np.asarray(position_m)).astype(np.float32), self.faces)

    def mesh(self, name: str, colour: Colour, opacity: float = 1.0) -> SceneMesh:
        """Return the shape as a mesh with a name and a colour."""
        return SceneMesh(name, self.vertices_m, self.faces, colour, opacity)


def geometry(vertices_m: object, faces: object) -> Geometry:
    """Return a Geometry from array-like vertices and faces."""
    return Geometry(
        np.ascontiguousarray(vertices_m, dtype=np.float32).reshape(-1, 3),
        np.ascontiguousarray(faces, dtype=np.uint32).reshape(-1, 3),
    )


EMPTY = geometry([], [])


def merged(shapes: Sequence[Geometry]) -> Geometry:
    """Return all shapes as one."""
    if not shapes:
        return EMPTY
    first = np.cumsum([0, *(len(each.vertices_m) for each in shapes)])
    faces = [each.faces + np.uint32(offset) for each, offset in zip(shapes, first[:-1].tolist(), strict=True)]
    return geometry(np.concatenate([each.vertices_m for each in shapes]), np.concatenate(faces))


def frustum(
    size_m: tuple[float, float, float], bottom_scale: float = 1.0, top_scale: float = 1.0, sides: int = 20
) -> Geometry:
    """Return an upright cylinder around the origin, as Foxglove defines it.

    size_m: diameters along x and y, and height. bottom_scale, top_scale: factors on the ends; 1, 0 is a cone.
    """
    turn = 2.0 * math.pi * np.arange(sides) / sides
    ring = 0.5 * np.stack([np.cos(turn) * size_m[0], np.sin(turn) * size_m[1]], axis=-1)
    half = 0.5 * size_m[2]
    low = np.column_stack([bottom_scale * ring, np.full(sides, -half)])
    high = np.column_stack([top_scale * ring, np.full(sides, half)])
    here = np.arange(sides)
    following = (here + 1) % sides
    # The rims have double vertices, so that shading does not blend the side with the flat ends.
    side = np.concatenate(
        [np.stack([here, following, sides + here], -1), np.stack([following, sides + following, sides + here], -1)]
    )
    ends = [[0.0, 0.0, -half], [0.0, 0.0, half]]
    first, middle = 2 * sides, 4 * sides
    caps = np.concatenate(
        [
            np.stack([np.full(sides, middle), first + following, first + here], -1),
            np.stack([np.full(sides, middle + 1), first + sides + here, first + sides + following], -1),
        ]
    )
    return geometry(np.concatenate([low, high, low, high, ends]), np.concatenate([side, caps]))


_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def cuboid(size_m: tuple[float, float, float]) -> Geometry:
    """Return a cuboid around the origin. The sides share no vertices, so that edges look sharp."""
    vertices = np.concatenate([_CORNERS[list(side)] for side in _SIDES]) * np.asarray(size_m)
    faces = [[4 * side + corner for corner in face] for side in range(6) for face in ((0, 1, 2), (0, 2, 3))]
    return geometry(vertices, faces)


def ellipsoid(size_m: tuple[float, float, float], sides: int = 20, rings: int = 10) -> Geometry:
    """Return an ellipsoid around the origin. size_m: diameters."""
    down, turn = np.meshgrid(
        np.linspace(0.0, math.pi, rings + 1), 2.0 * math.pi * np.arange(sides) / sides, indexing="ij"
    )
    unit = np.stack([np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), np.cos(down)], axis=-1)
    corner = np.arange((rings + 1) * sides).reshape(rings + 1, sides)
    following = np.roll(corner, -1, axis=1)
    here, beside, below, across = corner[:-1], following[:-1], corner[1:], following[1:]
    faces = np.concatenate(
        [np.stack([here, below, across], -1).reshape(-1, 3), np.stack([here, across, beside], -1).reshape(-1, 3)]
    )
    return geometry(0.5 * unit.reshape(-1, 3) * np.asarray(size_m), faces)


def arrow(length_m: float, diameter_m: float) -> Geometry:
    """Return an arrow from the origin along x. Its head has a fifth of its length."""
    head_m = 0.3 * length_m
    shaft = frustum((0.4 * diameter_m, 0.4 * diameter_m, length_m - head_m), sides=10)
    head = frustum((diameter_m, diameter_m, head_m), 1.0, 0.0, sides=14)
    upright = merged(
        [shaft.placed((0.0, 0.0, 0.5 * (length_m - head_m))), head.placed((0.0, 0.0, length_m - 0.5 * head_m))]
    )
    return upright.placed((0.0, 0.0, 0.0), _from_upright(np.array([1.0, 0.0, 0.0])))


def propeller(diameter_m: float, blades: int = 3) -> Geometry:
    """Return a propeller that turns about x: a hub along x, and blades at an angle to the flow."""
    radius = 0.5 * diameter_m
    hub = frustum((0.22 * diameter_m, 0.22 * diameter_m, 0.3 * diameter_m), 1.0, 0.5, sides=12)
    shapes = [hub.placed((0.0, 0.0, 0.0), _from_upright(np.array([1.0, 0.0, 0.0])))]
    reach = np.linspace(0.1, 1.0, 5) * radius
    chord = np.array([0.12, 0.3, 0.36, 0.3, 0.1]) * radius
    pitch = np.radians([60.0, 45.0, 34.0, 27.0, 22.0])
    edges = [
        np.column_stack([sign * 0.5 * chord * np.sin(pitch), sign * 0.5 * chord * np.cos(pitch), reach])
        for sign in (-1.0, 1.0)
    ]
    here = np.arange(len(reach) - 1)
    count = len(reach)
    face = np.concatenate(
        [np.stack([here, here + count, here + 1], -1), np.stack([here + 1, here + count, here + count + 1], -1)]
    )
    blade = geometry(np.concatenate(edges), np.concatenate([face, face[:, ::-1]]))
    for number in range(blades):
        half_rad = math.pi * number / blades
        shapes.append(blade.placed((0.0, 0.0, 0.0), (math.cos(half_rad), math.sin(half_rad), 0.0, 0.0)))
    return merged(shapes)


def boat(length_m: float) -> Geometry:
    """Return a plain hull for a vessel with only a known length: bow at +x, waterline at z = 0."""
    stations = np.array([-0.5, -0.48, 0.0, 0.25, 0.4, 0.5]) * length_m
    beams = np.array([0.30, 0.32, 0.34, 0.28, 0.15, 0.0]) * length_m
    drafts = np.array([0.05, 0.09, 0.1, 0.09, 0.05, -0.05]) * length_m
    deck = np.array([0.13, 0.13, 0.14, 0.16, 0.19, 0.21]) * length_m
    rings = [
        [[x, 0.5 * beam, top], [x, 0.4 * beam, 0.0], [x, 0.0, -draft], [x, -0.4 * beam, 0.0], [x, -0.5 * beam, top]]
        for x, beam, draft, top in zip(stations, beams, drafts, deck, strict=True)
    ]
    faces = []
    for ring in range(len(rings) - 1):
        for corner in range(5):
            here, following = 5 * ring + corner, 5 * ring + (corner + 1) % 5
            faces += [[here, here + 5, following], [following, here + 5, following + 5]]
    faces += [[0, 1, 2], [0, 2, 3], [0, 3, 4]]
    cabin = cuboid((0.3 * length_m, 0.2 * length_m, 0.12 * length_m)).placed((-0.12 * length_m, 0.0, 0.19 * length_m))
    return merged([geometry(rings, faces), cabin])


def _from_upright(direction: Array) -> tuple[float, float, float, float]:
    """Return (w, x, y, z) of the shortest rotation from +z to a unit vector."""
    x, y, z = direction.tolist()
    if z < -0.999999:
        return 0.0, 1.0, 0.0, 0.0
    w = math.sqrt(0.5 * (1.0 + z))
    return w, -y / (2.0 * w), x / (2.0 * w), 0.0
