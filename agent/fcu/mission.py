"""Missions: items as ArduPilot numbers them, with item 0 the home position, and what makes one acceptable."""

from __future__ import annotations

from typing import NamedTuple

WAYPOINT = 16  # MAV_CMD_NAV_WAYPOINT
CHANGE_SPEED = 178  # MAV_CMD_DO_CHANGE_SPEED
MOST_ITEMS = 724  # as ArduRover on a board of 16 KiB of storage


class MissionItem(NamedTuple):
    """One item. `speed_mps` counts for CHANGE_SPEED only; position and altitude for WAYPOINT only.

    `frame` (MAV_FRAME) says what the altitude is above: 0 mean sea level, 3 home. A boat does not look at it.
    """

    command: int
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    alt_m: float = 0.0
    speed_mps: float = 0.0
    frame: int = 3


class MissionError(ValueError):
    """A mission was refused; the message names the item."""


def waypoint(lat_deg: float, lon_deg: float, alt_m: float = 0.0) -> MissionItem:
    """Go to a place."""
    return MissionItem(WAYPOINT, lat_deg, lon_deg, alt_m)


def change_speed(speed_mps: float) -> MissionItem:
    """The speed over ground of the legs that follow."""
    return MissionItem(CHANGE_SPEED, speed_mps=speed_mps)


class Mission(NamedTuple):
    """A checked sequence; `items[0]` is home and is never sailed to. Build it with `mission`."""

    items: tuple[MissionItem, ...] = ()

    def waypoints(self) -> tuple[int, ...]:
        """Sequence numbers of the places to go to."""
        return tuple(seq for seq, item in enumerate(self.items) if seq > 0 and item.command == WAYPOINT)

    def next_waypoint(self, seq: int) -> int | None:
        """The first waypoint at or after `seq`, not counting home."""
        for candidate in range(max(seq, 1), len(self.items)):
            if self.items[candidate].command == WAYPOINT:
                return candidate
        return None


def mission(items: list[MissionItem] | tuple[MissionItem, ...]) -> Mission:
    """Check the items, home first; raises MissionError. One item or none is the empty mission."""
    if len(items) > MOST_ITEMS:
        raise MissionError(f"mission has {len(items)} items; at most {MOST_ITEMS} fit")
    for seq, item in enumerate(items):
        problem = item_problem(item)
        if problem and seq > 0:
            raise MissionError(f"mission item {seq}: {problem}")
    return Mission(tuple(items) if len(items) > 1 else ())


def item_problem(item: MissionItem) -> str:
    """What is wrong with an item, or nothing.

    Latitude and longitude both zero, which some tools send for "here", are refused: a boat would leave for the Gulf of
    Guinea.
    """
    if item.command == WAYPOINT:
        if not (abs(item.lat_deg) <= 90.0 and abs(item.lon_deg) <= 180.0):
            return f"position {item.lat_deg:g}, {item.lon_deg:g} is not on Earth; use degrees"
        if item.lat_deg == 0.0 and item.lon_deg == 0.0:
            return "position 0, 0 is not set"
        if not abs(item.alt_m) < 1e5:
            return f"altitude {item.alt_m:g} m is not one; use 0"
        return ""
    if item.command == CHANGE_SPEED:
        return "" if 0.0 < item.speed_mps <= 100.0 else f"speed {item.speed_mps:g} m/s; use more than 0, at most 100"
    return f"command {item.command} is not supported; use {WAYPOINT} (waypoint) or {CHANGE_SPEED} (change speed)"
