"""Convert recorded scenes, Foxglove's SceneUpdate messages, to the data that a view draws.

xitl_cli/run/world/scene.py makes the messages. A live view receives the same bytes through its pipe.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import default_rng

from sim_core.dataclass import dataclass
from sim_core.environment.tide import make_tide
from sim_core.environment.waves import WaveField, realise_waves
from sim_core.frames import quat_to_matrix
from xitl_cli.errors import UserError
from xitl_cli.graph.wdri import profile_wdri
from xitl_cli.plugins.view import shapes
from xitl_cli.plugins.view.model import (
    Array,
    Colour,
    SceneMesh,
    SceneThruster,
    SceneVessel,
    SceneWater,
    SceneWaves,
    ViewScene,
)
from xitl_cli.plugins.view.shapes import Geometry
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.foxglove_types import foxglove_type
from xitl_cli.record.topics import MAP_FRAME, VESSEL_FRAME
from xitl_cli.run.world.colours import water_colour
from xitl_cli.seeds import Seeds

BODY = "body_"
PLAIN_LENGTH_M = 2.0
ROUNDING_S = 1e-6
"""Tolerance for rounded times, so that an entity is visible at its own time stamp."""
PLAIN_COLOURS = ((235, 237, 242), (240, 150, 50), (90, 190, 240), (150, 210, 90), (230, 110, 170))


@dataclass(frozen=True, slots=True, eq=False)
class DrawnEntity:
    """An entity of a SceneUpdate, with a mesh for each of its colours."""

    frame: str
    name: str
    meshes: tuple[SceneMesh, ...]
    lines_m: tuple[Array, ...]
    """Points (P, 3) of each line."""
    cylinders: tuple[tuple[Array, Array, float], ...]
    """Position, axis and diameter of each cylinder."""
    boxes: tuple[tuple[Array, Array], ...]
    """Position and size of each box."""
    from_s: float = 0.0
    """Time stamp."""
    lifetime_s: float = 0.0
    """Duration from the time stamp, 0 for a permanent entity."""


def read_scene_updates(*updates: bytes) -> list[DrawnEntity]:
    """Return the entities of all encoded updates. Raises ValueError for bytes that are not a SceneUpdate."""
    try:
        messages = [foxglove_type("SceneUpdate").FromString(update) for update in updates]
    except Exception as error:  # DecodeError is of the implementation's own
        raise ValueError("no foxglove.SceneUpdate") from error
    return [_entity(entity) for message in messages for entity in message.entities]


def _entity(entity: Any) -> DrawnEntity:
    by_colour: dict[tuple[Colour, float], list[Geometry]] = {}
    lines, cylinders, boxes = [], [], []
    for cylinder in entity.cylinders:
        size, (position, attitude) = _vector(cylinder.size), _pose(cylinder.pose)
        drawn = shapes.frustum(size, cylinder.bottom_scale, cylinder.top_scale).placed(position, attitude)
        by_colour.setdefault(_colour(cylinder.color), []).append(drawn)
        cylinders.append((np.array(position), quat_to_matrix(np.array(attitude))[:, 2], size[0]))
    for cube in entity.cubes:
        size, (position, attitude) = _vector(cube.size), _pose(cube.pose)
        by_colour.setdefault(_colour(cube.color), []).append(shapes.cuboid(size).placed(position, attitude))
        boxes.append((np.array(position), np.array(size)))
    for ball in entity.spheres:
        drawn = shapes.ellipsoid(_vector(ball.size)).placed(*_pose(ball.pose))
        by_colour.setdefault(_colour(ball.color), []).append(drawn)
    for triangles in entity.triangles:
        points = np.array([_vector(point) for point in triangles.points], dtype=np.float32).reshape(-1, 3)
        numbers = np.array(triangles.indices, dtype=np.uint32)
        faces = numbers if len(numbers) else np.arange(len(points), dtype=np.uint32)
        shape = shapes.creased(shapes.geometry(points, faces[: len(faces) // 3 * 3]))
        drawn = shape.placed(*_pose(triangles.pose))
        by_colour.setdefault(_colour(triangles.color), []).append(drawn)
    for line in entity.lines:
        position, attitude = _pose(line.pose)
        along = np.array([_vector(point) for point in line.points], dtype=np.float64).reshape(-1, 3)
        lines.append(along @ quat_to_matrix(np.array(attitude)).T + position)
    meshes = [
        shapes.merged(parts).mesh(f"{entity.id} {number}", colour, opacity)
        for number, ((colour, opacity), parts) in enumerate(by_colour.items())
    ]
    times = (_seconds(entity.timestamp), _seconds(entity.lifetime))
    return DrawnEntity(entity.frame_id, entity.id, tuple(meshes), tuple(lines), tuple(cylinders), tuple(boxes), *times)


def _seconds(message: Any) -> float:
    """Return the seconds of a time stamp or a duration."""
    seconds: float = message.seconds + message.nanos * 1e-9
    return seconds


def _vector(message: Any) -> tuple[float, float, float]:
    return message.x, message.y, message.z


def _pose(message: Any) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    turn = message.orientation
    attitude = (turn.w, turn.x, turn.y, turn.z)
    return _vector(message.position), attitude if any(attitude) else (1.0, 0.0, 0.0, 0.0)


def _colour(message: Any) -> tuple[Colour, float]:
    red, green, blue = (round(255 * min(max(value, 0.0), 1.0)) for value in (message.r, message.g, message.b))
    return (red, green, blue), round(message.a, 3)


def read_bodies(entities: Iterable[DrawnEntity]) -> dict[int, tuple[SceneMesh, ...]]:
    """Return the meshes of the debris by number."""
    return {
        int(entity.frame.removeprefix(BODY)): entity.meshes
        for entity in entities
        if entity.frame.startswith(BODY) and entity.meshes
    }


def read_missions(entities: Iterable[DrawnEntity]) -> dict[str, Array]:
    """Return the missions by vessel, as positions (W, 3) in the map."""
    return {
        vessel: entity.lines_m[0]
        for entity in entities
        for vessel, kind in [_of_vessel(entity)]
        if kind == "mission" and entity.lines_m
    }


def read_passing(entities: Iterable[DrawnEntity]) -> list[DrawnEntity]:
    """Return the temporary entities in the map, such as the drawings of plug-ins."""
    return [entity for entity in entities if entity.lifetime_s > 0.0 and entity.frame == MAP_FRAME]


def passing_at(entities: Mapping[str, DrawnEntity], time_s: float) -> dict[str, tuple[SceneMesh, ...]]:
    """Return the meshes of the entities that are visible at an instant, by name."""
    time_s += ROUNDING_S
    return {
        name: entity.meshes
        for name, entity in entities.items()
        if entity.from_s <= time_s < entity.from_s + entity.lifetime_s
    }


def _of_vessel(entity: DrawnEntity) -> tuple[str, str]:
    """Return the vessel's name and the kind of an entity."""
    vessel, _, kind = entity.name.rpartition("/")
    return vessel, kind


def make_view_scene(title: str, entities: Iterable[DrawnEntity], profiles: Sequence[RunProfile] = ()) -> ViewScene:
    """Return the scene from all entities of a run or recording.

    It has no debris and no later missions, see `read_bodies` and `read_missions`. profiles: profiles of the run's
    vessels, for the water and its waves; empty if they are unknown.
    """
    vessels: dict[str, SceneVessel] = {}
    meshes: list[SceneMesh] = []
    water = SceneWater()
    missions: dict[str, DrawnEntity] = {}
    for entity in entities:
        if entity.lifetime_s > 0.0:
            continue
        vessel, kind = _of_vessel(entity)
        if entity.frame.endswith(VESSEL_FRAME):
            known = vessels.get(vessel, SceneVessel(()))
            if kind == "propellers":
                # Their commands have the same order, and come before all other commands
                thrusters = tuple(
                    SceneThruster(_floats(place), _floats(axis), diameter_m, motor)
                    for motor, (place, axis, diameter_m) in enumerate(entity.cylinders)
                )
                vessels[vessel] = replace(known, thrusters=thrusters)
            else:
                ahead = [mesh.vertices_m[:, 0] for mesh in entity.meshes if len(mesh.vertices_m)]
                length_m = float(np.ptp(np.concatenate(ahead))) if ahead else 0.0
                length_m = length_m or known.length_m
                vessels[vessel] = replace(known, meshes=(*known.meshes, *entity.meshes), length_m=length_m)
        elif entity.frame != MAP_FRAME:
            continue
        elif kind == "water" and entity.boxes:
            middle, _ = entity.boxes[0]
            water = SceneWater(0.0, (middle[0], middle[1]))
        elif kind == "mission" and entity.lines_m:
            missions.setdefault(vessel, entity)
        else:
            meshes += entity.meshes
    for vessel, entity in missions.items():
        radius_m = 0.5 * entity.cylinders[0][2] if entity.cylinders else 0.0
        known = vessels.get(vessel, SceneVessel(()))
        vessels[vessel] = replace(known, mission_enu_m=entity.lines_m[0], acceptance_radius_m=radius_m)
    if profiles:
        lead = profiles[0]
        level_m, tide = lead.environment.water.level_m, make_tide(lead.environment)
        bounded = lead.world.river is not None
        red, green, blue = (round(255 * part) for part in water_colour(lead.environment.water_reflectivity))
        colour = red, green, blue
        water = replace(water, level_m=level_m, waves=waves_of(lead), bounded=bounded, tide=tide, colour=colour)
    for profile in profiles:
        if profile.vessel in vessels and profile.graph is not None:
            with suppress(UserError):  # of a recording whose reference profile is not on this machine
                vessels[profile.vessel] = replace(vessels[profile.vessel], wdri=profile_wdri(profile).wdri)
    return ViewScene(title, tuple(meshes), vessels, water)


def _floats(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def waves_of(profile: RunProfile) -> SceneWaves | None:
    """Return the waves of this profile's run with the same phases, None for flat water."""
    environment = profile.environment
    rng = default_rng(Seeds(profile.clock.seed).sequence("waves"))
    return scene_waves(realise_waves(environment.waves, environment.water, rng, environment.current.mean_ne_mps))


NO_WAVES = SceneWaves(np.empty(0), np.empty((0, 2)), np.empty(0), np.empty(0))
"""Flat water after waves."""


def scene_waves(field: object) -> SceneWaves | None:
    """Return a WaveField in the map's axes, None for flat water."""
    if not isinstance(field, WaveField):
        return None
    return SceneWaves(
        field.amplitude_m, field.wave_vector_radpm[:, ::-1].copy(), field.apparent_omega_radps, field.phase_rad
    )


def plain_vessel(length_m: float = PLAIN_LENGTH_M, number: int = 0) -> SceneVessel:
    """Return a plain boat for an unknown vessel. number: selects the colour."""
    colour = PLAIN_COLOURS[number % len(PLAIN_COLOURS)]
    return SceneVessel((shapes.boat(length_m).mesh("boat", colour),), length_m=length_m)
