"""Priorities on a slow line: motor commands and inertial samples at once, the rest when there is room."""

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
FULL_S = 0.005  # a line that has so much to carry gets nothing more that could wait
RETRY_S = 0.002  # after the transport took nothing


class WaitingMessages:
    """The messages of one end that wait for the line, at most `MOST_WAITING`; then the oldest is given up.

    Urgent messages overtake them and wait only while the transport takes nothing at all, at most `MOST_URGENT`. In
    lockstep nothing overtakes: from a XITL_TICK to the next XITL_RUN, in either direction, everything goes in order, as
    the tick says that all before it was sent. `hand_on` gives a message to the transport and says whether that took it;
    numbers are given there, so that overtaking leaves no gaps.

    given_up: messages that will never be sent.
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
        """Send or keep messages. False when one, of these or an older one, was given up."""
        given_up = self.given_up
        for prepared in messages:
            number = prepared[0].get_msgId()
            if number in URGENT and not self._in_order and number != dialect.MAVLINK_MSG_ID_XITL_TICK:
                if self._urgent or not self._hand_on(prepared):
                    self._keep(self._urgent, prepared, MOST_URGENT)
                continue
            if number == dialect.MAVLINK_MSG_ID_XITL_TICK:
                self._in_order = True
            self._keep(self._waiting, prepared, MOST_WAITING)
            if number == dialect.MAVLINK_MSG_ID_XITL_RUN:  # lockstep ends with it, and not before it
                self.flush()
                self._in_order = False
        self.flush()
        return self.given_up == given_up

    def _keep(self, queue: deque[Prepared], prepared: Prepared, most: int) -> None:
        if len(queue) >= most:
            queue.popleft()
            self.given_up += 1
        queue.append(prepared)

    def heard(self, messages: Iterable[Message]) -> None:
        """What has arrived tells of lockstep too."""
        for message in messages:
            number = message.get_msgId()
            if number == dialect.MAVLINK_MSG_ID_XITL_TICK:
                self._in_order = True
            elif number == dialect.MAVLINK_MSG_ID_XITL_RUN:
                self._in_order = False

    def flush(self) -> None:
        """Send what the line has room for."""
        waiting, transport = self._waiting, self.transport
        self._refused = not self._pass_on(self._urgent)
        while waiting and not self._refused and (self._in_order or transport.backlog_s() < FULL_S):
            self._refused = not self._hand_on(waiting[0])
            if not self._refused:
                waiting.popleft()

    def _pass_on(self, queue: deque[Prepared]) -> bool:
        while queue and self._hand_on(queue[0]):
            queue.popleft()
        return not queue

    def wake_s(self) -> float | None:
        """Seconds until `flush` is worth a call, None when nothing waits."""
        if not (self._waiting or self._urgent):
            return None
        return RETRY_S if self._refused else max(self.transport.backlog_s() - FULL_S, 0.0) + 1e-4
