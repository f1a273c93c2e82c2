"""The MAVLink mission protocol: upload whole or in part with re-requests and time-out, download, clear, set current.

A new plan replaces the old one only when its last item has arrived and the whole is accepted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from agent.fcu.mavlink.mission_plan import FencePlan, MissionPlan, Plan, Refused, wire_item
from agent.fcu.mavlink.reports import REPORTS
from agent.fcu.mavlink.vehicle import Vehicle
from agent.wire import dialect as mav

_RETRY_NS = 500_000_000
_RETRIES = 5
_MISSION, _FENCE, _RALLY, _ALL = 0, 1, 2, 255

Messages = list[Any]
Station = tuple[int, int]


class _Upload:
    """A transfer under way from one station: the items from `first` on, `before` and `after` stay as they are."""

    def __init__(self, station: Station, kind: int, first: int, count: int, now_ns: int) -> None:
        self.station = station
        self.kind = kind
        self.first = first
        self.count = count
        self.items: list[Any] = []
        self.before: list[Any] = []
        self.after: list[Any] = []
        self.asked_ns = now_ns
        self.retries = 0

    @property
    def expected(self) -> int:
        """Sequence number of the next item."""
        return self.first + len(self.items)

    def request(self) -> Any:
        """Asks for it."""
        return mav.MAVLink_mission_request_int_message(*self.station, self.expected, self.kind)


class MissionTransfer:
    """Answers mission messages that were already found to be addressed to this vehicle.

    There is no rally point: such a plan is always empty. `keeps`: whether what is uploaded here outlives a restart.
    """

    def __init__(self, vehicle: Vehicle, keeps: bool = True) -> None:
        self._vehicle = vehicle
        self._keeps = keeps
        self._plans: dict[int, Plan] = {_MISSION: MissionPlan(vehicle), _FENCE: FencePlan(vehicle)}
        self._upload: _Upload | None = None
        self._finished: tuple[Station, int, int] | None = None  # station, kind and last item of the last upload
        self.handlers: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_MISSION_COUNT: self._on_count,
            mav.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: self._on_write_partial,
            mav.MAVLINK_MSG_ID_MISSION_ITEM: self._on_item,
            mav.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._on_item,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._on_request_list,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST: self._on_request,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT: self._on_request,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_PARTIAL_LIST: self._on_request_partial,
            mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: self._on_clear,
            mav.MAVLINK_MSG_ID_MISSION_SET_CURRENT: self._on_set_current,
            mav.MAVLINK_MSG_ID_MISSION_ACK: self._on_ack,
        }

    # -- upload

    def _on_count(self, message: Any, now_ns: int) -> Messages:
        """Start of an upload; one from the same station starts again."""
        station, kind = _station(message), message.mission_type
        plan = self._plans.get(kind)
        if plan is None:
            empty = kind == _RALLY and message.count == 0
            return [_ack(station, mav.MAV_MISSION_ACCEPTED if empty else mav.MAV_MISSION_UNSUPPORTED, kind)]
        if self._upload is not None and self._upload.station != station:
            return [_ack(station, mav.MAV_MISSION_ERROR, kind)]
        if message.count > plan.most:
            self._warn(f"{plan.name} of {message.count} items refused: at most {plan.most} fit")
            return [_ack(station, mav.MAV_MISSION_NO_SPACE, kind)]
        if message.count == 0:
            self._upload = None
            return [_ack(station, self._store(kind, []), kind)]
        self._upload = _Upload(station, kind, 0, message.count, now_ns)
        return [self._upload.request()]

    def _on_write_partial(self, message: Any, now_ns: int) -> Messages:
        """Items start_index to end_index of the plan in force are replaced."""
        station, kind = _station(message), message.mission_type
        plan = self._plans.get(kind)
        if plan is None:
            return [_ack(station, mav.MAV_MISSION_UNSUPPORTED, kind)]
        if self._upload is not None and self._upload.station != station:
            return [_ack(station, mav.MAV_MISSION_ERROR, kind)]
        items, first, last = plan.items(), message.start_index, message.end_index
        if not 0 <= first <= last < len(items):
            self._warn(f"{plan.name} items {first} to {last} refused: there are {len(items)}")
            return [_ack(station, mav.MAV_MISSION_INVALID_SEQUENCE, kind)]
        self._upload = upload = _Upload(station, kind, first, last - first + 1, now_ns)
        upload.before, upload.after = items[:first], items[last + 1 :]
        return [upload.request()]

    def _on_item(self, message: Any, now_ns: int) -> Messages:
        """One item. The one before is a duplicate and ignored; any other but the expected makes it be asked again."""
        station, kind = _station(message), message.mission_type
        upload, plan = self._upload, self._plans.get(kind)
        if plan is None:
            return [_ack(station, mav.MAV_MISSION_UNSUPPORTED, kind)]
        if upload is None:
            repeated = self._finished == (station, kind, message.seq)  # the acknowledgement was lost
            if not repeated:
                self._warn(f"{plan.name} item {message.seq} refused: no upload is under way")
            return [_ack(station, mav.MAV_MISSION_ACCEPTED if repeated else mav.MAV_MISSION_ERROR, kind)]
        if upload.station != station or upload.kind != kind:
            return [_ack(station, mav.MAV_MISSION_ERROR, kind)]
        if message.seq == upload.expected - 1 and upload.items:
            return []
        upload.asked_ns = now_ns
        upload.retries = 0
        if message.seq != upload.expected:
            self._warn(f"{plan.name} item {message.seq} out of order: {upload.expected} is next")
            return [upload.request()]
        item = plan.read(wire_item(message))
        if isinstance(item, Refused):
            self._upload = None
            self._warn(f"{plan.name} item {message.seq} refused: {item.problem}")
            return [_ack(station, item.result, kind)]
        upload.items.append(item)
        if len(upload.items) < upload.count:
            return [upload.request()]
        self._upload = None
        result = self._store(kind, [*upload.before, *upload.items, *upload.after], keep_current=upload.first)
        self._finished = (station, kind, message.seq) if result == mav.MAV_MISSION_ACCEPTED else None
        return [_ack(station, result, kind)]

    def _store(self, kind: int, items: list[Any], keep_current: int = 0) -> int:
        """Put a plan in force. One that was changed in part goes on where the vessel is."""
        plan = self._plans[kind]
        current = plan.current()
        problem = plan.store(items)
        if problem:
            self._warn(f"{plan.name} refused: {problem}")
            return int(mav.MAV_MISSION_INVALID)
        if keep_current and current > 0:
            self._vehicle.autopilot.set_current(current)
        if self._keeps and self._vehicle.keeper is not None:
            self._vehicle.keeper.keep_plan(self._vehicle.autopilot)
        return int(mav.MAV_MISSION_ACCEPTED)

    def poll(self, now_ns: int) -> Messages:
        """Ask again for an item that does not come; give up after five times."""
        upload = self._upload
        if upload is None or 0 <= now_ns - upload.asked_ns < _RETRY_NS:
            return []
        if upload.retries >= _RETRIES:
            self._upload = None
            name = self._plans[upload.kind].name
            self._warn(f"{name} upload given up: item {upload.expected} did not come")
            return [_ack(upload.station, mav.MAV_MISSION_OPERATION_CANCELLED, upload.kind)]
        upload.retries += 1
        upload.asked_ns = now_ns
        return [upload.request()]

    # -- download

    def _on_request_list(self, message: Any, now_ns: int) -> Messages:
        """Start of a download."""
        plan = self._plans.get(message.mission_type)
        count = 0 if plan is None else len(plan.items())
        return [mav.MAVLink_mission_count_message(*_station(message), count, message.mission_type)]

    def _on_request(self, message: Any, now_ns: int) -> Messages:
        """One item of a download, in the form it was asked for; item 0 of a mission is home."""
        station, kind = _station(message), message.mission_type
        plan = self._plans.get(kind)
        if plan is None or message.seq >= len(plan.items()):
            return [_ack(station, mav.MAV_MISSION_INVALID_SEQUENCE, kind)]
        item = plan.write(message.seq)
        current = int(item.seq == plan.current())
        head = (*station, item.seq, item.frame, item.command, current, 1, *item.parameters)
        if message.get_msgId() == mav.MAVLINK_MSG_ID_MISSION_REQUEST:
            return [mav.MAVLink_mission_item_message(*head, item.lat_deg, item.lon_deg, item.alt_m, kind)]
        lat, lon = round(item.lat_deg * 1e7), round(item.lon_deg * 1e7)
        return [mav.MAVLink_mission_item_int_message(*head, lat, lon, item.alt_m, kind)]

    def _on_request_partial(self, message: Any, now_ns: int) -> Messages:
        """ArduPilot does not do this either: a station asks for the items one by one."""
        return [_ack(_station(message), mav.MAV_MISSION_UNSUPPORTED, message.mission_type)]

    def _on_ack(self, message: Any, now_ns: int) -> Messages:
        """A station ends its upload, or has all that it asked for."""
        upload = self._upload
        ends = upload is not None and upload.station == _station(message) and upload.kind == message.mission_type
        if ends and message.type != mav.MAV_MISSION_ACCEPTED:
            self._upload = None
        return []

    # -- the rest

    def _on_clear(self, message: Any, now_ns: int) -> Messages:
        """Delete a plan, or all."""
        station, kind = _station(message), message.mission_type
        if kind == _RALLY:
            return [_ack(station, mav.MAV_MISSION_ACCEPTED, kind)]
        if kind != _ALL and kind not in self._plans:
            return [_ack(station, mav.MAV_MISSION_UNSUPPORTED, kind)]
        self._upload = None
        results = [self._store(one, []) for one in self._plans if kind in (one, _ALL)]
        return [_ack(station, max(results), kind)]

    def _on_set_current(self, message: Any, now_ns: int) -> Messages:
        """Go on from an item; MISSION_CURRENT says where it goes on, and a sentence why it does not."""
        self._vehicle.autopilot.set_current(message.seq)
        return [m for m in [REPORTS[mav.MAVLINK_MSG_ID_MISSION_CURRENT](self._vehicle, now_ns)] if m is not None]

    def _warn(self, text: str) -> None:
        self._vehicle.warn(text)


def _station(message: Any) -> Station:
    return message.get_srcSystem(), message.get_srcComponent()


def _ack(station: Station, result: int, kind: int = 0) -> Any:
    return mav.MAVLink_mission_ack_message(*station, result, kind)
