"""The autopilot's mission, downloaded by the MAVLink mission protocol, as the positions that it visits."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from agent.mavlink.exchange import Messages, Target
from agent.mavlink.missions import MissionDownload
from agent.wire import dialect as mav

_ROUND_NS = 10_000_000_000  # time before an abandoned download restarts
_TRIES = 8
_MOST_ITEMS = 2000

WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, RETURN_HOME = 16, 17, 19, 20
SPLINE, LOITER_TO = 82, 31
CHANGE_SPEED = 178
_PLACES = (WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, SPLINE, LOITER_TO)
_STAYS = (LOITER_UNLIMITED, RETURN_HOME)


class MissionCopyItem(NamedTuple):
    """Mission item, reduced to the fields that define the path."""

    command: int
    lat_e7: int
    lon_e7: int
    speed_mps: float


class MissionPosition(NamedTuple):
    """A position of the mission."""

    seq: int
    """Mission item."""
    lat_e7: int
    """1e-7 degrees."""
    lon_e7: int
    """1e-7 degrees."""


class MissionCopy:
    """Copy of the mission. `items` is the last complete mission, None before the first.

    `poll` and `handle` download it.
    """

    def __init__(self) -> None:
        self.items: list[MissionCopyItem] | None = None
        self._wanted = True
        self._download: MissionDownload | None = None

    def refresh(self) -> None:
        """Download the mission again. The old one remains valid until the new one is complete."""
        if not self._wanted:
            self._wanted, self._download = True, None

    def note_total(self, total: int) -> None:
        """Compare with the item count of MISSION_CURRENT, without home. 0 and 65535 carry no information."""
        if self.items is not None and 0 < total < 65535 and total not in (len(self.items), len(self.items) - 1):
            self.refresh()

    def poll(self, target: Target, now_ns: int) -> Messages:
        """Return requests for the missing items. After some tries and a pause, the download restarts."""
        if not self._wanted:
            return []
        download = self._download
        if download is not None and download.tries >= _TRIES:
            if 0 <= now_ns - (download.asked_ns or 0) < _ROUND_NS:
                return []
            download = None
        if download is None:
            download = self._download = MissionDownload(target, most=_MOST_ITEMS)
        return download.poll(now_ns)

    def handle(self, message: Any, now_ns: int) -> Messages:
        """Handle MISSION_COUNT and MISSION_ITEM_INT. Return the replies and the next request."""
        download = self._download
        if download is None:
            return []
        replies = download.handle(message, now_ns)
        if download.done:
            self.items, self._wanted, self._download = [_item(one) for one in download.items], False, None
        return [*replies, *download.poll(now_ns)] if download.answered else []

    # -- path

    def positions_from(self, seq: int) -> list[MissionPosition]:
        """Return the positions from item `seq` on, up to a jump or a stop."""
        found: list[MissionPosition] = []
        for number in range(max(seq, 1), len(self.items or ())):
            item = (self.items or [])[number]
            if item.command in _PLACES and (item.lat_e7 or item.lon_e7):
                found.append(MissionPosition(number, item.lat_e7, item.lon_e7))
            elif item.command == RETURN_HOME and self.items:
                found.append(MissionPosition(number, self.items[0].lat_e7, self.items[0].lon_e7))
            if item.command in _STAYS or item.command == mav.MAV_CMD_DO_JUMP:
                break
        return found

    def position_before(self, seq: int) -> MissionPosition | None:
        """Return the last position before item `seq`, which is the start of its leg."""
        for number in range(min(seq, len(self.items or ())) - 1, 0, -1):
            item = (self.items or [])[number]
            if item.command in _PLACES and (item.lat_e7 or item.lon_e7):
                return MissionPosition(number, item.lat_e7, item.lon_e7)
        return None

    def speed_mps(self, seq: int) -> float | None:
        """Speed that the mission sets on the leg to item `seq`, None if it sets none."""
        asked = [item.speed_mps for item in (self.items or [])[1 : seq + 1] if item.command == CHANGE_SPEED]
        good = [speed for speed in asked if math.isfinite(speed) and 0.0 < speed < 30.0]
        return good[-1] if good else None


def _item(message: Any) -> MissionCopyItem:
    speed_mps = float(message.param2) if message.command == CHANGE_SPEED else 0.0
    return MissionCopyItem(int(message.command), int(message.x), int(message.y), speed_mps)
