"""The mission an autopilot holds, asked for by the MAVLink mission protocol while a run goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from agent.wire import dialect

REPEAT_S = 0.5
GIVE_UP_S = 10.0


class Item(NamedTuple):
    """What a score needs of a mission item."""

    seq: int
    command: int
    lat_deg: float
    lon_deg: float


class MissionDownload:
    """`start`, then `update` at every exchange and `take` for every message; `items` is complete once `done`."""

    def __init__(self, send: Callable[[Any], object], system_id: int, component_id: int) -> None:
        self._send = send
        self._target = (system_id, component_id)
        self._count: int | None = None
        self._started_ns: int | None = None
        self._sent_ns: int | None = None
        self.items: list[Item] = []
        self.done = False

    def start(self, sim_ns: int) -> None:
        """Ask for the mission from its beginning."""
        self._count, self._started_ns, self._sent_ns = None, sim_ns, None
        self.items, self.done = [], False

    def update(self, sim_ns: int) -> None:
        """Ask for the next item, and again where no answer came; gives up silently after `GIVE_UP_S`."""
        if self._started_ns is None or self.done or sim_ns - self._started_ns > GIVE_UP_S * 1e9:
            return
        if self._sent_ns is not None and sim_ns - self._sent_ns < REPEAT_S * 1e9:
            return
        self._sent_ns = sim_ns
        if self._count is None:
            self._send(dialect.MAVLink_mission_request_list_message(*self._target, 0))
        else:
            self._send(dialect.MAVLink_mission_request_int_message(*self._target, len(self.items), 0))

    def take(self, message: Any) -> None:
        """A message of the autopilot."""
        if self._started_ns is None or self.done or getattr(message, "mission_type", 0) != 0:
            return
        number = message.get_msgId()
        if number == dialect.MAVLINK_MSG_ID_MISSION_COUNT and self._count is None:
            self._count = message.count
        elif number == dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT and message.seq == len(self.items):
            self.items.append(Item(message.seq, message.command, message.x * 1e-7, message.y * 1e-7))
        else:
            return
        self._sent_ns = None
        if self._count == len(self.items):
            self.done = True
            self._send(dialect.MAVLink_mission_ack_message(*self._target, dialect.MAV_MISSION_ACCEPTED, 0))
