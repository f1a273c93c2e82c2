"""One ground station: its link, its channel, and what it may cost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from agent.fcu.autopilot import WARNING, Event
from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.mavlink.hub import MavlinkHub
from agent.wire import dialect as mav
from agent.wire.codec import MessageRefusedError
from agent.wire.link import Link
from agent.wire.tcp import TcpTransport
from agent.wire.transport import Transport

STUCK_NS = 10_000_000_000  # a station that takes nothing for so long is dropped


class Client:
    """Serves one station. Nothing here waits, raises for what comes in, or lets a slow station cost more than a try.

    skipped: cycles of telemetry not even made because the station did not take the last. unpackable: messages with a
    value that does not fit the wire.
    """

    def __init__(self, link: Link, name: str) -> None:
        self.link = link
        self.name = name
        self.skipped = 0
        self.unpackable = 0
        self._channel: MavlinkChannel | None = None
        self._stuck_ns: int | None = None
        self._said_signature = False

    @property
    def transport(self) -> Transport:
        """Carries its bytes."""
        return self.link.transport

    def attach(self, hub: MavlinkHub) -> None:
        """Serve this vehicle from now on, at the rates the station has asked for."""
        old = self._channel
        self._channel = MavlinkChannel(hub.autopilot, self.link.system_id, self.link.component_id, hub=hub, ground=True)
        if old is not None:
            self._channel.streams.resume(old.streams.periods_ns)
            old.close()

    def receive(self, clock: Callable[[], int]) -> None:
        """Handle what has arrived, as much of it as one cycle can bear."""
        channel = self._channel
        if channel is None:
            return
        for message in self.link.receive(0.0):
            replies = channel.handle(message, clock())
            if replies:
                self._send(replies)
        if self.link.refused_signature and not self._said_signature:
            self._said_signature = True
            channel.autopilot.say(Event(WARNING, f"Frames from {self.name} refused: not signed with our key"))

    def telemetry(self, now_ns: int) -> None:
        """Send what is due."""
        if self._channel is None:
            return
        if self._is_stuck():
            self.skipped += 1
            return
        messages = self._channel.poll(now_ns)
        if messages:
            self._send(messages)

    def heartbeat(self, now_ns: int) -> None:
        """Send that alone."""
        if self._channel is not None:
            beat = self._channel.streams.message(mav.MAVLINK_MSG_ID_HEARTBEAT, now_ns)
            self._send([beat])

    def is_gone(self, monotonic_ns: int) -> bool:
        """Whether the station has left, or takes nothing any more."""
        transport = self.transport
        if not isinstance(transport, TcpTransport):
            return False
        if not transport.connected:
            return True
        if not self._is_stuck():
            self._stuck_ns = None
        elif self._stuck_ns is None:
            self._stuck_ns = monotonic_ns
        return self._stuck_ns is not None and monotonic_ns - self._stuck_ns > STUCK_NS

    def close(self) -> None:
        """End the connection."""
        if self._channel is not None:
            self._channel.close()
            self._channel = None
        self.transport.close()

    def _is_stuck(self) -> bool:
        return isinstance(self.transport, TcpTransport) and self.transport.stuck

    def _send(self, messages: list[Any]) -> None:
        try:
            self.link.send(*messages)
        except MessageRefusedError:
            for message in messages:
                try:
                    self.link.send(message)
                except MessageRefusedError:
                    self.unpackable += 1
