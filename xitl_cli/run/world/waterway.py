"""From the profile's `world` to what vessel and debris run into, and what is put into the water when.

Meshes of a file are seen, not felt; a dam is felt as the box around it.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from sim_core.world.capsules import Capsules, box
from sim_core.world.debris import BodyKind, Launch
from sim_core.world.geometry import Box
from sim_core.world.river import Bed
from sim_core.world.structures import LogBoom
from sim_core.world.waterway import OPEN_WATER, Waterway
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema import debris as schema

_NEAR_SURFACE_M = 0.5  # what lies deeper, or hangs higher, is passed


class Scenery(Protocol):
    """What stands in the river."""

    bed: Bed
    boom: LogBoom | None
    water_down_m: float

    @property
    def boxes(self) -> tuple[Box, ...]: ...


def has_waterway(profile: RunProfile) -> bool:
    """Whether a run of this profile has more than open water: contact, or debris."""
    debris = profile.world.debris
    return bool(profile.world.contact or debris.launches or debris.encounters.count or debris.control)


def waterway_of(profile: RunProfile, scenery: Scenery) -> Waterway:
    """Open water where the profile wants neither contact nor debris."""
    if not has_waterway(profile):
        return OPEN_WATER
    parts = [] if scenery.boom is None else _boom(scenery.boom, scenery.water_down_m)
    for number, solid in enumerate(scenery.boxes):
        if _at_surface(float(solid.centre_m[2]), float(solid.size_m[2]), scenery.water_down_m):
            heading_rad = math.atan2(solid.rotation[1, 0], solid.rotation[0, 0])
            name = "dam" if profile.world.dam is not None and number == 0 else "building"
            north, east, _ = solid.centre_m.tolist()
            parts.append(box(name, (north, east), (float(solid.size_m[0]), float(solid.size_m[1])), heading_rad))
    launches = sorted((launch_of(launch) for launch in profile.world.debris.launches), key=lambda each: each.at_ns)
    return Waterway(Capsules.of(parts), scenery.bed, tuple(launches), profile.world.contact)


def launch_of(launch: schema.Launch) -> Launch:
    """A launch of the profile."""
    north_m, east_m = launch.pos_ned_m
    kind = BodyKind[launch.kind.upper()]
    return Launch(round(launch.at_s * 1e9), kind, north_m, east_m, math.radians(launch.heading_deg), launch.length_m)


def _boom(boom: LogBoom, water_down_m: float) -> list[Capsules]:
    ends = boom.ends_ned_m
    afloat = np.abs(boom.centre_ned_m[:, 2] - water_down_m) < boom.radius_m + _NEAR_SURFACE_M
    ends = ends[afloat]
    count = len(ends)
    floats = Capsules(ends[:, 0, :2], ends[:, 1, :2], np.full(count, boom.radius_m), ("log boom",) * count)
    places = np.array([pile.place_ne_m for pile in boom.piles]).reshape(-1, 2)
    radii = np.array([pile.radius_m for pile in boom.piles])
    return [floats, Capsules(places, places, radii, ("boom pile",) * len(places))]


def _at_surface(middle_down_m: float, height_m: float, water_down_m: float) -> bool:
    return abs(middle_down_m - water_down_m) < 0.5 * height_m + _NEAR_SURFACE_M
