"""Checks of several vessels in one water: free starts, separate agents, and keys that a single vessel does not have."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

from sim_core.world.spec import LogBoomSpec, RiverSpec
from xitl_cli.profile.files.entry import KeyPath, finding, shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.fleet import Offset, in_forward_starboard, in_north_east
from xitl_cli.profile.schema.world import WorldSpec


def check_alone(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield keys that only a vessel of a fleet has."""
    if profile.traffic is not None:
        yield finding("traffic", "must be in an entry of `vessels`; write vessels: {barge: {traffic: {...}}}")
    if profile.driver is not None and profile.driver.kind == "follow" and profile.vehicle is not None:
        yield finding("driver.kind", "= follow needs another vessel to follow; add vessels")


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield a fleet without a steered vessel, occupied starts, and boards that two vessels share."""
    if not profile.sailed:
        yield finding("vessels", "has only scripted vessels; add one with an autopilot, such as `own: {}`")
    # Starts: hulls must not overlap each other, land or fixed objects. Each is reported once.
    places = Places(profile.world or WorldSpec())
    for name, vessel in (profile.vessels or {}).items():
        if (hull := hull_outline(vessel)) is None:
            continue
        if (problem := places.why_taken(hull)) is not None:
            if vessel.traffic is not None:
                key, point, place = "traffic.track_ned_m", "the first point of its track", vessel.traffic.track_ned_m[0]
            else:
                assert vessel.mission is not None
                start = vessel.mission.start
                key, point, place = "mission.start", "its start", (start.north_m, start.east_m)
            sentence = f"vessels.{name}: {point} [{place[0]:g}, {place[1]:g}] {problem}"
            yield ("vessels", name, *key.split(".")), sentence
        places.add(name, hull)
    # Boards: each belongs to one vessel.
    seen: dict[str, str] = {}
    for name, vessel in profile.sailed.items():
        autopilot, companion = vessel.autopilot, vessel.companion
        links: list[tuple[KeyPath, str | None]] = []
        if autopilot is not None and autopilot.kind != "none" and autopilot.runs == "board":
            links.append((("autopilot", "link"), autopilot.link))
        if autopilot is not None and autopilot.standby is not None and autopilot.standby.runs == "board":
            links.append((("autopilot", "standby", "link"), autopilot.standby.link))
        if companion is not None and companion.runs == "board":
            links.append((("companion", "link"), companion.link))
        for path, link in links:
            other = None if link is None else seen.setdefault(link, name)
            if other not in (None, name):
                key = ".".join(map(str, path))
                yield (
                    ("vessels", name, *path),
                    f"vessels.{name}.{key} = {shown(link)} is also a board of vessels.{other}; use separate boards",
                )


Outline = tuple[Offset, ...]
"""Corners of a convex shape, north and east."""


class Places:
    """Places occupied by the boom, the dam, buildings and banks, and by the added hulls."""

    def __init__(self, world: WorldSpec) -> None:
        self._standing = list(_standing(world))
        self._river = world.river
        self._hulls: dict[str, Outline] = {}

    def add(self, name: str, hull: Outline) -> None:
        """Add a hull."""
        self._hulls[name] = hull

    def why_taken(self, hull: Outline) -> str | None:
        """Return the problem of a place and the fix, as the end of a sentence; None for a free place."""
        for name, other in self._hulls.items():
            if overlap(hull, other):
                return f"overlaps {name}; place them further apart"
        for name, other in self._standing:
            if overlap(hull, other):
                return f"is in {name}; use another place"
        if self._river is not None and aground(hull, self._river):
            return f"is aground: the river is {self._river.width_m:g} m wide there; use another place"
        return None


def hull_outline(vessel: Profile) -> Outline | None:
    """Return the rectangle around a vessel at its start; None when the profile lacks the data."""
    if vessel.traffic is not None:
        traffic = vessel.traffic
        track, heading_deg = traffic.track_ned_m, traffic.heading_deg or 0.0
        if len(track) > 1:
            heading_deg = math.degrees(math.atan2(track[1][1] - track[0][1], track[1][0] - track[0][0]))
        return box(track[0], heading_deg, traffic.length_m, traffic.beam_m)
    if vessel.vehicle is None or vessel.mission is None:
        return None
    start = vessel.mission.start
    return box((start.north_m, start.east_m), start.heading_deg, vessel.vehicle.length_m, vessel.vehicle.width_m)


def box(middle_ne_m: Offset, heading_deg: float, length_m: float, width_m: float) -> Outline:
    """Return a rectangle along a heading."""
    ends = ((1, 1), (1, -1), (-1, -1), (-1, 1))
    turned = (in_north_east((along * length_m / 2, across * width_m / 2), heading_deg) for along, across in ends)
    return tuple((middle_ne_m[0] + north_m, middle_ne_m[1] + east_m) for north_m, east_m in turned)


def overlap(one: Outline, other: Outline) -> bool:
    """Whether two convex shapes have a common point: no edge of either separates them."""
    for shape in (one, other):
        for number, corner in enumerate(shape):
            following = shape[(number + 1) % len(shape)]
            normal = following[1] - corner[1], corner[0] - following[0]
            sides = [[point[0] * normal[0] + point[1] * normal[1] for point in points] for points in (one, other)]
            if max(sides[0]) < min(sides[1]) or max(sides[1]) < min(sides[0]):
                return False
    return True


def aground(hull: Outline, river: RiverSpec) -> bool:
    """Whether a hull reaches beyond the waterlines of a river within its banks."""
    along = [
        in_forward_starboard((north_m - river.through_ne_m[0], east_m - river.through_ne_m[1]), river.direction_deg)
        for north_m, east_m in hull
    ]
    there = (
        river.along_m[0] <= min(place for place, _ in along) and max(place for place, _ in along) <= river.along_m[1]
    )
    return there and max(abs(across) for _, across in along) > river.width_m / 2


def _standing(world: WorldSpec) -> Iterator[tuple[str, Outline]]:
    """Yield fixed objects in the water that are boxes or rows of boxes."""
    if world.log_boom is not None:
        for piece in _boom(world.log_boom):
            yield "the log boom", piece
    if world.dam is not None:
        dam = world.dam
        yield "the dam", box(dam.centre_ned_m[:2], dam.heading_deg, dam.size_m[0], dam.size_m[1])
    for building in world.buildings:
        yield "a building", box(building.centre_ne_m, building.heading_deg, building.size_m[0], building.size_m[1])


def _boom(boom: LogBoomSpec) -> Iterator[Outline]:
    """Yield each stretch between two points. A boom with sag is the straight line between its anchors."""
    points = boom.points_ned_m if boom.points_ned_m is not None else boom.anchors_ne_m or ()
    if boom.anchors_ne_m is not None and boom.sag_m:
        for point in points:  # the current determines the line between the piles
            yield box((point[0], point[1]), 0.0, 2 * boom.pile_radius_m, 2 * boom.pile_radius_m)
        return
    for start, end in pairwise(points):
        middle = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
        heading_deg = math.degrees(math.atan2(end[1] - start[1], end[0] - start[0]))
        yield box(middle, heading_deg, math.dist(start[:2], end[:2]), 2 * boom.float_radius_m)
