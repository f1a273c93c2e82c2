"""Triangles of the world for a renderer: vertices with normals, colours, temperatures and object numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.frames import Array
from sim_core.vessel.spec import VesselSpec
from sim_core.world.debris import Body
from sim_core.world.geometry import Mesh, moved
from sim_core.world.rays import ScenePart
from sim_core.world.river import RiverBed
from xitl_cli.plugins.cameras.images import ObjectClass
from xitl_cli.run.world.colours import MATERIAL_COLOURS, PAINTS, coloured_parts, ground_colours, linear_colour
from xitl_cli.run.world.vessel_shape import (
    VesselPart,
    drawn_diameter_m,
    heading_of,
    propeller_mesh,
    vessel_parts,
)
from xitl_cli.scenery import Scenery

VERTEX = np.dtype(
    [("position", "<f4", 3), ("normal", "<f4", 3), ("colour", "<f4", 4), ("id", "<f4"), ("temperature", "<f4")]
)
"""colour: linear red, green and blue, then the strength of the pattern on the surface, or `LIGHT` for a lamp."""
SMOOTH_COSINE = 0.78
"""Faces that meet at a smaller angle are shaded as one round surface."""
GROUND_CELL_M = 4.0
DEEP_M, BURIED_M = 1.0, 0.4
"""Triangles deeper below the lowest still water, or below the ground, are never seen: the water is opaque."""
WATER_C = 24.0
_TEMPERATURES_C = {
    ObjectClass.GROUND: 31.0,
    ObjectClass.VEGETATION: 25.5,
    ObjectClass.ROCK: 32.0,
    ObjectClass.DAM: 30.0,
    ObjectClass.BOOM: 33.0,
    ObjectClass.BUILDING: 30.0,
    ObjectClass.VESSEL: 36.0,
    ObjectClass.OWN_VESSEL: 36.0,
    ObjectClass.DEBRIS: 26.5,
    ObjectClass.BUOY: 32.0,
    ObjectClass.OTHER: 29.0,
}
"""Chosen, for a sunny day: what the sun warms, and what evaporates."""
_PATTERNS = {"leaves": 0.9, "earth": 0.7, "rock": 0.6, "wood": 0.6, "bed": 0.6, "concrete": 0.35, "hide": 0.3}
_PART_CLASSES = {
    "ground": ObjectClass.GROUND,
    "bed": ObjectClass.GROUND,
    "trunks": ObjectClass.VEGETATION,
    "crowns": ObjectClass.VEGETATION,
    "rocks": ObjectClass.ROCK,
    "shoal": ObjectClass.ROCK,
    "dam": ObjectClass.DAM,
    "log boom": ObjectClass.BOOM,
    "boom pile": ObjectClass.OTHER,
    "building": ObjectClass.BUILDING,
}
LIGHT = -1.0
"""Pattern of a lamp."""
_PAINT_PATTERNS = {"deck": 0.3, "white light": LIGHT, "red light": LIGHT, "green light": LIGHT}


@dataclass(frozen=True, slots=True)
class WorldObject:
    """An object that has a number in the images."""

    name: str
    kind: ObjectClass
    centre_m: tuple[float, float, float]
    """Middle of its box, in the axes of its model."""
    size_m: tuple[float, float, float]
    rot_model_box: Array = field(default_factory=lambda: np.eye(3))
    """Turns the axes of the box into those of the model, (3, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class TriangleModel:
    """Triangles that move together. Numbers of objects count within the model."""

    vertices: NDArray[np.void]
    """(3 T,) VERTEX."""
    objects: tuple[WorldObject, ...]


def triangles(
    mesh: Mesh, colour: Sequence[float], kind: ObjectClass, number: int, pattern: float = 0.15
) -> NDArray[np.void]:
    """Return the (3 T,) vertices of a mesh in one colour (sRGB), as object `number` of its model."""
    corners = mesh.vertices_m[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1, keepdims=True)
    flat = across / np.maximum(area, 1e-12)
    joined = np.zeros_like(mesh.vertices_m)
    for corner in range(3):
        np.add.at(joined, mesh.faces[:, corner], across)
    joined /= np.maximum(np.linalg.norm(joined, axis=1, keepdims=True), 1e-12)
    smooth = joined[mesh.faces]
    normals = np.where((np.vecdot(smooth, flat[:, None]) > SMOOTH_COSINE)[..., None], smooth, flat[:, None])
    vertices = np.zeros(3 * len(corners), VERTEX)
    vertices["position"], vertices["normal"] = corners.reshape(-1, 3), normals.reshape(-1, 3)
    vertices["colour"] = (*linear_colour(colour), pattern)
    vertices["id"], vertices["temperature"] = number, _TEMPERATURES_C[kind]
    return vertices


def _of_mesh(mesh: Mesh, kind: ObjectClass, number: int, colour: Sequence[float] | None = None) -> NDArray[np.void]:
    name = mesh.material.name
    return triangles(mesh, colour or MATERIAL_COLOURS[name], kind, number, _PATTERNS.get(name, 0.1))


def _object(name: str, kind: ObjectClass, points_m: Array, rotation: Array | None = None) -> WorldObject:
    """Return an object with the box around points (P, 3), along the axes `rotation` (3, 3) of the box in the model."""
    turn = np.eye(3) if rotation is None else rotation
    low, high = (points_m @ turn).min(axis=0), (points_m @ turn).max(axis=0)
    x, y, z = (turn @ (0.5 * (low + high))).tolist()
    length, width, height = (high - low).tolist()
    return WorldObject(name, kind, (x, y, z), (length, width, height), turn)


def world_model(scenery: Scenery, lowest_tide_m: float = 0.0) -> TriangleModel:
    """Return everything that does not move, in NED. Floats of the boom, buildings and meshes are objects of their own.

    lowest_tide_m: lowest height of the water above its mean level.
    """
    vertices: list[NDArray[np.void]] = []
    objects: list[WorldObject] = []
    parts: list[ScenePart] = list(scenery.scene.parts)
    if isinstance(scenery.bed, RiverBed):  # a coarser ground: nobody sees the bed
        parts = [part for part in parts if part.name != "ground"]
        parts += [ScenePart("ground", mesh) for mesh in scenery.bed.meshes(GROUND_CELL_M)]
    counted: dict[str, int] = {}
    for part in parts:
        if part.name == "bed":
            continue  # below opaque water
        kind = _PART_CLASSES.get(part.name, ObjectClass.OTHER)
        counted[part.name] = counted.get(part.name, 0) + 1
        name = part.name if kind in (ObjectClass.GROUND, ObjectClass.DAM) else f"{part.name} {counted[part.name]}"
        points = part.mesh.vertices_m[np.unique(part.mesh.faces)]
        rotation = None
        if kind is ObjectClass.BOOM and part.name == "log boom":
            axis = _long_axis(points)
            rotation = np.column_stack([axis, [-axis[1], axis[0], 0.0], [0.0, 0.0, 1.0]])
        colour = PAINTS["boom"] if part.name == "log boom" else None
        if part.name == "ground":
            shore = ground_colours(part.mesh, scenery.water_down_m)
            vertices += [_of_mesh(mesh, kind, len(objects), painted) for mesh, painted in shore]
        else:
            vertices.append(_of_mesh(part.mesh, kind, len(objects), colour))
        objects.append(_object(name, kind, points, rotation))
    joined = np.concatenate(vertices) if vertices else np.zeros(0, VERTEX)
    corners = joined["position"].astype(float).reshape(-1, 3, 3)
    seen = corners[..., 2].min(axis=1) < scenery.water_down_m - lowest_tide_m + DEEP_M
    if isinstance(scenery.bed, RiverBed):
        below_ground_m = corners[..., 2] - scenery.bed.bed_down_m(corners[..., :2])
        seen &= below_ground_m.min(axis=1) < BURIED_M
    return TriangleModel(joined[np.repeat(seen, 3)], tuple(objects))


def _long_axis(points_m: Array) -> Array:
    """Return the horizontal unit vector along the largest extent of points (P, 3)."""
    flat = points_m[:, :2] - points_m[:, :2].mean(axis=0)
    _, _, axes = np.linalg.svd(flat, full_matrices=False)
    return np.array([axes[0, 0], axes[0, 1], 0.0])


def hull_model(name: str, mesh: Mesh) -> TriangleModel:
    """Return the hull of another vessel in its axes: forward, right, down."""
    vertices = _of_mesh(mesh, ObjectClass.VESSEL, 0, PAINTS["hull"])
    return TriangleModel(vertices, (_object(name, ObjectClass.VESSEL, mesh.vertices_m),))


def body_model(name: str, body: Body) -> TriangleModel:
    """Return a floating body in its axes: forward, right, down."""
    kind = ObjectClass.DEBRIS if body.buoy is None else ObjectClass.BUOY
    parts = [_of_mesh(mesh, kind, 0, colour) for mesh, colour in coloured_parts(body)]
    return TriangleModel(np.concatenate(parts), (_object(name, kind, body.mesh.vertices_m),))


def vessel_model(vehicle: VesselSpec, water: Water, name: str, kind: ObjectClass = ObjectClass.VESSEL) -> TriangleModel:
    """Return a vessel in its axes, FRD: the parts of `vessel_parts`, and propellers."""
    parts = list(vessel_parts(vehicle, water))
    for propeller in vehicle.propellers:
        drawn = propeller_mesh(drawn_diameter_m(propeller, vehicle.length_m))
        parts.append(VesselPart("metal", moved(drawn, propeller.position_frd_m, heading_of(propeller))))
    vertices = np.concatenate(
        [triangles(part.mesh, PAINTS[part.paint], kind, 0, _PAINT_PATTERNS.get(part.paint, 0.05)) for part in parts]
    )
    corners = np.concatenate([part.mesh.vertices_m for part in parts])
    return TriangleModel(vertices, (_object(name, kind, corners),))
