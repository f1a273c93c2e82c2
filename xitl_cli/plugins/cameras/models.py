"""Triangles of the world for a renderer: vertices with normals, colours, temperatures and object numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.vessel.sections import hull_shape
from sim_core.vessel.spec import VesselSpec
from sim_core.world.debris import BodyKind
from sim_core.world.geometry import STEEL, UPRIGHT, Mesh, box, cylinder, moved, sphere
from sim_core.world.rays import ScenePart
from sim_core.world.river import RiverBed
from xitl_cli.plugins.cameras.images import ObjectClass
from xitl_cli.run.world.scene import BODY_COLOURS, MATERIAL_COLOURS
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
WHITE, DARK, ORANGE, RED = (0.90, 0.91, 0.92), (0.10, 0.11, 0.12), (0.95, 0.40, 0.06), (0.45, 0.06, 0.05)

WHITE_LIGHT, RED_LIGHT, GREEN_LIGHT = (1.0, 0.98, 0.9), (1.0, 0.1, 0.08), (0.1, 1.0, 0.3)
LIGHT = -1.0
"""Pattern of a lamp."""


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


def linear(colour: Sequence[float]) -> Array:
    """Return linear red, green and blue of an sRGB colour (IEC 61966-2-1), all from 0 to 1."""
    value = np.asarray(colour, dtype=float64)
    result: Array = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return result


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
    vertices["colour"] = (*linear(colour), pattern)
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
        colour = ORANGE if part.name == "log boom" else None
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


def body_model(name: str, mesh: Mesh, kind: BodyKind | None) -> TriangleModel:
    """Return a drifting body, or another hull (None), in its axes: forward, right, down."""
    shown = ObjectClass.VESSEL if kind is None else ObjectClass.DEBRIS
    colour = WHITE if kind is None else BODY_COLOURS[kind]
    return TriangleModel(_of_mesh(mesh, shown, 0, colour), (_object(name, shown, mesh.vertices_m),))


def vessel_model(vehicle: VesselSpec, name: str, kind: ObjectClass = ObjectClass.VESSEL) -> TriangleModel:
    """Return a vessel in its axes, FRD: hulls, deck, mast with lights, propellers with guards, rudders.

    The parts above the deck are chosen: a profile does not describe them.
    """
    pieces: list[tuple[Mesh, Sequence[float], float]] = []
    for hull in vehicle.demi_hulls:
        shape = hull_shape(hull)
        pieces.append((Mesh(np.asarray(shape.vertices_m), np.asarray(shape.faces), STEEL), WHITE, 0.05))
    hulls = vehicle.demi_hulls
    top_m = max(hull.keel_frd_m[2] - hull.height_m for hull in hulls)  # the lowest deck, down
    ahead_m, length_m, beam_m = vehicle.midship_frd_x_m, vehicle.length_m, vehicle.width_m
    scale_m = min(length_m, 8.0)
    if len(hulls) > 1:
        sides = [hull.keel_frd_m[1] for hull in hulls]
        wide_m, deck_m = max(sides) - min(sides), 0.035 * scale_m
        middle_m = 0.5 * (max(sides) + min(sides))
        pieces.append((moved(box((0.55 * length_m, wide_m, deck_m), STEEL), (ahead_m, middle_m, top_m)), DARK, 0.3))
        for share in (-0.33, 0.33):
            beam = box((0.04 * length_m, wide_m, deck_m), STEEL)
            pieces.append((moved(beam, (ahead_m + share * length_m, middle_m, top_m + 0.5 * deck_m)), DARK, 0.1))
        top_m -= 0.5 * deck_m
    house = (0.22 * scale_m, 0.3 * min(beam_m, 0.6 * scale_m), 0.09 * scale_m)
    place = (ahead_m - 0.05 * length_m, 0.0, top_m - 0.5 * house[2])
    pieces.append((moved(box(house, STEEL), place), ORANGE, 0.05))
    mast_m = 0.34 * scale_m
    foot = (place[0] - 0.2 * house[0], 0.0, top_m - house[2])
    pieces.append(
        (moved(cylinder(0.008 * scale_m, mast_m, STEEL, 8), (foot[0], 0.0, foot[2] - mast_m / 2), UPRIGHT), DARK, 0.0)
    )
    antenna = moved(cylinder(0.03 * scale_m, 0.02 * scale_m, STEEL, 12), (foot[0], 0.0, foot[2] - mast_m), UPRIGHT)
    pieces.append((antenna, WHITE, 0.0))
    # Navigation lights (COLREG rule 23 for a power-driven vessel under 12 m: white all round, sidelights)
    radius_m = 0.012 * scale_m
    side_m, bow_m = 0.5 * house[1], place[0] + 0.5 * house[0]
    for at, colour in (
        ((foot[0], 0.0, foot[2] - mast_m - 2.0 * radius_m), WHITE_LIGHT),
        ((bow_m, -side_m, top_m - house[2]), RED_LIGHT),
        ((bow_m, side_m, top_m - house[2]), GREEN_LIGHT),
    ):
        pieces.append((moved(sphere(radius_m, STEEL, 8, 4), at), colour, LIGHT))
    for propeller in vehicle.propellers:
        forward, right, down = propeller.position_frd_m
        curve = propeller.open_water
        guess_m = (0.25 if propeller.medium == "air" else 0.08) * length_m
        radius_m = 0.5 * (curve.diameter_m if curve is not None else propeller.diameter_m or guess_m)
        turn = _about_down(math.radians(propeller.angle_deg))
        for part in _propeller(radius_m):
            pieces.append((moved(part, (forward, right, down), turn), DARK, 0.0))
        if propeller.medium == "air":
            stand_m = max(top_m - down, 0.0)
            stand = box((0.05 * radius_m, 0.08 * radius_m, stand_m), STEEL)
            pieces.append((moved(stand, (forward, right, down + stand_m / 2)), DARK, 0.0))
    for rudder in vehicle.rudders:
        chord_m = math.sqrt(rudder.area_m2 / rudder.aspect_ratio)
        blade = box((chord_m, 0.12 * chord_m, rudder.aspect_ratio * chord_m), STEEL)
        pieces.append((moved(blade, rudder.position_frd_m), RED, 0.0))
    vertices = np.concatenate([triangles(mesh, colour, kind, 0, pattern) for mesh, colour, pattern in pieces])
    corners = np.concatenate([mesh.vertices_m for mesh, _, _ in pieces])
    return TriangleModel(vertices, (_object(name, kind, corners),))


def _propeller(radius_m: float) -> Iterator[Mesh]:
    """Yield guard, hub and blades of a propeller that turns about x."""
    thick, deep = 0.05 * radius_m, 0.12 * radius_m
    yield _ring(radius_m, radius_m - thick, 0.5 * deep)
    yield cylinder(0.12 * radius_m, 0.5 * radius_m, STEEL, 10)
    for number in range(3):
        blade = box((0.04 * radius_m, 0.14 * radius_m, 0.88 * radius_m), STEEL)
        lifted = moved(blade, (0.0, 0.0, -0.44 * radius_m))
        yield moved(lifted, (0.0, 0.0, 0.0), _about_ahead(number * 2.0 * math.pi / 3.0))


def _ring(outer_m: float, inner_m: float, half_m: float, sides: int = 24) -> Mesh:
    """Return a ring about x between two radii, from -half_m to half_m."""
    turn = 2.0 * math.pi * np.arange(sides) / sides
    rings = [
        np.column_stack([np.full(sides, x), radius * np.cos(turn), radius * np.sin(turn)])
        for x, radius in ((-half_m, inner_m), (-half_m, outer_m), (half_m, outer_m), (half_m, inner_m))
    ]
    here = np.arange(sides)
    following = (here + 1) % sides
    faces = []
    for ring in range(4):
        low, high = ring * sides, (ring + 1) % 4 * sides
        faces += [
            np.column_stack([low + here, low + following, high + here]),
            np.column_stack([low + following, high + following, high + here]),
        ]
    return Mesh(np.concatenate(rings), np.concatenate(faces).astype(np.int32), STEEL)


def _about_down(angle_rad: float) -> Array:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _about_ahead(angle_rad: float) -> Array:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
