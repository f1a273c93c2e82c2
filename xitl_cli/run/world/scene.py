"""The surroundings drawn for Foxglove and Lichtblick: structures, land, water, mission, vessel and debris.

Debris is drawn once, each body in a separate frame that moves with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from foxglove import messages

from sim_core import frames
from sim_core.vessel.sections import hull_shape
from sim_core.vessel.spec import DemiHull, Propeller, VesselSpec
from sim_core.world.debris import Body, BodyKind
from sim_core.world.geometry import MATERIALS, Mesh
from sim_core.world.river import RiverBed
from sim_core.world.structures import LogBoom
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import MAP_FRAME, VESSEL_FRAME, body_frame, vessel_name
from xitl_cli.scenery import Scenery

if TYPE_CHECKING:
    from sim_core.world.traffic import ScriptedVessel

_ORANGE = messages.Color(r=0.95, g=0.45, b=0.1, a=1.0)
_CONCRETE = messages.Color(r=0.6, g=0.6, b=0.6, a=1.0)
_CYAN = messages.Color(r=0.1, g=0.7, b=0.9, a=1.0)
_WHITE = messages.Color(r=0.92, g=0.93, b=0.95, a=1.0)
_DARK = messages.Color(r=0.2, g=0.22, b=0.25, a=1.0)
_WATER = messages.Color(r=0.35, g=0.3, b=0.2, a=0.6)
_WATER_MARGIN_M = 100.0
_ORIGIN = messages.Pose(
    position=messages.Vector3(x=0.0, y=0.0, z=0.0), orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
)
_CELL_M = 8.0
"""Grid of the drawn ground. The ground of the ray caster would be most of a short recording."""
MOST_DRAWN = 300_000
"""Triangles of one mesh. More would be most of any recording and too slow for a viewer."""
_DRAWN_OTHERWISE = ("bed", "ground", "log boom", "boom pile")
MATERIAL_COLOURS = {
    "concrete": (0.6, 0.6, 0.6),
    "steel": (0.45, 0.47, 0.5),
    "plastic": (0.95, 0.45, 0.1),
    "wood": (0.4, 0.28, 0.18),
    "leaves": (0.2, 0.45, 0.15),
    "hide": (0.45, 0.3, 0.2),
    "earth": (0.55, 0.45, 0.3),
    "rock": (0.4, 0.38, 0.36),
    "wall": (0.85, 0.82, 0.75),
    "bed": (0.3, 0.25, 0.18),
}
assert set(MATERIAL_COLOURS) == {material.name for material in MATERIALS}
BODY_COLOURS = {
    BodyKind.TRUNK: (0.4, 0.26, 0.13),
    BodyKind.BRANCH: (0.5, 0.36, 0.2),
    BodyKind.PLANTS: (0.25, 0.6, 0.2),
    BodyKind.ANIMAL: (0.55, 0.42, 0.35),
}


def make_scene(profiles: Sequence[RunProfile], scenery: Scenery) -> messages.SceneUpdate:
    """Return one update with everything that does not move in its frame. profiles: one for each vessel."""
    profile = profiles[0]
    entities = []
    for of_vessel in profiles:
        mission = of_vessel.mission
        entities.append(_mission(of_vessel, [(mission.start.north_m, mission.start.east_m), *mission.course_ned_m]))
        entities += _vessel(of_vessel.vehicle, of_vessel.vessel)
    entities.append(_water(profiles))
    if scenery.boom is not None:
        entities.append(_log_boom(scenery.boom))
    dam = profile.world.dam
    if dam is not None and dam.intakes is None:
        length, width, height = dam.size_m
        pose = _pose(_enu(*dam.centre_ned_m), _quaternion(yaw_rad=math.radians(90.0 - dam.heading_deg)))
        box = messages.CubePrimitive(pose=pose, size=messages.Vector3(x=length, y=width, z=height), color=_CONCRETE)
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


def _vessel(vehicle: VesselSpec, name: str) -> Iterator[messages.SceneEntity]:
    """Yield hulls, rudders and deck, then the propellers in their order, so that a viewer can turn them."""
    cylinders, cubes, triangles = [], [], []
    for hull in vehicle.demi_hulls:
        drawn = _hull(hull)
        if isinstance(drawn, messages.CylinderPrimitive):
            cylinders.append(drawn)
        elif isinstance(drawn, messages.CubePrimitive):
            cubes.append(drawn)
        else:
            triangles.append(drawn)
    for rudder in vehicle.rudders:
        forward, right, down = rudder.position_frd_m
        chord_m = math.sqrt(rudder.area_m2 / rudder.aspect_ratio)
        cubes.append(
            messages.CubePrimitive(
                pose=_pose((forward, -right, -down)),
                size=messages.Vector3(x=chord_m, y=0.12 * chord_m, z=rudder.aspect_ratio * chord_m),
                color=_DARK,
            )
        )
    hulls = vehicle.demi_hulls
    if len(hulls) > 1:  # the deck between the axes of the outermost hulls, on the lowest of all
        sides = [-hull.keel_frd_m[1] for hull in hulls]
        top = min(hull.height_m - hull.keel_frd_m[2] for hull in hulls)
        cubes.append(
            messages.CubePrimitive(
                pose=_pose((vehicle.midship_frd_x_m, 0.5 * (max(sides) + min(sides)), top)),
                size=messages.Vector3(
                    x=0.6 * min(hull.length_m for hull in hulls),
                    y=max(sides) - min(sides),
                    z=0.15 * min(hull.height_m for hull in hulls),
                ),
                color=_DARK,
            )
        )
    frame = vessel_name(VESSEL_FRAME, name)
    yield messages.SceneEntity(
        frame_id=frame,
        id=vessel_name("vessel", name),
        frame_locked=True,
        cylinders=cylinders,
        cubes=cubes,
        triangles=triangles,
    )
    if vehicle.propellers:
        discs = [_propeller(propeller, vehicle.length_m) for propeller in vehicle.propellers]
        yield messages.SceneEntity(
            frame_id=frame, id=vessel_name("propellers", name), frame_locked=True, cylinders=discs
        )


_ALONG_PITCH_RAD = math.pi / 2
"""Rotates an upright cylinder to lie along the vessel."""


def _hull(hull: DemiHull) -> messages.CylinderPrimitive | messages.CubePrimitive | messages.TriangleListPrimitive:
    """Draw a round hull as a cylinder and a box-shaped hull as a box; draw others by their triangles.

    A mesh that is too large becomes its bounding box.
    """
    forward, right, down = hull.keel_frd_m
    middle = (forward, -right, 0.5 * hull.height_m - down)
    if hull.prismatic and hull.section is not None and hull.section.radius_m is not None:
        return messages.CylinderPrimitive(
            pose=_pose(middle, _quaternion(pitch_rad=_ALONG_PITCH_RAD)),
            size=messages.Vector3(x=hull.width_m, y=hull.width_m, z=hull.length_m),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_WHITE,
        )
    box_shaped = hull.prismatic and hull.section is not None and hull.section.width_m is not None
    shape = hull_shape(hull)
    if box_shaped or len(shape.faces) > MOST_DRAWN:
        size = messages.Vector3(x=hull.length_m, y=hull.width_m, z=hull.height_m)
        return messages.CubePrimitive(pose=_pose(middle), size=size, color=_WHITE)
    points = frames.frd_to_flu(shape.vertices_m).tolist()
    return messages.TriangleListPrimitive(
        pose=_ORIGIN,
        points=[messages.Point3(x=x, y=y, z=z) for x, y, z in points],
        color=_WHITE,
        indices=shape.faces.ravel().tolist(),
    )


def _propeller(propeller: Propeller, length_m: float) -> messages.CylinderPrimitive:
    """Draw a disc across its thrust. Without a diameter, the disc has a visible size."""
    forward, right, down = propeller.position_frd_m
    curve = propeller.open_water
    guess_m = (0.25 if propeller.medium == "air" else 0.08) * length_m
    diameter_m = curve.diameter_m if curve is not None else propeller.diameter_m or guess_m
    return messages.CylinderPrimitive(
        pose=_pose(
            (forward, -right, -down),
            _quaternion(pitch_rad=_ALONG_PITCH_RAD, yaw_rad=-math.radians(propeller.angle_deg)),
        ),
        size=messages.Vector3(x=diameter_m, y=diameter_m, z=0.12 * diameter_m),
        bottom_scale=1.0,
        top_scale=1.0,
        color=_DARK,
    )


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
    surface = messages.CubePrimitive(
        pose=_pose((east, north, level - 0.05)), size=messages.Vector3(x=extent[1], y=extent[0], z=0.01), color=_WATER
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
                color=_ORANGE,
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
                color=_DARK,
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
        triangles = []
        for mesh in meshes:
            used, faces = np.unique(mesh.faces, return_inverse=True)
            red, green, blue = MATERIAL_COLOURS[mesh.material.name]
            points = frames.ned_to_enu(mesh.vertices_m[used]).tolist()
            triangles.append(
                messages.TriangleListPrimitive(
                    pose=_ORIGIN,
                    points=[messages.Point3(x=x, y=y, z=z) for x, y, z in points],
                    color=messages.Color(r=red, g=green, b=blue, a=1.0),
                    indices=faces.ravel().tolist(),
                )
            )
        entities.append(messages.SceneEntity(frame_id=MAP_FRAME, id=name, triangles=triangles))
    return entities


def make_scripted_scene(vessels: Sequence[ScriptedVessel]) -> messages.SceneUpdate:
    """Return the scripted vessels, each in its frame."""
    entities = []
    for vessel in vessels:
        corners = frames.frd_to_flu(vessel.mesh.vertices_m[vessel.mesh.faces].reshape(-1, 3)).tolist()
        red, green, blue = MATERIAL_COLOURS[vessel.mesh.material.name]
        triangles = messages.TriangleListPrimitive(
            pose=_ORIGIN,
            points=[messages.Point3(x=x, y=y, z=z) for x, y, z in corners],
            color=messages.Color(r=red, g=green, b=blue, a=1.0),
        )
        frame, name = vessel_name(VESSEL_FRAME, vessel.name), vessel_name("vessel", vessel.name)
        entities.append(messages.SceneEntity(frame_id=frame, id=name, frame_locked=True, triangles=[triangles]))
    return messages.SceneUpdate(entities=entities)


def make_debris_scene(bodies: Sequence[Body], first: int) -> messages.SceneUpdate:
    """Return the bodies from number `first` on."""
    entities = []
    for number, body in enumerate(bodies[first:], start=first):
        corners = frames.frd_to_flu(body.mesh.vertices_m[body.mesh.faces].reshape(-1, 3)).tolist()
        red, green, blue = BODY_COLOURS[body.kind]
        triangles = messages.TriangleListPrimitive(
            pose=_ORIGIN,
            points=[messages.Point3(x=x, y=y, z=z) for x, y, z in corners],
            color=messages.Color(r=red, g=green, b=blue, a=1.0),
        )
        frame = body_frame(number)
        entities.append(messages.SceneEntity(frame_id=frame, id=frame, frame_locked=True, triangles=[triangles]))
    return messages.SceneUpdate(entities=entities)
