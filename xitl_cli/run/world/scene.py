"""The surroundings drawn for Foxglove and Lichtblick: structures, land, water, mission, vessel and debris.

Debris is drawn once, each body in a separate frame that moves with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from foxglove import messages

from sim_core import frames
from sim_core.frames import Array
from sim_core.vessel.spec import Propeller
from sim_core.world.debris import Body
from sim_core.world.geometry import Mesh, merged
from sim_core.world.river import RiverBed
from sim_core.world.structures import LogBoom
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import MAP_FRAME, VESSEL_FRAME, body_frame, vessel_name
from xitl_cli.run.world.colours import MATERIAL_COLOURS, PAINTS, Rgb, coloured_parts, ground_colours, water_colour
from xitl_cli.run.world.vessel_shape import MOST_DRAWN, drawn_diameter_m, vessel_parts
from xitl_cli.scenery import Scenery

if TYPE_CHECKING:
    from sim_core.world.traffic import ScriptedVessel

_CYAN = messages.Color(r=0.1, g=0.7, b=0.9, a=1.0)
_DISC = messages.Color(r=0.13, g=0.14, b=0.16, a=0.4)
_WATER_OPACITY = 0.6
_WATER_MARGIN_M = 100.0
_ORIGIN = messages.Pose(
    position=messages.Vector3(x=0.0, y=0.0, z=0.0), orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
)
_CELL_M = 8.0
"""Grid of the drawn ground. The ground of the ray caster would be most of a short recording."""
_DRAWN_OTHERWISE = ("bed", "ground", "log boom", "boom pile")


def make_scene(profiles: Sequence[RunProfile], scenery: Scenery) -> messages.SceneUpdate:
    """Return one update with everything that does not move in its frame. profiles: one for each vessel."""
    profile = profiles[0]
    entities = []
    for of_vessel in profiles:
        mission = of_vessel.mission
        entities.append(_mission(of_vessel, [(mission.start.north_m, mission.start.east_m), *mission.course_ned_m]))
        entities += _vessel(of_vessel)
    entities.append(_water(profiles))
    if scenery.boom is not None:
        entities.append(_log_boom(scenery.boom))
    dam = profile.world.dam
    if dam is not None and dam.intakes is None:
        length, width, height = dam.size_m
        pose = _pose(_enu(*dam.centre_ned_m), _quaternion(yaw_rad=math.radians(90.0 - dam.heading_deg)))
        concrete = _colour(MATERIAL_COLOURS["concrete"])
        box = messages.CubePrimitive(pose=pose, size=messages.Vector3(x=length, y=width, z=height), color=concrete)
        entities.append(messages.SceneEntity(frame_id=MAP_FRAME, id="dam", cubes=[box]))
    entities += _land(profile, scenery)
    return messages.SceneUpdate(entities=entities)


def make_water_scene(profiles: Sequence[RunProfile], tide_m: float) -> messages.SceneUpdate:
    """Return the water at another level, to replace the water drawn before. tide_m: above the mean level."""
    return messages.SceneUpdate(entities=[_water(profiles, tide_m)])


def make_mission_scene(profile: RunProfile, places_ne_m: Sequence[tuple[float, float]]) -> messages.SceneUpdate:
    """Return another mission to replace the profile's: the start, then the waypoints."""
    return messages.SceneUpdate(entities=[_mission(profile, places_ne_m)])


def _mission(profile: RunProfile, places_ne_m: Sequence[tuple[float, float]]) -> messages.SceneEntity:
    points = [_enu(north, east, 0.0) for north, east in places_ne_m]
    line = messages.LinePrimitive(
        points=[messages.Point3(x=x, y=y, z=0.1) for x, y, _ in points],
        thickness=2.0,
        scale_invariant=True,
        color=_CYAN,
    )
    radius = profile.mission.acceptance_radius_m
    circles = [
        messages.CylinderPrimitive(
            pose=_pose((x, y, 0.05)),
            size=messages.Vector3(x=2 * radius, y=2 * radius, z=0.1),
            bottom_scale=1.0,
            top_scale=1.0,
            color=messages.Color(r=0.1, g=0.7, b=0.9, a=0.3),
        )
        for x, y, _ in points[1:]
    ]
    name = vessel_name("mission", profile.vessel)
    return messages.SceneEntity(frame_id=MAP_FRAME, id=name, lines=[line], cylinders=circles)


def _vessel(profile: RunProfile) -> Iterator[messages.SceneEntity]:
    """Yield the vessel, then the discs of its propellers in their order, so that a viewer can turn them."""
    vehicle, name = profile.vehicle, profile.vessel
    frame = vessel_name(VESSEL_FRAME, name)
    by_paint: dict[str, list[Mesh]] = {}
    for part in vessel_parts(vehicle, profile.environment.water):
        by_paint.setdefault(part.paint, []).append(part.mesh)
    triangles = [
        _triangles(merged(meshes), frames.frd_to_flu, _colour(PAINTS[paint])) for paint, meshes in by_paint.items()
    ]
    yield messages.SceneEntity(frame_id=frame, id=vessel_name("vessel", name), frame_locked=True, triangles=triangles)
    if vehicle.propellers:
        discs = [_propeller(propeller, vehicle.length_m) for propeller in vehicle.propellers]
        yield messages.SceneEntity(
            frame_id=frame, id=vessel_name("propellers", name), frame_locked=True, cylinders=discs
        )


_ALONG_PITCH_RAD = math.pi / 2
"""Rotates an upright cylinder to lie along the vessel."""


def _propeller(propeller: Propeller, length_m: float) -> messages.CylinderPrimitive:
    """Draw a disc across its thrust. Without a diameter, the disc has a visible size."""
    forward, right, down = propeller.position_frd_m
    diameter_m = drawn_diameter_m(propeller, length_m)
    return messages.CylinderPrimitive(
        pose=_pose(
            (forward, -right, -down),
            _quaternion(pitch_rad=_ALONG_PITCH_RAD, yaw_rad=-math.radians(propeller.angle_deg)),
        ),
        size=messages.Vector3(x=diameter_m, y=diameter_m, z=0.12 * diameter_m),
        bottom_scale=1.0,
        top_scale=1.0,
        color=_DISC,
    )


def _triangles(mesh: Mesh, placed: Callable[[Array], Array], colour: messages.Color) -> messages.TriangleListPrimitive:
    """Return the used vertices of a mesh and its faces. placed: from the axes of the mesh to those of the frame."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    points = placed(mesh.vertices_m[used]).tolist()
    return messages.TriangleListPrimitive(
        pose=_ORIGIN,
        points=[messages.Point3(x=x, y=y, z=z) for x, y, z in points],
        color=colour,
        indices=faces.ravel().tolist(),
    )


def _colour(rgb: Rgb) -> messages.Color:
    red, green, blue = rgb
    return messages.Color(r=red, g=green, b=blue, a=1.0)


def _water(profiles: Sequence[RunProfile], tide_m: float = 0.0) -> messages.SceneEntity:
    profile = profiles[0]
    places = []
    for of_vessel in profiles:
        mission = of_vessel.mission
        places += [*mission.course_ned_m, (mission.start.north_m, mission.start.east_m)]
    if profile.world.log_boom is not None:
        boom = profile.world.log_boom
        places += [(point[0], point[1]) for point in boom.anchors_ne_m or boom.points_ned_m or ()]
    low, high = np.min(places, axis=0), np.max(places, axis=0)
    north, east = ((low + high) / 2).tolist()
    extent = (high - low + 2 * _WATER_MARGIN_M).tolist()
    level = profile.environment.water.level_m + tide_m
    red, green, blue = water_colour(profile.environment.water_reflectivity)
    surface = messages.CubePrimitive(
        pose=_pose((east, north, level - 0.05)),
        size=messages.Vector3(x=extent[1], y=extent[0], z=0.01),
        color=messages.Color(r=red, g=green, b=blue, a=_WATER_OPACITY),
    )
    return messages.SceneEntity(frame_id=MAP_FRAME, id="water", cubes=[surface])


def _log_boom(boom: LogBoom) -> messages.SceneEntity:
    """Draw cylinders end to end along the line, floating half submerged, and the piles that hold them."""
    floats = []
    for centre, along, length in zip(
        boom.centre_ned_m.tolist(), boom.along_ne.tolist(), boom.length_m.tolist(), strict=True
    ):
        floats.append(
            messages.CylinderPrimitive(
                pose=_pose(_enu(*centre), _quaternion(pitch_rad=math.pi / 2, yaw_rad=math.atan2(*along))),
                size=messages.Vector3(x=2 * boom.radius_m, y=2 * boom.radius_m, z=length),
                bottom_scale=1.0,
                top_scale=1.0,
                color=_colour(PAINTS["boom"]),
            )
        )
    for pile in boom.piles:
        middle = (pile.top_down_m + pile.bottom_down_m) / 2
        floats.append(
            messages.CylinderPrimitive(
                pose=_pose(_enu(*pile.place_ne_m, middle)),
                size=messages.Vector3(x=2 * pile.radius_m, y=2 * pile.radius_m, z=pile.bottom_down_m - pile.top_down_m),
                bottom_scale=1.0,
                top_scale=1.0,
                color=_colour(MATERIAL_COLOURS["steel"]),
            )
        )
    return messages.SceneEntity(frame_id=MAP_FRAME, id="log boom", cylinders=floats)


def _enu(north: float, east: float, down: float) -> tuple[float, float, float]:
    x, y, z = frames.ned_to_enu(np.array([north, east, down])).tolist()
    return x, y, z


def _quaternion(pitch_rad: float = 0.0, yaw_rad: float = 0.0) -> messages.Quaternion:
    w, x, y, z = frames.euler_to_quat(np.array([0.0, pitch_rad, yaw_rad])).tolist()
    return messages.Quaternion(x=x, y=y, z=z, w=w)


def _pose(position: Sequence[float], orientation: messages.Quaternion | None = None) -> messages.Pose:
    x, y, z = position
    return messages.Pose(position=messages.Vector3(x=x, y=y, z=z), orientation=orientation or _quaternion())


def _land(profile: RunProfile, scenery: Scenery) -> list[messages.SceneEntity]:
    """Draw the fixed objects without the boom. Returns none for a world with only a boom and a plain dam.

    A mesh of more than MOST_DRAWN triangles is left out, with a warning of the scenery.
    """
    world, by_name = profile.world, dict[str, list[Mesh]]()
    plain = world.dam is None or world.dam.intakes is None
    if plain and world.river is None and not (world.shoals or world.buildings or world.meshes):
        return []
    if isinstance(scenery.bed, RiverBed):
        by_name["ground"] = scenery.bed.meshes(_CELL_M)
    for part in scenery.scene.parts:
        if part.name in _DRAWN_OTHERWISE or (plain and part.name == "dam"):
            continue
        if len(part.mesh.faces) > MOST_DRAWN:
            scenery.warn(
                f"{part.name} has {len(part.mesh.faces)} triangles and is not drawn in the recording; sensors detect it"
            )
            continue
        by_name.setdefault(part.name, []).append(part.mesh)
    entities = []
    for name, meshes in by_name.items():
        triangles = [
            _triangles(shown, frames.ned_to_enu, _colour(colour))
            for mesh in meshes
            for shown, colour in (
                ground_colours(mesh, scenery.water_down_m)
                if name == "ground"
                else [(mesh, MATERIAL_COLOURS[mesh.material.name])]
            )
        ]
        entities.append(messages.SceneEntity(frame_id=MAP_FRAME, id=name, triangles=triangles))
    return entities


def make_scripted_scene(vessels: Sequence[ScriptedVessel]) -> messages.SceneUpdate:
    """Return the scripted vessels, each in its frame."""
    entities = []
    for vessel in vessels:
        triangles = _triangles(vessel.mesh, frames.frd_to_flu, _colour(MATERIAL_COLOURS[vessel.mesh.material.name]))
        frame, name = vessel_name(VESSEL_FRAME, vessel.name), vessel_name("vessel", vessel.name)
        entities.append(messages.SceneEntity(frame_id=frame, id=name, frame_locked=True, triangles=[triangles]))
    return messages.SceneUpdate(entities=entities)


def make_debris_scene(bodies: Sequence[Body], first: int) -> messages.SceneUpdate:
    """Return the bodies from number `first` on."""
    entities = []
    for number, body in enumerate(bodies[first:], start=first):
        triangles = [_triangles(mesh, frames.frd_to_flu, _colour(colour)) for mesh, colour in coloured_parts(body)]
        frame = body_frame(number)
        entities.append(messages.SceneEntity(frame_id=frame, id=frame, frame_locked=True, triangles=triangles))
    return messages.SceneUpdate(entities=entities)
