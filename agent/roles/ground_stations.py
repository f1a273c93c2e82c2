"""All ground stations of one agent. The agent sends to some, and others connect to it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.mavlink.hub import MavlinkHub
from agent.fcu.vehicle_state import WARNING
from agent.wire import dialect as mav
from agent.wire.codec import MessageRefusedError
from agent.wire.link import Link
from agent.wire.signing import Signing
from agent.wire.tcp import TcpAccepted, TcpListener, TcpTransport
from agent.wire.transport import BadUrlError, Transport, open_transport
from agent.wire.udp import UdpTransport

MOST_CLIENTS = 16
CHUNK_BYTES = 1024  # per station and cycle: about 20 to 80 messages; the rest waits in the system's buffer
BYTES_A_CYCLE = 4096  # of all stations together, shared evenly: their processing time is taken from the control loop
FEWEST_BYTES = 128
DATAGRAMS = 4
DATAGRAM_BYTES = 2048  # longer than any datagram of a station
QUIET_NS = 3_000_000_000  # a station sends a heartbeat once a second
CHECK_AGAIN_S = 0.5
BULK = 2  # messages of lists and files, in addition to telemetry, for a line with a capacity
SILENCE_NS = 1_000_000_000
STUCK_NS = 10_000_000_000  # a station that accepts nothing for this time is dropped


class StationCounters(NamedTuple):
    """Counts since the start, over all stations, including former ones."""

    connected: int
    turned_away: int
    """Always 0: callers beyond the limit wait."""
    dropped: int
    """Stations that accepted nothing for ten seconds, or made room for another."""
    sent: int
    unsent: int
    """Frames that a station did not accept."""
    skipped: int
    """Cycles in which a station was too slow to receive anything."""
    refused: int
    """Frames without a valid signature, overlong datagrams, and requests for files and logs beyond the waiting ones."""
    unpackable: int
    """Messages with a field that does not fit the wire."""

    @property
    def missed(self) -> int:
        """Sum of everything that stations did not receive or sent without effect."""
        return self.turned_away + self.dropped + self.unsent + self.skipped + self.refused + self.unpackable


class GroundStations:
    """Sends to `udp://host:port`. Listens at `tcp://host:port` for up to `MOST_CLIENTS` stations.

    When another one connects, an idle one makes room: first a station without any valid frame, then the longest silent
    one. While all have been heard recently, the new one waits. The constructor raises TransportError. Afterwards,
    nothing that a station does raises or blocks.
    """

    def __init__(self, urls: Sequence[str], system_id: int, component_id: int, signing: Signing | None = None) -> None:
        self._ids = (system_id, component_id)
        self._signing = signing
        self._clients: list[GroundStation] = []
        self._listeners: list[TcpListener] = []
        self._hub: MavlinkHub | None = None
        self._made = 0
        self._turned_away = self._dropped = self._sent = self._unsent = self._skipped = self._refused = 0
        self._unpackable = self._exhausted = 0
        self._sent_ns = time.monotonic_ns()
        try:
            for url in urls:
                self._open(url)
        except Exception:  # close those that are open already, whatever the error
            self.close()
            raise

    def _open(self, url: str) -> None:
        scheme = url.partition("://")[0]
        if scheme == "tcp":
            try:
                parts = urlsplit(url)
            except ValueError as error:
                raise BadUrlError(url, str(error), "write it like tcp://0.0.0.0:5760") from None
            self._listeners.append(TcpListener(parts))
            return
        transport = open_transport(url, listen=False)
        if isinstance(transport, UdpTransport):
            transport.batch, transport.longest = DATAGRAMS, DATAGRAM_BYTES
        self._add(transport, url)

    def _add(self, transport: Transport, name: str) -> None:
        client = GroundStation(
            Link(transport, *self._ids, signing=self._signing, link_id=self._made, mavlink1=True), name
        )
        self._made += 1
        self._clients.append(client)
        if self._hub is not None:
            client.attach(self._hub)

    @property
    def addresses(self) -> tuple[str, ...]:
        """Addresses of the stations, or addresses that they may connect to."""
        return (
            *(client.name for client in self._clients if not isinstance(client.transport, TcpAccepted)),
            *(listener.address for listener in self._listeners),
        )

    @property
    def counters(self) -> StationCounters:
        """Counts so far."""
        counters = [client.link.counters for client in self._clients]
        return StationCounters(
            len(self._clients),
            self._turned_away,
            self._dropped,
            self._sent + sum(counter.sent for counter in counters),
            self._unsent + sum(counter.unsent for counter in counters),
            self._skipped + sum(client.skipped for client in self._clients),
            self._refused + sum(client.refused for client in self._clients),
            self._unpackable + sum(client.unpackable for client in self._clients),
        )

    def descriptors(self) -> list[int]:
        """Descriptors that become readable when there is something to do."""
        descriptors = [client.transport.fileno() for client in self._clients]
        descriptors += [listener.fileno() for listener in self._listeners]
        return [descriptor for descriptor in descriptors if descriptor is not None]

    def attach(self, hub: MavlinkHub) -> None:
        """Serve this vehicle from now on."""
        self._hub = hub
        for client in self._clients:
            client.attach(hub)

    def receive(self, clock: Callable[[], int]) -> None:
        """Accept connections and handle the received messages. clock: the vehicle's clock."""
        for listener in self._listeners:
            self._accept(listener)
        for client in self._clients:
            client.receive(clock)
        now_ns = time.monotonic_ns()
        for client in [client for client in self._clients if client.is_gone(now_ns)]:
            self._drop(client)

    def telemetry(self, now_ns: int) -> None:
        """Send the messages that are due to every station. Called once a cycle."""
        self._sent_ns = time.monotonic_ns()
        for client in self._clients:
            client.telemetry(now_ns)

    def keep_alive(self, now_ns: int) -> None:
        """Continue the heartbeat while the vehicle's clock is stopped."""
        if time.monotonic_ns() - self._sent_ns >= SILENCE_NS:
            self._sent_ns = time.monotonic_ns()
            for client in self._clients:
                client.heartbeat(now_ns)

    def close(self) -> None:
        """End all connections and stop listening."""
        for client in self._clients:
            client.close()
        self._clients.clear()
        for listener in self._listeners:
            listener.close()
        self._listeners.clear()

    def _accept(self, listener: TcpListener) -> None:
        idle = None
        if len(self._clients) >= MOST_CLIENTS:
            stations = [client for client in self._clients if isinstance(client.transport, TcpAccepted)]
            if len(stations) >= MOST_CLIENTS:
                idle = min(
                    stations, key=lambda station: station.heard_ns
                )  # 0 if it never sent a frame; the oldest is first
                if time.monotonic_ns() - idle.heard_ns < QUIET_NS:
                    listener.pause(CHECK_AGAIN_S)
                    return
        called = listener.accept()
        if called is None:
            if listener.exhausted != self._exhausted:
                self._exhausted = listener.exhausted
                self._warn("No file descriptor left: new stations must wait")
            return
        if idle is not None:
            self._warn(f"Idle station {idle.name} dropped for a new one")
            self._drop(idle)
        sock, peer = called
        transport = TcpAccepted(sock, listener.address, peer)
        transport.chunks = 1
        self._add(transport, peer)
        self._share()

    def _share(self) -> None:
        """Share the number of bytes to read per cycle among the stations."""
        stations = [client.transport for client in self._clients if isinstance(client.transport, TcpAccepted)]
        for transport in stations:
            transport.chunk_bytes = max(min(CHUNK_BYTES, BYTES_A_CYCLE // len(stations)), FEWEST_BYTES)

    def _warn(self, sentence: str) -> None:
        if self._hub is not None:
            self._hub.warn(sentence)

    def _drop(self, client: GroundStation) -> None:
        counters = client.link.counters
        self._sent += counters.sent
        self._unsent += counters.unsent
        self._skipped += client.skipped
        self._unpackable += client.unpackable
        self._refused += client.refused
        transport = client.transport
        self._dropped += isinstance(transport, TcpAccepted) and transport.connected
        client.close()
        self._clients.remove(client)
        self._share()


class GroundStation:
    """Serves one station. Nothing here blocks or raises for received bytes, and a slow station costs at most one try.

    skipped: cycles of telemetry omitted because the station did not accept the last one.
    unpackable: messages with a value that does not fit the wire.
    heard_ns: time of the last valid frame on the monotonic clock, 0 for never.
    """

    def __init__(self, link: Link, name: str) -> None:
        self.link = link
        self.name = name
        self.skipped = 0
        self.unpackable = 0
        self.heard_ns = 0
        self._channel: MavlinkChannel | None = None
        self._unanswered = 0  # of earlier channels
        self._stuck_ns: int | None = None
        self._reported_signature = False

    @property
    def transport(self) -> Transport:
        """Transport of its bytes."""
        return self.link.transport

    @property
    def refused(self) -> int:
        """Number of refused frames, datagrams and requests, see StationCounters."""
        transport = self.transport
        too_long = transport.too_long if isinstance(transport, UdpTransport) else 0
        unanswered = self._unanswered + (0 if self._channel is None else self._channel.unanswered)
        return self.link.refused_signature + too_long + unanswered

    def attach(self, hub: MavlinkHub) -> None:
        """Serve this vehicle from now on, at the rates that the station has set."""
        old = self._channel
        self._unanswered += 0 if old is None else old.unanswered
        self._channel = MavlinkChannel(hub.autopilot, self.link.system_id, self.link.component_id, hub=hub, ground=True)
        if old is not None:
            self._channel.streams.resume(old.streams.periods_ns)
            old.close()

    def receive(self, clock: Callable[[], int]) -> None:
        """Handle the received messages, within the limit of one cycle."""
        channel = self._channel
        if channel is None:
            return
        messages = self.link.receive(0.0)
        if messages:
            self.heard_ns = time.monotonic_ns()
        for message in messages:
            replies = channel.handle(message, clock())
            if replies:
                self._send(replies)
        if self.link.refused_signature and not self._reported_signature:
            self._reported_signature = True
            channel.autopilot.events.add(WARNING, f"Frames from {self.name} refused: not signed with our key")

    def telemetry(self, now_ns: int) -> None:
        """Send the messages that are due."""
        if self._channel is None:
            return
        if self._is_stuck():
            self.skipped += 1
            return
        # A line with a capacity accepts only a few messages of lists and files at once.
        room = None
        if self.transport.capacity_bps is not None:
            room = 0 if self.link.waiting else BULK
        messages = self._channel.poll(now_ns, room)
        if messages:
            self._send(messages)

    def heartbeat(self, now_ns: int) -> None:
        """Send only a heartbeat."""
        if self._channel is not None:
            beat = self._channel.streams.message(mav.MAVLINK_MSG_ID_HEARTBEAT, now_ns)
            self._send([beat])

    def is_gone(self, monotonic_ns: int) -> bool:
        """Whether the station has left, or accepts nothing any more."""
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
            self._unanswered += self._channel.unanswered
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
