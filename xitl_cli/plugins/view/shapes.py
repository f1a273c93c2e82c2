"""Triangles: vertices (V, 3) and faces (F, 3), counter-clockwise as seen from outside, z up.

The water surface is a grid that follows the camera's subject and moves with the waves of the run. Its cells are small
near the middle and grow outwards to the haze. A wave that is too short for a cell's size fades there, so that the
distant surface does not flicker.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import quat_to_matrix
from xitl_cli.plugins.view.model import Array, Colour, Faces, Points, SceneMesh, SceneWaves


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
    first = np.cumsum([0, *(len(shape.vertices_m) for shape in shapes)])
    faces = [shape.faces + np.uint32(offset) for shape, offset in zip(shapes, first[:-1].tolist(), strict=True)]
    return geometry(np.concatenate([shape.vertices_m for shape in shapes]), np.concatenate(faces))


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
    return upright.placed((0.0, 0.0, 0.0), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))


CREASE_COSINE = 0.8
"""Faces that meet at a smaller cosine keep a sharp edge."""


def creased(shape: Geometry) -> Geometry:
    """Return the shape with separate vertices at its sharp edges, because a browser shades across shared vertices."""
    if not len(shape.faces):
        return shape
    corners = shape.vertices_m[shape.faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    joined = np.zeros(shape.vertices_m.shape)
    for corner in range(3):
        np.add.at(joined, shape.faces[:, corner], across)
    joined /= np.maximum(np.linalg.norm(joined, axis=1, keepdims=True), 1e-12)
    smooth = np.vecdot(joined[shape.faces], flat[:, None]) > CREASE_COSINE
    # A corner at an edge shares its vertex with the faces of the same direction only
    direction = np.where(smooth[..., None], 2.0, np.round(flat * 4.0)[:, None] / 4.0).reshape(-1, 3)
    key = np.column_stack([shape.faces.reshape(-1), direction])
    _, first, number = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return geometry(shape.vertices_m[shape.faces.reshape(-1)[first]], number.reshape(-1, 3))


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


@dataclass(frozen=True, slots=True)
class WaterResolution:
    """Resolution of the water surface."""

    near_cell_m: float
    """Size of the cells near the middle."""
    near_cells: int
    """Number of cells of this size to shape side of the middle."""
    growth_cells: int
    """Number of growing cells beyond them, to the haze."""
    height_step_m: float = 0.0
    """Step to which heights are rounded, 0 for no rounding."""


SCREEN_WATER = WaterResolution(0.75, 26, 13)
PAGE_WATER = WaterResolution(1.5, 8, 5, 0.02)
"""Resolution for a page. The page stores the height of every vertex at every instant, about 10 kB per second."""
REACH_M = 1800.0


class WaterGrid:
    """Grid of the water surface.

    reach_m: half of its side length. waves: None for still water, whose grid is a square of two triangles.
    """

    def __init__(
        self, waves: SceneWaves | None, reach_m: float = REACH_M, resolution: WaterResolution = SCREEN_WATER
    ) -> None:
        self.waves = waves
        self._cell_m, self._step_m = resolution.near_cell_m, resolution.height_step_m
        axis = np.array([-reach_m, reach_m]) if waves is None else _axis(reach_m, resolution)
        east, north = (part.ravel() for part in np.meshgrid(axis, axis, indexing="xy"))
        self.vertices_m: Points = np.column_stack([east, north, np.zeros(len(east))]).astype(np.float32)
        """(V, 3), relative to the middle of the grid."""
        corner = np.arange(len(axis) ** 2).reshape(len(axis), len(axis))
        here, beside = corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel()
        above, across = corner[1:, :-1].ravel(), corner[1:, 1:].ravel()
        triangles = np.concatenate([np.stack([here, beside, across], -1), np.stack([here, across, above], -1)])
        self.faces: Faces = triangles.astype(np.uint32)
        if waves is not None:
            gap = np.gradient(axis)
            cell_m = np.maximum(*(part.ravel() for part in np.meshgrid(gap, gap, indexing="xy")))
            number = np.hypot(*waves.wave_vector_en_radpm.T)
            amplitude_m = waves.amplitude_m * np.exp(-((0.5 * cell_m[:, None] * number) ** 2))
            phase = self.vertices_m[:, :2].astype(np.float64) @ waves.wave_vector_en_radpm.T
            self._of_cosine: NDArray[np.float32] = (amplitude_m * np.cos(phase)).astype(np.float32)
            self._of_sine: NDArray[np.float32] = (amplitude_m * np.sin(phase)).astype(np.float32)

    def middle(self, place_en_m: Array) -> tuple[float, float]:
        """Return the grid's middle for a subject. It is a multiple of the cell size, so that waves do not swim."""
        if self.waves is None:
            return float(place_en_m[0]), float(place_en_m[1])
        east, north = (np.round(place_en_m / self._cell_m) * self._cell_m).tolist()
        return east, north

    def move(self, time_s: float, middle_en_m: tuple[float, float]) -> Points:
        """Return the vertices at an instant, relative to the middle and the still level. The array is reused."""
        waves = self.waves
        if waves is not None:
            phase = (
                waves.wave_vector_en_radpm @ np.asarray(middle_en_m)
                - waves.angular_frequency_radps * time_s
                + waves.phase_rad
            )
            cosine, sine = np.cos(phase).astype(np.float32), np.sin(phase).astype(np.float32)
            up_m = self._of_cosine @ cosine - self._of_sine @ sine
            self.vertices_m[:, 2] = np.round(up_m / self._step_m) * self._step_m if self._step_m else up_m
        return self.vertices_m


def _axis(reach_m: float, resolution: WaterResolution) -> Array:
    """Return the coordinates of the grid's lines."""
    cell_m, growing = resolution.near_cell_m, np.arange(1, resolution.growth_cells + 1)
    near_m = cell_m * resolution.near_cells
    ratio = 1.0
    for _ in range(60):  # the ratio of neighbouring cells for which they add up
        total = cell_m * float(np.sum(ratio**growing))
        ratio *= (max(reach_m - near_m, cell_m) / total) ** (1.0 / len(growing))
    cells = np.concatenate([np.full(resolution.near_cells, cell_m), cell_m * ratio**growing])
    half = np.cumsum(cells)
    return np.concatenate([-half[::-1], [0.0], half])


def heading_wxyz(east: float, north: float) -> tuple[float, float, float, float]:
    """Return the rotation (w, x, y, z) about the vertical from +x to a direction."""
    half = 0.5 * math.atan2(north, east)
    return math.cos(half), 0.0, 0.0, math.sin(half)
