"""Missions of ground stations: QGroundControl's `.plan`, and the text format QGC WPL of Mission Planner and others.

Sources: docs.qgroundcontrol.com, Plan File Format; mavlink.io, File Formats.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from agent.fcu.fence import CIRCLE_IN, CIRCLE_OUT, POLYGON_IN, POLYGON_OUT, RETURN_POINT
from agent.fcu.mission import JUMP
from xitl_cli.profile.missions.course import (
    NO_PLACE,
    RALLY_POINT,
    Course,
    FileItem,
    MissionFileError,
    mavlink_item,
    place_of,
    sorted_course,
)

WPL_COLUMNS = 12
_WPL_VERSIONS = ("100", "110", "120")


def read_plan(text: str) -> Course:
    """Return the mission, fence and rally points of a `.plan`.

    The planned home is ignored: the vessel has `mission.start`.

    A survey or a corridor scan gives the items that the station has generated. Raises MissionFileError.
    """
    plan = read_json(text)
    if not isinstance(plan, dict) or plan.get("fileType") != "Plan":
        raise MissionFileError('is not a plan of QGroundControl ("fileType": "Plan" is missing); save the plan again')
    mission = _member(plan, "mission", dict, "")
    rally = plan.get("rallyPoints") or {}
    if not isinstance(rally, dict):
        raise MissionFileError("rallyPoints is not an object; save the plan again")
    rally_points = []
    for number, point in enumerate(_optional_list(rally, "points", "rallyPoints")):
        where = f"rallyPoints.points.{number}"
        rally_points.append(FileItem(RALLY_POINT, place_deg=_pair(point, where), where=where))
    items = list(_plan_items(_member(mission, "items", list, "mission"), "mission.items"))
    fence = tuple(_plan_fence(plan.get("geoFence") or {}))
    return Course(tuple(_with_sequence_numbers(items)), fence, tuple(rally_points))


def read_json(text: str) -> Any:
    """Return the value of a JSON text. Raises MissionFileError with the line."""
    try:
        return json.loads(text, parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        raise MissionFileError(f"is not valid JSON: {error.msg}, column {error.colno}", error.lineno) from None
    except RecursionError:
        raise MissionFileError("is nested too deeply; save it again from the program it was drawn in") from None
    except ValueError as error:  # a number with too many digits
        raise MissionFileError(f"is not valid JSON: {error}") from None


def number_of(value: Any, where: str) -> float:
    """Return the finite number of a JSON value. Raises MissionFileError."""
    if not isinstance(value, (int, float)) or isinstance(value, bool) or abs(value) > 1e300:
        raise MissionFileError(f"{where} = {str(value)[:40]} is not a number; write a number")
    return float(value)


def _refuse_constant(word: str) -> None:
    raise MissionFileError(f"contains {word}, which is not a number in JSON; replace it")


def _member(group: Mapping[str, Any], key: str, kind: type, where: str) -> Any:
    value = group.get(key)
    if not isinstance(value, kind):
        expected = "an object" if kind is dict else "a list"
        path = f"{where}.{key}" if where else key
        raise MissionFileError(f"{path} is missing or is not {expected}; save the plan again")
    return value


def _optional_list(group: Mapping[str, Any], key: str, where: str) -> list[Any]:
    items: list[Any] = _member({key: group.get(key) or []}, key, list, where)
    return items


def _plan_items(items: list[Any], path: str) -> Iterator[tuple[FileItem, Any]]:
    """Yield each item with its doJumpId."""
    for number, item in enumerate(items):
        where = f"{path}.{number}"
        if not isinstance(item, dict):
            raise MissionFileError(f"{where} is not an object; save the plan again")
        if item.get("type") == "ComplexItem":
            generated = item.get("TransectStyleComplexItem")
            if not isinstance(generated, dict) or not isinstance(generated.get("Items"), list):
                kind = str(item.get("complexItemType"))[:40]
                fix = "replace it by waypoints, a survey or a corridor scan"
                raise MissionFileError(f"{where} is a complex item, {kind!r}, which xitl does not support; {fix}")
            yield from _plan_items(generated["Items"], f"{where}.TransectStyleComplexItem.Items")
            continue
        command, frame = (int(number_of(item.get(key), f"{where}.{key}")) for key in ("command", "frame"))
        params = _member(item, "params", list, where)
        if len(params) != 7:
            raise MissionFileError(f"{where}.params has {len(params)} entries; MAVLink has 7")
        numbers = tuple(
            None if value is None else number_of(value, f"{where}.params.{index}") for index, value in enumerate(params)
        )
        yield mavlink_item(command, frame, numbers, where), item.get("doJumpId")


def _with_sequence_numbers(items: list[tuple[FileItem, Any]]) -> Iterator[FileItem]:
    """Convert the target of jumps: the file has the doJumpId of an item, the mission on board its number."""
    by_id = {identifier: seq for seq, (_, identifier) in enumerate(items, start=1) if isinstance(identifier, int)}
    for item, _ in items:
        if item.command != JUMP or not by_id:
            yield item
            continue
        target = int(item.parameters[0] or 0)
        if target not in by_id:
            raise MissionFileError(f"{item.where}: jumps to item {target}, which does not exist; use a doJumpId")
        yield replace(item, parameters=(float(by_id[target]), *item.parameters[1:]))


def _plan_fence(fence: Any) -> Iterator[FileItem]:
    if not isinstance(fence, dict):
        raise MissionFileError("geoFence is not an object; save the plan again")
    if isinstance(fence.get("polygon"), list) and fence["polygon"]:
        raise MissionFileError("geoFence is of version 1; open the plan in QGroundControl and save it again")
    for number, shape in enumerate(_optional_list(fence, "polygons", "geoFence")):
        where = f"geoFence.polygons.{number}"
        corners = shape.get("polygon") if isinstance(shape, dict) else None
        if not isinstance(corners, list) or len(corners) < 3:
            raise MissionFileError(f"{where} has fewer than 3 corners; draw it again")
        command = POLYGON_IN if shape.get("inclusion", True) else POLYGON_OUT
        for index, corner in enumerate(corners):
            place = _pair(corner, f"{where}.polygon.{index}")
            yield FileItem(command, (float(len(corners)), 0.0, 0.0, 0.0), place, 0.0, 0, where)
    for number, shape in enumerate(_optional_list(fence, "circles", "geoFence")):
        where = f"geoFence.circles.{number}"
        circle = shape.get("circle") if isinstance(shape, dict) else None
        if not isinstance(circle, dict):
            raise MissionFileError(f"{where} has no circle; draw it again")
        radius_m = number_of(circle.get("radius"), f"{where}.circle.radius")
        command = CIRCLE_IN if shape.get("inclusion", True) else CIRCLE_OUT
        place = _pair(circle.get("center"), f"{where}.circle.center")
        yield FileItem(command, (radius_m, 0.0, 0.0, 0.0), place, 0.0, 0, where)
    if fence.get("breachReturn"):
        where = "geoFence.breachReturn"
        yield FileItem(RETURN_POINT, place_deg=_pair(fence["breachReturn"], where), where=where)


def _pair(value: Any, where: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) < 2:
        raise MissionFileError(f"{where} is not a place; write [latitude, longitude]")
    return place_of(number_of(value[0], where), number_of(value[1], where), where)


def read_waypoints(text: str) -> Course:
    """Return the items of a `QGC WPL` text with twelve columns. The first item is home and is ignored.

    Mission Planner also saves fences and rally points in such files; their commands distinguish them. Raises
    MissionFileError with the line.
    """
    lines = text.split("\n")
    words = lines[0].split()
    if words[:2] != ["QGC", "WPL"]:
        raise MissionFileError("does not begin with QGC WPL 110; save the waypoints again", 1)
    if words[2:] and words[2] not in _WPL_VERSIONS:
        raise MissionFileError(f"is of version {words[2][:20]}; save it as QGC WPL 110", 1)
    items = [
        _waypoint(line.split(), number)
        for number, line in enumerate(lines[1:], start=2)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    return sorted_course(items[1:], "waypoint after home, its first")


def waypoints_text(items: Sequence[Any]) -> str:
    """Return MISSION_ITEM_INT messages as a `QGC WPL 110` text, home first. `read_waypoints` reads it."""
    lines = ["QGC WPL 110"]
    for item in items:
        parameters = (item.param1, item.param2, item.param3, item.param4)
        has_place = item.frame != NO_PLACE
        place = (item.x * 1e-7, item.y * 1e-7) if has_place else (float(item.x), float(item.y))
        numbers = [f"{number:.8f}" for number in (*parameters, *place, item.z)]
        current = int(item.seq == 0)
        lines.append("\t".join(map(str, (item.seq, current, item.frame, item.command, *numbers, item.autocontinue))))
    return "\n".join(lines) + "\n"


def _waypoint(columns: list[str], line: int) -> FileItem:
    if len(columns) != WPL_COLUMNS:
        expected = "index, current, frame, command, 4 parameters, latitude, longitude, altitude, autocontinue"
        raise MissionFileError(f"item has {len(columns)} columns; QGC WPL has {WPL_COLUMNS}: {expected}", line)
    where = f"item {columns[0]}"
    try:
        frame, command = int(columns[2]), int(columns[3])
        numbers = tuple(map(float, columns[4:11]))
    except ValueError as error:
        raise MissionFileError(f"{where}: {error}; write numbers", line) from None
    if any(math.isinf(number) for number in numbers):
        raise MissionFileError(f"{where}: a number is not finite; write numbers", line)
    return mavlink_item(command, frame, numbers, where, line)
