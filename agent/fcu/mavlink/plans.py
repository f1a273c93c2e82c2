"""Plans that stations transfer, mission and fence: conversion between MAVLink items and the autopilot's items."""

from __future__ import annotations

from typing import Callable

from agent.fcu.fence import CIRCLE_IN, CIRCLE_OUT, POLYGON_IN, POLYGON_OUT, RETURN_POINT, FenceItem
from agent.fcu.fence import MOST_ITEMS as MOST_FENCE_ITEMS
from agent.fcu.mission import COMMANDS, MOST_ITEMS, WAYPOINT, MissionError, MissionItem, item_problem, make_mission
from agent.fcu.vehicle.autopilot import Autopilot
from agent.mavlink.missions import PlanItem, RefusedItem
from agent.wire import dialect as mav

_FENCE_COMMANDS = (RETURN_POINT, POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT)
_FRAMES = {0: 0, 2: 0, 3: 3, 5: 0, 6: 3, 10: 10, 11: 10}  # the _INT frames are equivalent
_FENCE_FRAMES = (0, 3, 5, 6)
_RESERVED = (0, 1)  # not commands


class MissionPlan:
    """The mission. Item 0 is home: any uploaded item 0 is accepted, and the real home is returned.

    stored: called after a change.
    """

    name = "Mission"
    most = MOST_ITEMS

    def __init__(self, autopilot: Autopilot, stored: Callable[[], object]) -> None:
        self._autopilot = autopilot
        self._stored = stored

    def items(self) -> list[MissionItem]:
        return list(self._autopilot.navigator.mission.items)

    def current(self) -> int:
        return self._autopilot.navigator.progress.current

    def read(self, item: PlanItem) -> MissionItem | RefusedItem:
        if item.seq == 0:
            alt_m = item.alt_m if abs(item.alt_m) < 1e5 else 0.0
            if not (abs(item.lat_deg) <= 90.0 and abs(item.lon_deg) <= 180.0):
                return MissionItem(WAYPOINT)
            return MissionItem(WAYPOINT, item.lat_deg, item.lon_deg, alt_m, frame=_FRAMES.get(item.frame, 3))
        return mission_item_from(item)

    def write(self, seq: int) -> PlanItem:
        item = self._autopilot.navigator.mission.items[seq]
        home = self._autopilot.navigator.home
        if seq == 0 and home is not None:
            item = MissionItem(WAYPOINT, home.lat_deg, home.lon_deg, home.alt_m, frame=0)
        return PlanItem(seq, item.frame, item.command, item.parameters, item.lat_deg, item.lon_deg, item.alt_m)

    def guide(self, item: PlanItem) -> RefusedItem | None:
        """Go to the item's position in GUIDED.

        Return the reason of a refusal; the autopilot's own refusals are already events.
        """
        made = mission_item_from(item)
        if isinstance(made, RefusedItem):
            return made
        if not self._autopilot.in_guided:
            return RefusedItem(int(mav.MAV_MISSION_ERROR), "not in GUIDED")
        refused = self._autopilot.commands.go_to(made.lat_deg, made.lon_deg)
        return RefusedItem(int(mav.MAV_MISSION_ERROR), "") if refused else None

    def store(self, items: list[MissionItem], in_part: bool) -> RefusedItem | None:
        """Store a mission. A partly changed one continues at the current item."""
        current = self.current()
        try:
            self._autopilot.commands.set_mission(make_mission(items))
        except MissionError as error:
            return RefusedItem(int(mav.MAV_MISSION_ERROR), str(error))
        if in_part and current > 0:
            self._autopilot.commands.set_current(current)
        self._stored()
        return None


def mission_item_from(item: PlanItem) -> MissionItem | RefusedItem:
    """Return the autopilot's item, or the reason why ArduRover refuses it."""
    frame = _FRAMES.get(item.frame, item.frame)
    made = MissionItem(item.command, item.lat_deg, item.lon_deg, item.alt_m, item.parameters, frame)
    problem = item_problem(made)
    if problem is None:
        if COMMANDS[item.command].has_place and item.frame not in _FRAMES:
            known = ", ".join(map(str, _FRAMES))
            text = f"frame {item.frame} is not supported; use {known}"
            return RefusedItem(int(mav.MAV_MISSION_UNSUPPORTED_FRAME), text)
        return made
    result = int(mav.MAV_MISSION_INVALID if item.command in _RESERVED else mav.MAV_MISSION_UNSUPPORTED)
    if problem.field:
        result = int(mav.MAV_MISSION_INVALID_PARAM1) + problem.field - 1
    return RefusedItem(result, problem.text)


class FencePlan:
    """Fence of circles and polygons, without a home item. stored: called after a change."""

    name = "Fence"
    most = MOST_FENCE_ITEMS

    def __init__(self, autopilot: Autopilot, stored: Callable[[], object]) -> None:
        self._autopilot = autopilot
        self._stored = stored

    def items(self) -> list[FenceItem]:
        return list(self._autopilot.fence.items)

    def current(self) -> int:
        return -1

    def read(self, item: PlanItem) -> FenceItem | RefusedItem:
        if item.command not in _FENCE_COMMANDS:
            known = ", ".join(str(command) for command in _FENCE_COMMANDS)
            return RefusedItem(
                int(mav.MAV_MISSION_UNSUPPORTED), f"command {item.command} is not supported; use {known}"
            )
        if item.frame not in _FENCE_FRAMES:
            problem = f"frame {item.frame} is not supported; use 0, 3, 5 or 6"
            return RefusedItem(int(mav.MAV_MISSION_UNSUPPORTED_FRAME), problem)
        if not (abs(item.lat_deg) <= 90.0 and abs(item.lon_deg) <= 180.0):
            problem = f"position {item.lat_deg:g}, {item.lon_deg:g} is not on Earth; use degrees"
            return RefusedItem(int(mav.MAV_MISSION_INVALID), problem)
        first = item.parameters[0]
        if item.command in (CIRCLE_IN, CIRCLE_OUT):
            return FenceItem(item.command, item.lat_deg, item.lon_deg, radius_m=first)
        corners = int(first) if 0.0 <= first <= 1e4 and first == int(first) else 0
        return FenceItem(item.command, item.lat_deg, item.lon_deg, vertex_count=corners)

    def write(self, seq: int) -> PlanItem:
        item = self.items()[seq]
        first = float(item.vertex_count) if item.vertex_count else item.radius_m
        return PlanItem(seq, 0, item.command, (first, 0.0, 0.0, 0.0), item.lat_deg, item.lon_deg, 0.0)

    def store(self, items: list[FenceItem], in_part: bool) -> RefusedItem | None:
        problem = self._autopilot.commands.set_fence(items)
        if problem:
            return RefusedItem(int(mav.MAV_MISSION_INVALID), problem)
        self._stored()
        return None
