"""The MAVLink mission protocol: upload with re-requests and time-out, download, clear.

A new mission replaces the old one only when its last item has arrived and the whole is accepted.
"""

from __future__ import annotations

from typing import Any

from agent.fcu.autopilot import WARNING, Autopilot, Event
from agent.fcu.mission import CHANGE_SPEED, MOST_ITEMS, WAYPOINT, Mission, MissionItem, item_problem, mission
from agent.wire import dialect as mav

_RETRY_NS = 500_000_000
_RETRIES = 5
_FRAMES = {0: 0, 3: 3, 5: 0, 6: 3}  # the _INT frames mean the same

Messages = list[Any]


class _Upload:
    """A transfer under way from one station."""

    def __init__(self, station: tuple[int, int], count: int, now_ns: int) -> None:
        self.station = station
        self.count = count
        self.items: list[MissionItem] = []
        self.asked_ns = now_ns
        self.retries = 0


class MissionTransfer:
    """Answers mission messages that were already found to be addressed to this vehicle."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._upload: _Upload | None = None
        self._finished: tuple[tuple[int, int], int] | None = None  # station and last item of the last upload

    def on_count(self, message: Any, now_ns: int) -> Messages:
        """Start of an upload; one from the same station starts again."""
        station = _station(message)
        if message.mission_type != mav.MAV_MISSION_TYPE_MISSION:
            return [_ack(station, mav.MAV_MISSION_UNSUPPORTED, message.mission_type)]
        if self._upload is not None and self._upload.station != station:
            return [_ack(station, mav.MAV_MISSION_ERROR)]
        if message.count > MOST_ITEMS:
            self._say(f"Mission of {message.count} items refused: at most {MOST_ITEMS} fit")
            return [_ack(station, mav.MAV_MISSION_NO_SPACE)]
        if message.count == 0:
            self._upload = None
            self._autopilot.set_mission(Mission())
            return [_ack(station, mav.MAV_MISSION_ACCEPTED)]
        self._upload = _Upload(station, message.count, now_ns)
        return [_request(self._upload)]

    def on_item(self, message: Any, now_ns: int) -> Messages:
        """One item. The one before is a duplicate and ignored; any other but the expected makes it be asked again."""
        station = _station(message)
        upload = self._upload
        if message.mission_type != mav.MAV_MISSION_TYPE_MISSION:
            return [_ack(station, mav.MAV_MISSION_UNSUPPORTED, message.mission_type)]
        if upload is None:
            repeated = self._finished == (station, message.seq)  # the acknowledgement was lost
            return [_ack(station, mav.MAV_MISSION_ACCEPTED if repeated else mav.MAV_MISSION_ERROR)]
        if upload.station != station:
            return [_ack(station, mav.MAV_MISSION_ERROR)]
        expected = len(upload.items)
        if message.seq == expected - 1:
            return []
        upload.asked_ns = now_ns
        upload.retries = 0
        if message.seq != expected:
            return [_request(upload)]
        item = _item(message)
        refused = self._refusal(message, item)
        if refused is not None:
            self._upload = None
            return [_ack(station, refused)]
        upload.items.append(item)
        if len(upload.items) < upload.count:
            return [_request(upload)]
        self._upload = None
        self._finished = (station, upload.count - 1)
        self._autopilot.set_mission(mission(upload.items))
        return [_ack(station, mav.MAV_MISSION_ACCEPTED)]

    def on_request_list(self, message: Any, now_ns: int) -> Messages:
        """Start of a download."""
        count = len(self._autopilot.mission.items) if message.mission_type == mav.MAV_MISSION_TYPE_MISSION else 0
        return [mav.MAVLink_mission_count_message(*_station(message), count, message.mission_type)]

    def on_request(self, message: Any, now_ns: int) -> Messages:
        """One item of a download; item 0 is home."""
        station = _station(message)
        items = self._autopilot.mission.items
        if message.mission_type != mav.MAV_MISSION_TYPE_MISSION or message.seq >= len(items):
            return [_ack(station, mav.MAV_MISSION_INVALID_SEQUENCE, message.mission_type)]
        item = items[message.seq]
        home = self._autopilot.home
        if message.seq == 0 and home is not None:
            item = MissionItem(WAYPOINT, home.lat_deg, home.lon_deg, home.alt_m, frame=0)
        current = int(message.seq == self._autopilot.pilot.current)
        is_speed = item.command == CHANGE_SPEED
        return [
            mav.MAVLink_mission_item_int_message(
                *station,
                message.seq,
                item.frame,
                item.command,
                current,
                1,
                1.0 if is_speed else 0.0,  # speed over ground
                item.speed_mps,
                -1.0 if is_speed else 0.0,  # throttle unchanged
                0.0,
                round(item.lat_deg * 1e7),
                round(item.lon_deg * 1e7),
                item.alt_m,
            )
        ]

    def on_clear(self, message: Any, now_ns: int) -> Messages:
        """Delete the mission."""
        if message.mission_type != mav.MAV_MISSION_TYPE_MISSION:
            return [_ack(_station(message), mav.MAV_MISSION_UNSUPPORTED, message.mission_type)]
        self._upload = None
        self._autopilot.set_mission(Mission())
        return [_ack(_station(message), mav.MAV_MISSION_ACCEPTED)]

    def poll(self, now_ns: int) -> Messages:
        """Ask again for an item that does not come; give up after five times."""
        upload = self._upload
        if upload is None or 0 <= now_ns - upload.asked_ns < _RETRY_NS:
            return []
        if upload.retries >= _RETRIES:
            self._upload = None
            self._say(f"Mission upload given up: item {len(upload.items)} did not come")
            return [_ack(upload.station, mav.MAV_MISSION_OPERATION_CANCELLED)]
        upload.retries += 1
        upload.asked_ns = now_ns
        return [_request(upload)]

    def _refusal(self, message: Any, item: MissionItem) -> int | None:
        """The MAV_MISSION_RESULT to refuse an item with. Home is replaced by the real one, so anything will do."""
        if message.seq == 0:
            return None
        if message.command not in (WAYPOINT, CHANGE_SPEED):
            result = mav.MAV_MISSION_UNSUPPORTED
            problem = item_problem(item)
        elif message.command == WAYPOINT and message.frame not in _FRAMES:
            result = mav.MAV_MISSION_UNSUPPORTED_FRAME
            problem = f"frame {message.frame} is not supported; use 0, 3, 5 or 6"
        else:
            result = mav.MAV_MISSION_INVALID
            problem = item_problem(item)
        if not problem:
            return None
        self._say(f"Mission item {message.seq} refused: {problem}")
        return int(result)

    def _say(self, text: str) -> None:
        self._autopilot.say(Event(WARNING, text))


def _station(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _ack(station: tuple[int, int], result: int, mission_type: int = 0) -> Any:
    return mav.MAVLink_mission_ack_message(*station, result, mission_type)


def _request(upload: _Upload) -> Any:
    return mav.MAVLink_mission_request_int_message(*upload.station, len(upload.items))


def _item(message: Any) -> MissionItem:
    frame = _FRAMES.get(message.frame, 3)
    if message.command == CHANGE_SPEED:
        return MissionItem(CHANGE_SPEED, speed_mps=message.param2, frame=frame)
    if message.seq == 0 and not abs(message.z) < 1e5:
        return MissionItem(WAYPOINT, message.x / 1e7, message.y / 1e7, 0.0, frame=frame)
    return MissionItem(
        WAYPOINT if message.seq == 0 else message.command, message.x / 1e7, message.y / 1e7, message.z, frame=frame
    )
