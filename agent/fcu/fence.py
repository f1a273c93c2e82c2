"""Geofence: inclusion and exclusion areas from a ground station, and a circle around home."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from agent.fcu.parameters import Parameters
from agent.navigation.geodetic import Home, LocalProjection

RETURN_POINT = 5000  # MAV_CMD_NAV_FENCE_RETURN_POINT
POLYGON_IN, POLYGON_OUT = 5001, 5002  # MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, _EXCLUSION
CIRCLE_IN, CIRCLE_OUT = 5003, 5004  # MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, _EXCLUSION
FENCE_COMMANDS = (RETURN_POINT, POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT)
MOST_ITEMS = 200
BOUNDARY = 3  # FENCE_BREACH_BOUNDARY
CIRCLE_TYPE, AREAS_TYPE = 2, 4  # bits of FENCE_TYPE

Point = tuple[float, float]


class FenceItem(NamedTuple):
    """One item as in MAVLink: a corner of a polygon of `vertex_count`, a circle, or a return point."""

    command: int
    lat_deg: float
    lon_deg: float
    radius_m: float = 0.0
    vertex_count: int = 0


class FenceError(ValueError):
    """Raised for a refused fence. The message names the item."""


@dataclass(frozen=True)
class FenceBreach:
    """State of the breach, as in FENCE_STATUS."""

    outside: bool = False
    """Whether the vessel is outside now."""
    count: int = 0
    """Number of breaches."""
    kind: int = 0
    """Kind of the last breach (FENCE_BREACH)."""
    time_ns: int = 0
    """Time of the last breach."""


class _Area(NamedTuple):
    """A polygon, or a circle when it has one corner and a radius, in metres north and east."""

    inclusion: bool
    corners: tuple[Point, ...]
    radius_m: float


class Fence:
    """Fence items, and the clearance of a position: inside each inclusion area and outside each exclusion area.

    `update_breach` updates `breach`.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.items: tuple[FenceItem, ...] = ()
        self.breach = FenceBreach()
        self._parameters = parameters
        self._frame: LocalProjection | None = None
        self._areas: tuple[_Area, ...] = ()

    @property
    def enabled(self) -> bool:
        """FENCE_ENABLE."""
        return self._parameters["FENCE_ENABLE"] >= 1.0

    @property
    def names(self) -> str:
        """Names of the active fences, in ArduPilot's words."""
        kinds = int(self._parameters["FENCE_TYPE"])
        known = ((CIRCLE_TYPE, "Circle"), (AREAS_TYPE, "Polygon"))
        names = [name for kind, name in known if kinds & kind and (kind == CIRCLE_TYPE or self.items)]
        return f"{' and '.join(names)} fence{'s' if len(names) > 1 else ''}"

    def replace(self, items: Sequence[FenceItem]) -> None:
        """Replace the fence. Raises FenceError and keeps the old one when the new one is invalid."""
        check(items)
        self.items = tuple(items)
        self._frame = None

    def clearance_m(self, frame: LocalProjection, home: Home | None, lat_deg: float, lon_deg: float) -> float:
        """Distance of a position from the boundary, positive inside, negative outside, infinite without a boundary."""
        kinds = int(self._parameters["FENCE_TYPE"])
        place = frame.to_local(lat_deg, lon_deg)
        nearest_m = math.inf
        if kinds & CIRCLE_TYPE and home is not None:
            centre = frame.to_local(home.lat_deg, home.lon_deg)
            nearest_m = self._parameters["FENCE_RADIUS"] - math.hypot(place[0] - centre[0], place[1] - centre[1])
        if kinds & AREAS_TYPE:
            if frame is not self._frame:
                self._frame = frame
                self._areas = _areas(self.items, frame)
            for area in self._areas:
                if len(area.corners) == 1:
                    inside_m = area.radius_m - math.hypot(place[0] - area.corners[0][0], place[1] - area.corners[0][1])
                else:
                    inside_m = _inside_polygon_m(area.corners, *place)
                nearest_m = min(nearest_m, inside_m if area.inclusion else -inside_m)
        return nearest_m

    def update_breach(self, clearance_m: float, now_ns: int) -> bool:
        """Update the breach. Return whether it is new. A breach ends FENCE_MARGIN inside."""
        breach = self.breach
        if not self.enabled:
            clearance_m = math.inf
        if clearance_m < 0.0 and not breach.outside:
            self.breach = FenceBreach(True, min(breach.count + 1, 65535), BOUNDARY, now_ns)
            return True
        if breach.outside and clearance_m >= self._parameters["FENCE_MARGIN"]:
            self.forget_breach()
        return False

    def forget_breach(self) -> None:
        """End the breach. The next position outside is a new breach."""
        self.breach = replace(self.breach, outside=False)


def check(items: Sequence[FenceItem]) -> None:
    """Check a fence. Raises FenceError."""
    if len(items) > MOST_ITEMS:
        raise FenceError(f"fence has {len(items)} items; at most {MOST_ITEMS} fit")
    at = 0
    while at < len(items):
        item = items[at]
        for number, corner in enumerate(items[at : at + _length(item)], start=at):
            problem = fence_item_problem(corner)
            if not problem and (corner.command, corner.vertex_count) != (item.command, item.vertex_count):
                problem = f"a polygon of {item.vertex_count} corners ends early"
            if problem:
                raise FenceError(f"fence item {number}: {problem}")
        if at + _length(item) > len(items):
            raise FenceError(f"fence item {len(items) - 1}: a polygon of {item.vertex_count} corners ends early")
        at += _length(item)


def fence_item_problem(item: FenceItem) -> str:
    """Return the error of an item, or an empty text."""
    if item.command not in FENCE_COMMANDS:
        return f"command {item.command} is not supported; use {RETURN_POINT} to {CIRCLE_OUT}"
    if not (abs(item.lat_deg) <= 90.0 and abs(item.lon_deg) <= 180.0):
        return f"position {item.lat_deg:g}, {item.lon_deg:g} is not on Earth; use degrees"
    if item.command in (POLYGON_IN, POLYGON_OUT) and item.vertex_count < 3:
        return f"a polygon of {item.vertex_count} corners; use at least 3"
    if item.command in (CIRCLE_IN, CIRCLE_OUT) and not 0.0 < item.radius_m < 1e6:
        return f"radius {item.radius_m:g} m; use more than 0"
    return ""


def _length(item: FenceItem) -> int:
    return max(1, item.vertex_count) if item.command in (POLYGON_IN, POLYGON_OUT) else 1


def _areas(items: tuple[FenceItem, ...], frame: LocalProjection) -> tuple[_Area, ...]:
    areas = []
    at = 0
    while at < len(items):
        item, length = items[at], _length(items[at])
        if item.command != RETURN_POINT:
            corners = tuple(frame.to_local(corner.lat_deg, corner.lon_deg) for corner in items[at : at + length])
            radius_m = item.radius_m if item.command in (CIRCLE_IN, CIRCLE_OUT) else 0.0
            areas.append(_Area(item.command in (POLYGON_IN, CIRCLE_IN), corners, radius_m))
        at += length
    return tuple(areas)


def _inside_polygon_m(corners: tuple[Point, ...], north_m: float, east_m: float) -> float:
    """Distance to the nearest side, negative outside. Inside is decided by counting the sides crossed to the east."""
    inside = False
    nearest2 = math.inf
    n1, e1 = corners[-1]
    n1, e1 = n1 - north_m, e1 - east_m
    for n2, e2 in corners:
        n2, e2 = n2 - north_m, e2 - east_m
        dn, de = n2 - n1, e2 - e1
        length2 = dn * dn + de * de
        part = 0.0 if length2 == 0.0 else min(max(-(n1 * dn + e1 * de) / length2, 0.0), 1.0)
        n, e = n1 + part * dn, e1 + part * de
        nearest2 = min(nearest2, n * n + e * e)
        if (n1 > 0.0) != (n2 > 0.0) and e1 - n1 * de / dn > 0.0:
            inside = not inside
        n1, e1 = n2, e2
    distance_m = math.sqrt(nearest2)
    return distance_m if inside else -distance_m
