"""The MAVLink parameter protocol, for one station."""

from __future__ import annotations

from collections import deque
from typing import Any

from agent.fcu.mavlink.texts import Texts
from agent.fcu.mavlink.vehicle import Mailbox, Vehicle
from agent.fcu.parameters import TABLE, ParameterError, index_of
from agent.wire import dialect as mav

Messages = list[Any]

_PER_POLL = 10


class ParameterService:
    """List, read, set. A list goes out `_PER_POLL` values a call of `poll`, so that it holds nothing up.

    keeps: whether what is set here outlives a restart. announces_changes: whether this station is told what others
    set.
    """

    def __init__(self, vehicle: Vehicle, texts: Texts, mailbox: Mailbox, keeps: bool, announces_changes: bool) -> None:
        self._vehicle = vehicle
        self._texts = texts
        self._mailbox = mailbox
        self._keeps = keeps
        self._announces_changes = announces_changes
        self._queue: deque[int] = deque()

    def on_list(self, message: Any, now_ns: int) -> Messages:
        """Start again from the first."""
        self._queue = deque(range(len(TABLE)))
        return []

    def on_read(self, message: Any, now_ns: int) -> Messages:
        """By index, or by name when that is negative. What does not exist is not answered, as the protocol has it."""
        index = message.param_index if message.param_index >= 0 else index_of(message.param_id)
        return [self.value(index)] if 0 <= index < len(TABLE) else []

    def on_set(self, message: Any, now_ns: int) -> Messages:
        """Answered by the value in force; when refused, by the old one and a sentence."""
        name = message.param_id
        replies: Messages = []
        try:
            value = self._vehicle.autopilot.parameters.set(name, message.param_value)
        except ParameterError as error:
            replies += self._texts.messages(mav.MAV_SEVERITY_WARNING, str(error))
        else:
            self._vehicle.parameter_changed(name, self._mailbox)
            if self._keeps and self._vehicle.keeper is not None:
                self._vehicle.keeper.keep_parameter(name, value)
        index = index_of(name)
        if index >= 0:
            replies.append(self.value(index))
        return replies

    def poll(self) -> Messages:
        """Values that are due: those of a list, and those that another station changed."""
        messages = [self.value(self._queue.popleft()) for _ in range(min(_PER_POLL, len(self._queue)))]
        changed = self._mailbox.parameters
        if changed and self._announces_changes:
            messages.extend(self.value(index_of(name)) for name in changed)
        changed.clear()
        return messages

    def value(self, index: int) -> Any:
        """PARAM_VALUE of one row of the table."""
        name = TABLE[index].name
        value = self._vehicle.autopilot.parameters[name]
        kind = mav.MAV_PARAM_TYPE_REAL32
        return mav.MAVLink_param_value_message(name.encode("ascii"), value, kind, len(TABLE), index)
