"""A mission as in its file: MAVLink items with places in degrees, and their positions in the file."""

from __future__ import annotations

import math

from agent.fcu.fence import CIRCLE_IN, CIRCLE_OUT, POLYGON_IN, POLYGON_OUT, RETURN_POINT
from agent.fcu.mission import COMMANDS, WAYPOINT
from sim_core.dataclass import dataclass

RALLY_POINT = 5100  # MAV_CMD_NAV_RALLY_POINT
FENCE_COMMANDS = (RETURN_POINT, POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT)
RELATIVE, NO_PLACE = 3, 2  # MAV_FRAME
MOST_ITEMS = 65_534

Parameters = tuple[float | None, float | None, float | None, float | None]


class MissionFileError(ValueError):
    """An unusable mission file. The message names the invalid element and the fix.

    line: 1-based, None when the format's reader does not know it.
    """

    def __init__(self, text: str, line: int | None = None) -> None:
        super().__init__(text)
        self.line = line


@dataclass(frozen=True, slots=True)
class FileItem:
    """One item of a mission file."""

    command: int = WAYPOINT
    parameters: Parameters = (0.0, 0.0, 0.0, 0.0)
    """Parameters 1 to 4; None for the autopilot's default."""
    place_deg: tuple[float, float] | None = None
    """Latitude and longitude in degrees; None without a place."""
    altitude_m: float = 0.0
    frame: int = RELATIVE
    where: str = ""
    """Element of the file, for errors."""
    line: int | None = None
    """1-based; None when unknown."""

    @property
    def is_plain(self) -> bool:
        """Whether it is only a place to go to."""
        return self.command == WAYPOINT and not any(self.parameters) and self.place_deg is not None


@dataclass(frozen=True, slots=True)
class Course:
    """Content of a file: the mission after home, the fence and the rally points, each as items."""

    items: tuple[FileItem, ...]
    fence: tuple[FileItem, ...] = ()
    rally: tuple[FileItem, ...] = ()


def place_of(latitude_deg: float, longitude_deg: float, where: str, line: int | None = None) -> tuple[float, float]:
    """Return a checked place. Raises MissionFileError for a place that is not on the Earth."""
    if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
        text = f"{where}: latitude {latitude_deg:g}, longitude {longitude_deg:g} is not on the Earth"
        raise MissionFileError(f"{text}; check the order of the two numbers", line)
    return latitude_deg, longitude_deg


def mavlink_item(
    command: int, frame: int, numbers: tuple[float | None, ...], where: str, line: int | None = None
) -> FileItem:
    """Return an item from MAVLink's seven parameters. None or NaN means the autopilot's default.

    A latitude and a longitude that are both 0 are no place, as in ArduPilot. Raises MissionFileError.
    """
    p1, p2, p3, p4, x, y, z = (None if number is None or math.isnan(number) else number for number in numbers)
    known = COMMANDS.get(command)
    has_place = known.has_place if known is not None else frame != NO_PLACE
    place = None
    if x or y:
        if not has_place:
            name = "" if known is None else f" ({known.name})"
            text = f"{where}: command {command}{name} has no place, but its parameters 5 and 6 are {x:g} and {y:g}"
            raise MissionFileError(f"{text}; remove the item or set them to 0", line)
        place = place_of(x or 0.0, y or 0.0, where, line)
    return FileItem(command, (p1, p2, p3, p4), place, z or 0.0, frame, where, line)


def sorted_course(items: list[FileItem], kind: str) -> Course:
    """Sort the items of one list by their use: mission, fence or rally points. Raises MissionFileError.

    kind: the kind of the items, for the error.
    """
    if not items:
        raise MissionFileError(f"has no {kind}; draw at least one")
    fence = tuple(item for item in items if item.command in FENCE_COMMANDS)
    rally = tuple(item for item in items if item.command == RALLY_POINT)
    others = (*FENCE_COMMANDS, RALLY_POINT)
    return Course(tuple(item for item in items if item.command not in others), fence, rally)
