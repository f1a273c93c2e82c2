"""Priorities on a slow line: motor commands and inertial samples at once, other messages when there is room."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Callable

from agent.wire import dialect
from agent.wire.codec import Message, Prepared
from agent.wire.transport import Transport

URGENT = frozenset(
    (
        dialect.MAVLINK_MSG_ID_XITL_ACTUATORS,
        dialect.MAVLINK_MSG_ID_XITL_IMU,
        dialect.MAVLINK_MSG_ID_XITL_TICK,
        dialect.MAVLINK_MSG_ID_XITL_RUN,
        dialect.MAVLINK_MSG_ID_XITL_TIMESYNC,
        dialect.MAVLINK_MSG_ID_XITL_FAULTS,
    )
)
MOST_WAITING = 256
MOST_URGENT = 16
FULL_S = 0.005  # a line with this backlog gets only urgent messages
RETRY_S = 0.002  # after the transport refused a frame


class WaitingMessages:
    """Messages of one end that wait for the line, at most `MOST_WAITING`. Beyond that, the oldest is dropped.

    Urgent messages overtake them. They wait only while the transport accepts nothing, at most `MOST_URGENT`. In
    lockstep nothing overtakes: from a XITL_TICK to the next XITL_RUN, in either direction, all messages keep their
    order. The tick states that everything before it was sent.

    hand_on: gives a message to the transport and returns whether it was accepted. It assigns the sequence number, so
      that overtaking leaves no gaps.
    given_up: number of dropped messages.
    """

    def __init__(self, transport: Transport, hand_on: Callable[[Prepared], bool]) -> None:
        self.given_up = 0
        self.transport = transport
        self._hand_on = hand_on
        self._waiting: deque[Prepared] = deque()
        self._urgent: deque[Prepared] = deque()
        self._in_order = False
        self._refused = False

    def __len__(self) -> int:
        return len(self._waiting) + len(self._urgent)

    def send(self, messages: Iterable[Prepared]) -> bool:
        """Send or queue messages. Return False when a message, one of these or an older one, was dropped."""
        given_up = self.given_up
        for prepared in messages:
            number = prepared[0].get_msgId()
            if number in URGENT and not self._in_order and number != dialect.MAVLINK_MSG_ID_XITL_TICK:
                if self._urgent or not self._hand_on(prepared):
                    self._queue(self._urgent, prepared, MOST_URGENT)
                continue
            if number == dialect.MAVLINK_MSG_ID_XITL_TICK:
                self._in_order = True
            self._queue(self._waiting, prepared, MOST_WAITING)
            if number == dialect.MAVLINK_MSG_ID_XITL_RUN:  # lockstep ends with this message, and not before
                self.flush()
                self._in_order = False
        self.flush()
        return self.given_up == given_up

    def _queue(self, queue: deque[Prepared], prepared: Prepared, most: int) -> None:
        if len(queue) >= most:
            queue.popleft()
            self.given_up += 1
        queue.append(prepared)

    def heard(self, messages: Iterable[Message]) -> None:
        """Update the lockstep state from received messages."""
        for message in messages:
            number = message.get_msgId()
            if number == dialect.MAVLINK_MSG_ID_XITL_TICK:
                self._in_order = True
            elif number == dialect.MAVLINK_MSG_ID_XITL_RUN:
                self._in_order = False

    def flush(self) -> None:
        """Send the messages that the line has room for."""
        waiting, transport = self._waiting, self.transport
        while self._urgent and self._hand_on(self._urgent[0]):
            self._urgent.popleft()
        self._refused = bool(self._urgent)
        while waiting and not self._refused and (self._in_order or transport.backlog_s() < FULL_S):
            self._refused = not self._hand_on(waiting[0])
            if not self._refused:
                waiting.popleft()

    def wake_s(self) -> float | None:
        """Seconds until the next useful call of `flush`, None when nothing waits."""
        if not (self._waiting or self._urgent):
            return None
        return RETRY_S if self._refused else max(self.transport.backlog_s() - FULL_S, 0.0) + 1e-4
