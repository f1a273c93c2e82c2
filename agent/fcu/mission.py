"""Missions: items as ArduPilot numbers them, with item 0 the home position, and what makes one acceptable."""

from __future__ import annotations

import math
from typing import NamedTuple

WAYPOINT = 16  # MAV_CMD_NAV_WAYPOINT
LOITER_UNLIMITED = 17  # MAV_CMD_NAV_LOITER_UNLIM
LOITER_TIME = 19  # MAV_CMD_NAV_LOITER_TIME
RETURN_HOME = 20  # MAV_CMD_NAV_RETURN_TO_LAUNCH
JUMP = 177  # MAV_CMD_DO_JUMP
CHANGE_SPEED = 178  # MAV_CMD_DO_CHANGE_SPEED
MOST_ITEMS = 724  # as ArduRover on a board of 16 KiB of storage
FOREVER = -1
_LONGEST_S = 65535.0

PLACES = (WAYPOINT, LOITER_UNLIMITED, LOITER_TIME)  # items with a position
LEGS = (*PLACES, RETURN_HOME)  # items to go to
SUPPORTED = {
    WAYPOINT: "waypoint",
    LOITER_UNLIMITED: "loiter",
    LOITER_TIME: "loiter for a time",
    RETURN_HOME: "return home",
    JUMP: "jump",
    CHANGE_SPEED: "change speed",
}


class MissionItem(NamedTuple):
    """One item; the fields from `speed_mps` on count for the commands that have them.

    `frame` (MAV_FRAME) says what the altitude is above: 0 mean sea level, 3 home. A boat does not look at it.
    `hold_s` is how long to stay at a WAYPOINT or LOITER_TIME. A JUMP goes on from item `jump_seq`, `repeats` times or
    FOREVER.
    """

    command: int
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    alt_m: float = 0.0
    speed_mps: float = 0.0
    frame: int = 3
    hold_s: float = 0.0
    jump_seq: int = 0
    repeats: int = 0


class MissionError(ValueError):
    """A mission was refused; the message names the item."""


def waypoint(lat_deg: float, lon_deg: float, alt_m: float = 0.0, hold_s: float = 0.0) -> MissionItem:
    """Go to a place, and stay there for so long."""
    return MissionItem(WAYPOINT, lat_deg, lon_deg, alt_m, hold_s=hold_s)


def change_speed(speed_mps: float) -> MissionItem:
    """The speed over ground of the legs that follow."""
    return MissionItem(CHANGE_SPEED, speed_mps=speed_mps)


def jump(seq: int, repeats: int) -> MissionItem:
    """Go on from item `seq`."""
    return MissionItem(JUMP, jump_seq=seq, repeats=repeats)


def mission_item(
    command: int, parameters: tuple[float, ...], lat_deg: float, lon_deg: float, alt_m: float, frame: int
) -> MissionItem:
    """An item from MAVLink's fields, param1 to param4 in `parameters`; to be checked by `item_problem`."""
    first, second = parameters[0], parameters[1]
    if command == CHANGE_SPEED:
        return MissionItem(command, speed_mps=second, frame=frame)
    if command == JUMP:
        return MissionItem(command, jump_seq=_whole(first), repeats=_whole(second, FOREVER - 1), frame=frame)
    if command == RETURN_HOME:
        return MissionItem(command, frame=frame)
    hold_s = first if command in (WAYPOINT, LOITER_TIME) and not math.isnan(first) else 0.0
    return MissionItem(command, lat_deg, lon_deg, alt_m, frame=frame, hold_s=hold_s)


def item_parameters(item: MissionItem) -> tuple[float, float, float, float]:
    """MAVLink's param1 to param4 of an item."""
    if item.command == CHANGE_SPEED:
        return 1.0, item.speed_mps, -1.0, 0.0  # speed over ground, throttle unchanged
    if item.command == JUMP:
        return float(item.jump_seq), float(item.repeats), 0.0, 0.0
    return item.hold_s, 0.0, 0.0, 0.0


class MissionSequence(NamedTuple):
    """A checked sequence; `items[0]` is home and is never gone to. Build it with `make_mission`."""

    items: tuple[MissionItem, ...] = ()

    def waypoints(self) -> tuple[int, ...]:
        """Sequence numbers of the items to go to."""
        return tuple(seq for seq, item in enumerate(self.items) if seq > 0 and item.command in LEGS)

    def next_waypoint(self, seq: int) -> int | None:
        """The first item to go to at or after `seq`, not counting home and jumps."""
        for candidate in range(max(seq, 1), len(self.items)):
            if self.items[candidate].command in LEGS:
                return candidate
        return None


def make_mission(items: list[MissionItem] | tuple[MissionItem, ...]) -> MissionSequence:
    """Check the items, home first; raises MissionError. One item or none is the empty mission."""
    if len(items) > MOST_ITEMS:
        raise MissionError(f"mission has {len(items)} items; at most {MOST_ITEMS} fit")
    for seq, item in enumerate(items):
        problem = item_problem(item, len(items))
        if problem and seq > 0:
            raise MissionError(f"mission item {seq}: {problem}")
    return MissionSequence(tuple(items) if len(items) > 1 else ())


def item_problem(item: MissionItem, count: int = MOST_ITEMS) -> str:
    """What is wrong with an item of a mission of `count`, or nothing.

    Latitude and longitude both zero, which some tools send for "here", are refused but for loitering: a boat would
    leave for the Gulf of Guinea.
    """
    if item.command in PLACES:
        if item.lat_deg == 0.0 and item.lon_deg == 0.0:
            if item.command == WAYPOINT:
                return "position 0, 0 is not set"
        elif not (abs(item.lat_deg) <= 90.0 and abs(item.lon_deg) <= 180.0):
            return f"position {item.lat_deg:g}, {item.lon_deg:g} is not on Earth; use degrees"
        if not abs(item.alt_m) < 1e5:
            return f"altitude {item.alt_m:g} m is not one; use 0"
        return "" if 0.0 <= item.hold_s <= _LONGEST_S else f"time {item.hold_s:g} s; use 0 to {_LONGEST_S:g}"
    if item.command == CHANGE_SPEED:
        return "" if 0.0 < item.speed_mps <= 100.0 else f"speed {item.speed_mps:g} m/s; use more than 0, at most 100"
    if item.command == JUMP:
        if not 1 <= item.jump_seq < count:
            return f"jump to item {item.jump_seq}; use 1 to {count - 1}"
        return "" if FOREVER <= item.repeats <= 32767 else f"jump {item.repeats} times; use up to 32767, or -1 for ever"
    if item.command == RETURN_HOME:
        return ""
    supported = ", ".join(f"{command} ({name})" for command, name in SUPPORTED.items())
    return f"command {item.command} is not supported; use {supported}"


def _whole(value: float, otherwise: int = -1) -> int:
    return int(value) if math.isfinite(value) and value == int(value) and abs(value) < 1e6 else otherwise
