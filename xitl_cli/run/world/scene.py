"""The surroundings drawn for Foxglove and Lichtblick: log boom, dam, mission, and the vessel itself."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from foxglove import messages

from sim_core import frames
from sim_core.world.structures import LogBoom
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.place import Dam
from xitl_cli.profile.schema.vehicle import Vehicle
from xitl_cli.record.topics import MAP_FRAME, VESSEL_FRAME
from xitl_cli.run.world.scene_land import land_of
from xitl_cli.run.world.scenery import Scenery

_ORANGE = messages.Color(r=0.95, g=0.45, b=0.1, a=1.0)
_CONCRETE = messages.Color(r=0.6, g=0.6, b=0.6, a=1.0)
_CYAN = messages.Color(r=0.1, g=0.7, b=0.9, a=1.0)
_WHITE = messages.Color(r=0.92, g=0.93, b=0.95, a=1.0)
_DARK = messages.Color(r=0.2, g=0.22, b=0.25, a=1.0)
_WATER = messages.Color(r=0.35, g=0.3, b=0.2, a=0.6)
_WATER_MARGIN_M = 100.0


def scene_of(profile: RunProfile, scenery: Scenery) -> messages.SceneUpdate:
    """One update with everything that does not move against its frame."""
    entities = [_mission(profile), _vessel(profile.vehicle), _water(profile)]
    if scenery.boom is not None:
        entities.append(_log_boom(scenery.boom))
    if profile.world.dam is not None and profile.world.dam.intakes is None:
        entities.append(_dam(profile.world.dam))
    entities += land_of(profile, scenery)
    return messages.SceneUpdate(entities=entities)


def _mission(profile: RunProfile) -> messages.SceneEntity:
    start = profile.mission.start
    places = [(start.north_m, start.east_m), *profile.mission.waypoints_ned_m]
    points = [_enu(north, east, 0.0) for north, east in places]
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
    return messages.SceneEntity(frame_id=MAP_FRAME, id="mission", lines=[line], cylinders=circles)


def _vessel(vehicle: Vehicle) -> messages.SceneEntity:
    hull = vehicle.hull
    side = hull.width_m / 2 - hull.radius_m
    keel = hull.radius_m - hull.keel_below_cg_m
    along = _quaternion(pitch_rad=math.pi / 2)
    hulls = [
        messages.CylinderPrimitive(
            pose=_pose((0.0, y, keel), along),
            size=messages.Vector3(x=2 * hull.radius_m, y=2 * hull.radius_m, z=hull.length_m),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_WHITE,
        )
        for y in (side, -side)
    ]
    propellers = [
        messages.CylinderPrimitive(
            pose=_pose((forward, -right, -down), along),
            size=messages.Vector3(x=0.25 * hull.length_m, y=0.25 * hull.length_m, z=0.03 * hull.length_m),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_DARK,
        )
        for forward, right, down in (propeller.position_frd_m for propeller in vehicle.propellers)
    ]
    deck = messages.CubePrimitive(
        pose=_pose((0.0, 0.0, keel + hull.radius_m)),
        size=messages.Vector3(x=0.6 * hull.length_m, y=hull.width_m - 2 * hull.radius_m, z=0.3 * hull.radius_m),
        color=_DARK,
    )
    return messages.SceneEntity(
        frame_id=VESSEL_FRAME, id="vessel", frame_locked=True, cylinders=hulls + propellers, cubes=[deck]
    )


def _water(profile: RunProfile) -> messages.SceneEntity:
    places = [*profile.mission.waypoints_ned_m, (profile.mission.start.north_m, profile.mission.start.east_m)]
    if profile.world.log_boom is not None:
        boom = profile.world.log_boom
        places += [(point[0], point[1]) for point in boom.anchors_ne_m or boom.points_ned_m or ()]
    low, high = np.min(places, axis=0), np.max(places, axis=0)
    north, east = ((low + high) / 2).tolist()
    extent = (high - low + 2 * _WATER_MARGIN_M).tolist()
    level = profile.environment.water.level_m
    surface = messages.CubePrimitive(
        pose=_pose((east, north, level - 0.05)), size=messages.Vector3(x=extent[1], y=extent[0], z=0.01), color=_WATER
    )
    return messages.SceneEntity(frame_id=MAP_FRAME, id="water", cubes=[surface])


def _log_boom(boom: LogBoom) -> messages.SceneEntity:
    """Cylinders end to end along the line, floating half submerged, and the piles that hold them."""
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


def _dam(dam: Dam) -> messages.SceneEntity:
    length, width, height = dam.size_m
    pose = _pose(_enu(*dam.centre_ned_m), _quaternion(yaw_rad=math.radians(90.0 - dam.heading_deg)))
    box = messages.CubePrimitive(pose=pose, size=messages.Vector3(x=length, y=width, z=height), color=_CONCRETE)
    return messages.SceneEntity(frame_id=MAP_FRAME, id="dam", cubes=[box])


def _enu(north: float, east: float, down: float) -> tuple[float, float, float]:
    x, y, z = frames.ned_to_enu(np.array([north, east, down])).tolist()
    return x, y, z


def _quaternion(pitch_rad: float = 0.0, yaw_rad: float = 0.0) -> messages.Quaternion:
    w, x, y, z = frames.euler_to_quat(np.array([0.0, pitch_rad, yaw_rad])).tolist()
    return messages.Quaternion(x=x, y=y, z=z, w=w)


def _pose(position: Sequence[float], orientation: messages.Quaternion | None = None) -> messages.Pose:
    x, y, z = position
    return messages.Pose(position=messages.Vector3(x=x, y=y, z=z), orientation=orientation or _quaternion())
