"""The mission that the autopilot holds, brought by the MAVLink mission protocol, as the places it goes to."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from agent.wire import dialect as mav

_REPEAT_NS = 500_000_000
_ROUND_NS = 10_000_000_000  # one that was given up is begun again
_TRIES = 8
_MOST_ITEMS = 2000

WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, RETURN_HOME = 16, 17, 19, 20
SPLINE, LOITER_TO = 82, 31
CHANGE_SPEED = 178
_PLACES = (WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, SPLINE, LOITER_TO)
_STAYS = (LOITER_UNLIMITED, RETURN_HOME)

Messages = list[Any]


class Item(NamedTuple):
    """What the way depends on."""

    command: int
    lat_e7: int
    lon_e7: int
    speed_mps: float


class Place(NamedTuple):
    """A place that the mission sails to: item `seq`, in 1e-7 degrees."""

    seq: int
    lat_e7: int
    lon_e7: int


class MissionCopy:
    """`poll` asks, `take` listens; `items` is the last whole mission, None before the first."""

    def __init__(self) -> None:
        self.items: list[Item] | None = None
        self._count: int | None = None
        self._coming: list[Item] = []
        self._wanted = True
        self._asked_ns: int | None = None
        self._tries = 0

    def refresh(self) -> None:
        """Bring it again; the old one counts until the new one is whole."""
        if not self._wanted:
            self._wanted, self._count, self._coming, self._asked_ns, self._tries = True, None, [], None, 0

    def total_is(self, total: int) -> None:
        """MISSION_CURRENT says so many items beside home; 0 and 65535 say nothing."""
        if self.items is not None and 0 < total < 65535 and total not in (len(self.items), len(self.items) - 1):
            self.refresh()

    def poll(self, target: tuple[int, int], now_ns: int) -> Messages:
        """What is still missing, asked for again every half second, from the beginning after some tries."""
        if not self._wanted:
            return []
        waited_ns = None if self._asked_ns is None else now_ns - self._asked_ns
        if self._tries >= _TRIES:
            if waited_ns is not None and 0 <= waited_ns < _ROUND_NS:
                return []
            self._count, self._coming, self._tries = None, [], 0
        elif waited_ns is not None and 0 <= waited_ns < _REPEAT_NS:
            return []
        self._tries += 1
        return [self._request(target, now_ns)]

    def take(self, message: Any, target: tuple[int, int], now_ns: int) -> Messages:
        """MISSION_COUNT, MISSION_ITEM_INT and MISSION_ACK; returns what to answer."""
        if not self._wanted or getattr(message, "mission_type", 0) != 0:
            return []
        kind = message.get_msgId()
        if kind == mav.MAVLINK_MSG_ID_MISSION_COUNT and self._count is None and self._asked_ns is not None:
            self._count = min(int(message.count), _MOST_ITEMS)
        elif kind == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT and self._count and message.seq == len(self._coming):
            speed_mps = float(message.param2) if message.command == CHANGE_SPEED else 0.0
            self._coming.append(Item(int(message.command), int(message.x), int(message.y), speed_mps))
        else:
            return []
        self._tries = 0
        if len(self._coming) < self._count:
            return [self._request(target, now_ns)]
        self.items, self._wanted = self._coming, False
        self._count, self._coming = None, []
        return [mav.MAVLink_mission_ack_message(*target, mav.MAV_MISSION_ACCEPTED, 0)]

    def _request(self, target: tuple[int, int], now_ns: int) -> Any:
        self._asked_ns = now_ns
        if self._count is None:
            return mav.MAVLink_mission_request_list_message(*target, 0)
        return mav.MAVLink_mission_request_int_message(*target, len(self._coming), 0)

    # -- the way

    def places_from(self, seq: int) -> list[Place]:
        """Where it goes from item `seq` on, as far as that is known beforehand: up to a jump or a stay."""
        found: list[Place] = []
        for number in range(max(seq, 1), len(self.items or ())):
            item = (self.items or [])[number]
            if item.command in _PLACES and (item.lat_e7 or item.lon_e7):
                found.append(Place(number, item.lat_e7, item.lon_e7))
            elif item.command == RETURN_HOME and self.items:
                found.append(Place(number, self.items[0].lat_e7, self.items[0].lon_e7))
            if item.command in _STAYS or item.command == mav.MAV_CMD_DO_JUMP:
                break
        return found

    def place_before(self, seq: int) -> Place | None:
        """Where the leg to item `seq` starts when it was reached by sailing."""
        for number in range(min(seq, len(self.items or ())) - 1, 0, -1):
            item = (self.items or [])[number]
            if item.command in _PLACES and (item.lat_e7 or item.lon_e7):
                return Place(number, item.lat_e7, item.lon_e7)
        return None

    def speed_mps(self, seq: int) -> float | None:
        """The speed that the mission asks for on the way to item `seq`, None where it does not."""
        asked = [item.speed_mps for item in (self.items or [])[1 : seq + 1] if item.command == CHANGE_SPEED]
        good = [speed for speed in asked if math.isfinite(speed) and 0.0 < speed < 30.0]
        return good[-1] if good else None
