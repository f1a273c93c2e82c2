"""MAVLink router between the vessels of a fleet and all ground stations, as a separate process.

    python -m xitl_cli.run.links.router tcp://127.0.0.1:5760 udp://127.0.0.1:14550

Vessels send to one UDP port of this machine, or the router calls them. Stations connect by TCP, or the router sends to
them by UDP. The first line of output has the addresses. Each line of input is the address of a vessel to call. At the
end of the input the router writes its counts and ends.

Components of vessels that the run simulates, such as cameras, send to a second port. They have the system of their
vessel and another component than its autopilot. What they send to all goes to the stations only.

Frames are forwarded unchanged, so that signatures stay valid (mavlink.io, "Routing"). A frame for a system goes to the
endpoint of that system, other frames to all endpoints. No frame returns to the endpoint of its sender. Between vessels
only the messages of FROM_VESSEL_TO_VESSEL are forwarded. A vessel's system has one endpoint. Frames that claim the
system elsewhere are dropped, and so are frames that come back in a loop.
"""

from __future__ import annotations

import json
import os
import selectors
import socket
import struct
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from time import monotonic
from urllib.parse import urlsplit

from agent.wire import dialect
from agent.wire.framing import Framer, as_received
from agent.wire.tcp import TcpAccepted, TcpCaller, TcpListener, TcpTransport
from agent.wire.transport import DATAGRAM_BYTES, TransportError, open_transport
from agent.wire.udp import UdpTransport
from sim_core.dataclass import dataclass

MOST_STATIONS = 32
MOST_VESSELS = 300  # endpoints that vessels send from: those of a fleet, and some that were restarted
STUCK_S = 10.0  # a station that reads nothing for this time is dropped
MOVED_S = 3.0  # a vessel that was silent for this time may move to another endpoint
AGAIN_S = 0.5  # interval for calls to a vessel that has not answered
LOOK_S = 0.25  # interval of the checks for stuck stations and vessels to call, when no frame arrives
BUFFER_BYTES = 1 << 22
BATCH = 64  # datagrams in one turn
LARGEST = 2048

FROM_VESSEL_TO_VESSEL = frozenset(
    (
        dialect.MAVLINK_MSG_ID_HEARTBEAT,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    )
)
"""Broadcasts that other vessels get too. The traffic would grow with the square of the fleet if all telemetry went to
all.
"""

_BYTES = {"char": 1, "int8_t": 1, "uint8_t": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4}
_BYTES |= {"float": 4, "int64_t": 8, "uint64_t": 8, "double": 8}
_AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
_SO_RXQ_OVFL = 40  # Linux: number of datagrams that a socket dropped because it was full


def _target_offsets() -> dict[int, tuple[int, int | None]]:
    """Return the payload offsets of target system and target component by message.

    The component is None if there is none.
    """
    targets = {}
    for number, kind in dialect.mavlink_map.items():
        at, offsets = 0, {}
        for index, name in enumerate(kind.ordered_fieldnames):
            offsets[name] = at
            at += _BYTES[kind.fieldtypes[kind.fieldnames.index(name)]] * max(kind.array_lengths[index], 1)
        system = offsets.get("target_system", offsets.get("target"))
        if system is not None:
            targets[number] = system, offsets.get("target_component")
    return targets


TARGETS = _target_offsets()


@dataclass(slots=True)
class RouterCounts:
    """Counts of the router."""

    frames_in: int = 0
    """Valid frames."""
    frames_out: int = 0
    """Forwarded frames, counted for each destination."""
    dropped: int = 0
    """Frames that a destination did not accept."""
    unroutable: int = 0
    """Frames for an unknown system."""
    looped: int = 0
    """Frames from a vessel's system at another endpoint."""
    damaged: int = 0
    """Events of bytes that were no frame."""
    overrun: int = 0
    """Datagrams of vessels that the full socket dropped."""
    stations: int = 0
    """Stations that connected or answered."""
    turned_away: int = 0
    """Connections above `MOST_STATIONS`, or above the number of vessels' endpoints."""
    stuck: int = 0
    """Stations that read nothing for too long."""


class Endpoint(ABC):
    """Source and destination of frames.

    heard: (system, component) of all senders there. vessel: False for a station. component: it is a part of a vessel
    whose autopilot is elsewhere.
    """

    def __init__(self, name: str, stream: bool, vessel: bool, component: bool = False) -> None:
        self.name = name
        self.vessel = vessel
        self.component = component
        self.heard: set[tuple[int, int]] = set()
        self.systems: set[int] = set()
        self.heard_s = 0.0
        self._framer = Framer(stream, foreign=True, mavlink1=True)

    def frames_in(self, chunk: bytes) -> list[bytes]:
        """Return the valid frames that end in this chunk, in MAVLink 2 format; see `as_received`."""
        return self._framer.feed(chunk)

    @property
    def damaged(self) -> int:
        """Events of bytes that were no frame."""
        return self._framer.counters.dropped

    @abstractmethod
    def send(self, frames: list[bytes]) -> int:
        """Forward frames without waiting. Returns the number of frames dropped for lack of space."""

    def close(self) -> None:  # noqa: B027  most endpoints have nothing to close
        """End the connection."""


class TransportEndpoint(Endpoint):
    """A station that connected or that the router sends to, or a vessel that the router calls."""

    def __init__(self, transport: TcpTransport | UdpTransport, name: str, vessel: bool) -> None:
        super().__init__(name, transport.stream, vessel)
        self.transport = transport
        self.stuck_s: float | None = None
        self.watched: tuple[int, int] | None = None

    def send(self, frames: list[bytes]) -> int:
        transport = self.transport
        if isinstance(transport, TcpTransport):
            if not transport.connected:
                return 0
            return 0 if transport.send(b"".join(frames)) else len(frames)
        dropped = 0
        for datagram, count in _datagrams(frames):
            refused = transport.refused
            if not transport.send(datagram) and transport.refused == refused:
                dropped += count
        return dropped

    def close(self) -> None:
        self.transport.close()


class DatagramEndpoint(Endpoint):
    """A vessel, or a component of one, that sends to the common port."""

    def __init__(self, sock: socket.socket, address: tuple[str, int], component: bool) -> None:
        super().__init__(f"udp://{address[0]}:{address[1]}", stream=False, vessel=True, component=component)
        self.address = address
        self._socket = sock

    def send(self, frames: list[bytes]) -> int:
        dropped = 0
        for datagram, count in _datagrams(frames):
            try:
                self._socket.sendto(datagram, self.address)
            except ConnectionRefusedError:
                pass  # the vessel has gone
            except OSError:
                dropped += count
        return dropped


def _datagrams(frames: list[bytes]) -> list[tuple[bytes, int]]:
    """Pack frames into as few datagrams as possible. Returns each datagram and its number of frames."""
    datagrams: list[tuple[bytes, int]] = []
    packed: list[bytes] = []
    size = 0
    for frame in frames:
        if packed and size + len(frame) > DATAGRAM_BYTES:
            datagrams.append((b"".join(packed), len(packed)))
            packed, size = [], 0
        packed.append(frame)
        size += len(frame)
    if packed:
        datagrams.append((b"".join(packed), len(packed)))
    return datagrams


class Router:
    """Listens at `tcp://address:port` and sends to `udp://host:port` of `stations`. Raises TransportError."""

    def __init__(self, stations: Sequence[str]) -> None:
        self.counts = RouterCounts()
        self.owners: dict[int, Endpoint] = {}
        self._damaged_before = 0
        self._endpoints: list[Endpoint] = []
        self._listeners: list[TcpListener] = []
        self._to_call: dict[tuple[str, int], float] = {}
        self._look_s = 0.0
        self._selector = selectors.DefaultSelector()
        self._vessels, self._components = self._datagram_port(False), self._datagram_port(True)
        self._overruns = {self._vessels: 0, self._components: 0}
        self._datagrams: dict[tuple[str, int], DatagramEndpoint] = {}
        try:
            for url in stations:
                if url.startswith("tcp://"):
                    listener = TcpListener(urlsplit(url))
                    self._listeners.append(listener)
                    self._selector.register(
                        listener.fileno() or -1, selectors.EVENT_READ, partial(self._accept, listener)
                    )
                    continue
                transport = open_transport(url, listen=False)
                assert isinstance(transport, UdpTransport)
                transport.longest = LARGEST
                self._add(TransportEndpoint(transport, url, vessel=False))
        except TransportError:
            self.close()
            raise

    def _datagram_port(self, components: bool) -> socket.socket:
        """Return a socket to which the vessels of this machine send, or their components."""
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setblocking(False)
        sock.bind(("127.0.0.1", 0))
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, BUFFER_BYTES)
        if sys.platform == "linux":
            sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        self._selector.register(sock, selectors.EVENT_READ, partial(self._from_vessels, sock, components))
        return sock

    @property
    def vessels_url(self) -> str:
        """The address that vessels send to."""
        return f"udp://127.0.0.1:{self._vessels.getsockname()[1]}"

    @property
    def components_url(self) -> str:
        """The address that components of vessels send to."""
        return f"udp://127.0.0.1:{self._components.getsockname()[1]}"

    @property
    def stations(self) -> tuple[str, ...]:
        """The addresses at which stations may connect, then those that the router sends to."""
        sent_to = [
            endpoint.name for endpoint in self._endpoints if not endpoint.vessel and endpoint.name.startswith("udp")
        ]
        return (*(listener.address for listener in self._listeners), *sent_to)

    def call(self, url: str) -> None:
        """Call a vessel repeatedly until it answers. Raises TransportError."""
        parts = urlsplit(url)
        if parts.scheme == "udp":
            address = (socket.gethostbyname(parts.hostname or ""), parts.port or 0)
            self._to_call[address] = 0.0
            self._vessel_at(self._vessels, False, address)
            return
        self._add(TransportEndpoint(TcpCaller(parts), url, vessel=True))

    def poll(self, timeout_s: float) -> None:
        """Forward the frames that have arrived; wait for them at most `timeout_s`."""
        for key, _ in self._selector.select(min(timeout_s, LOOK_S)):
            key.data()
        now_s = monotonic()
        if now_s - self._look_s >= LOOK_S:
            self._look_s = now_s
            self._check_endpoints(now_s)

    def report(self) -> dict[str, object]:
        """Return the counts, and the endpoints of the known systems, as plain data."""
        counts = self.counts
        counts.damaged = self._damaged_before + sum(endpoint.damaged for endpoint in self._endpoints)
        return asdict(counts) | {
            "systems": {str(system): endpoint.name for system, endpoint in sorted(self.owners.items())}
        }

    def close(self) -> None:
        """Close all connections."""
        self._selector.close()
        for endpoint in self._endpoints:
            endpoint.close()
        for listener in self._listeners:
            listener.close()
        self._vessels.close()
        self._components.close()

    # Endpoints

    def _accept(self, listener: TcpListener) -> None:
        connection = listener.accept()
        if connection is None:
            return
        sock, peer = connection
        stations = sum(not endpoint.vessel for endpoint in self._endpoints)
        if stations >= MOST_STATIONS:
            sock.close()
            self.counts.turned_away += 1
            return
        self._add(TransportEndpoint(TcpAccepted(sock, listener.address, peer), peer, vessel=False))

    def _add(self, endpoint: TransportEndpoint) -> None:
        self._endpoints.append(endpoint)
        self._watch(endpoint)

    def watch(self, descriptor: int, handle: Callable[[], None]) -> None:
        """Call `handle` in `poll` when there is something to read."""
        self._selector.register(descriptor, selectors.EVENT_READ, handle)

    def _watch(self, endpoint: TransportEndpoint) -> None:
        """Watch the current connection of an endpoint. A call may have lost its connection and opened another."""
        transport = endpoint.transport
        descriptor, losses = transport.fileno(), transport.losses if isinstance(transport, TcpTransport) else 0
        now = None if descriptor is None else (descriptor, losses)
        if now == endpoint.watched:
            return
        if endpoint.watched is not None:
            with suppress(KeyError, ValueError):
                self._selector.unregister(endpoint.watched[0])
        endpoint.watched = now
        if descriptor is not None:
            self._selector.register(descriptor, selectors.EVENT_READ, lambda: self._from_endpoint(endpoint))

    def _check_endpoints(self, now_s: float) -> None:
        """Drop stations that have left or are stuck, and call vessels that have to be called."""
        for endpoint in [endpoint for endpoint in self._endpoints if isinstance(endpoint, TransportEndpoint)]:
            transport = endpoint.transport
            if isinstance(transport, TcpCaller):
                transport.send(b"")  # connects again
                self._watch(endpoint)
            elif isinstance(transport, TcpTransport):
                if not transport.connected:
                    self._let_go(endpoint)
                elif not transport.stuck:
                    endpoint.stuck_s = None
                elif endpoint.stuck_s is None:
                    endpoint.stuck_s = now_s
                elif now_s - endpoint.stuck_s > STUCK_S:
                    self.counts.stuck += 1
                    self._let_go(endpoint)
        for address, called_s in self._to_call.items():
            if not self._datagrams[address].systems and now_s - called_s >= AGAIN_S:
                self._to_call[address] = now_s
                try:
                    self._vessels.sendto(b"", address)  # a PX4 treats the first sender as its ground station
                except OSError:
                    continue

    def _let_go(self, endpoint: TransportEndpoint) -> None:
        self._damaged_before += endpoint.damaged
        self._endpoints.remove(endpoint)
        endpoint.close()
        self._watch(endpoint)

    # Frames

    def _from_endpoint(self, endpoint: TransportEndpoint) -> None:
        transport = endpoint.transport
        chunks = transport.receive(0.0)
        for chunk in chunks:
            self._pass_on(endpoint, endpoint.frames_in(chunk))
        if isinstance(transport, TcpTransport) and not transport.connected:
            if isinstance(transport, TcpCaller):
                self._watch(endpoint)
            else:
                self._let_go(endpoint)

    def _from_vessels(self, sock: socket.socket, components: bool) -> None:
        for _ in range(BATCH):
            try:
                data, extra, _, address = sock.recvmsg(LARGEST, 64)
            except OSError:  # no more data, or the error of an earlier datagram without a receiver
                return
            for level, kind, value in extra:
                if (level, kind) == (socket.SOL_SOCKET, _SO_RXQ_OVFL):
                    self._overruns[sock] = struct.unpack("=I", value[:4])[0]
                    self.counts.overrun = sum(self._overruns.values())
            endpoint = self._vessel_at(sock, components, address)
            if endpoint is not None:
                self._pass_on(endpoint, endpoint.frames_in(data))

    def _vessel_at(self, sock: socket.socket, component: bool, address: tuple[str, int]) -> DatagramEndpoint | None:
        endpoint = self._datagrams.get(address)
        if endpoint is None:
            if len(self._datagrams) >= MOST_VESSELS:
                self.counts.turned_away += 1
                return None
            endpoint = self._datagrams[address] = DatagramEndpoint(sock, address, component)
            self._endpoints.append(endpoint)
        return endpoint

    def _pass_on(self, source: Endpoint, frames: list[bytes]) -> None:
        """Forward each frame to its destinations, grouped by destination."""
        outgoing: dict[Endpoint, list[bytes]] = {}
        for frame in frames:
            sender = (frame[5], frame[6])
            if not self._is_at_home(source, *sender):
                self.counts.looped += 1
                continue
            self.counts.frames_in += 1
            if sender not in source.heard:
                self.counts.stations += not source.vessel and not source.heard
                source.heard.add(sender)
                source.systems.add(sender[0])
            for endpoint in self._destinations(source, frame, sender):
                outgoing.setdefault(endpoint, []).append(as_received(frame))
        for endpoint, leaving in outgoing.items():
            dropped = endpoint.send(leaving)
            self.counts.dropped += dropped
            self.counts.frames_out += len(leaving) - dropped

    def _is_at_home(self, source: Endpoint, system: int, component: int) -> bool:
        """Whether a frame of this system comes from the system's endpoint. A vessel that was silent may move.

        A component has no endpoint of its own, and never speaks as the autopilot.
        """
        if source.component:
            return component != _AUTOPILOT
        owner = self.owners.get(system)
        if owner is source:
            source.heard_s = monotonic()
            return True
        if owner is None:
            if source.vessel:
                self.owners[system] = source
                source.heard_s = monotonic()
            return True
        if source.vessel and monotonic() - owner.heard_s > MOVED_S:
            owner.systems.discard(system)
            owner.heard = {sender for sender in owner.heard if sender[0] != system}
            self.owners[system] = source
            source.heard_s = monotonic()
            return True
        return False

    def _destinations(self, source: Endpoint, frame: bytes, sender: tuple[int, int]) -> list[Endpoint]:
        number = frame[7] | frame[8] << 8 | frame[9] << 16
        system = component = 0  # for all
        target = TARGETS.get(number)
        if target is not None:
            system_at, component_at = target
            end = 10 + frame[1]  # trailing zeros are not sent
            if 10 + system_at < end:
                system = frame[10 + system_at]
            if component_at is not None and 10 + component_at < end:
                component = frame[10 + component_at]
        others = [endpoint for endpoint in self._endpoints if endpoint is not source and sender not in endpoint.heard]
        if not system:
            if source.component or (source.vessel and number not in FROM_VESSEL_TO_VESSEL):
                return [endpoint for endpoint in others if not endpoint.vessel]
            return others
        there = [endpoint for endpoint in others if system in endpoint.systems]
        exactly = [endpoint for endpoint in there if (system, component) in endpoint.heard] if component else []
        if not there and system not in source.systems:
            self.counts.unroutable += 1
        return exactly or there


def main(urls: Sequence[str]) -> int:
    """Run until the end of the input. Returns 2 and writes one sentence when a port is not available."""
    try:
        router = Router(urls)
    except TransportError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    _say({"vessels": router.vessels_url, "components": router.components_url, "stations": router.stations})
    calls = _Lines(router)
    router.watch(sys.stdin.fileno(), calls.read)
    try:
        while not calls.ended:
            router.poll(LOOK_S)
        _say(router.report())
    finally:
        router.close()
    return 0


class _Lines:
    """Addresses of vessels to call, one a line, until the end of the input."""

    def __init__(self, router: Router) -> None:
        self.ended = False
        self._router = router
        self._begun = b""

    def read(self) -> None:
        data = os.read(sys.stdin.fileno(), 4096)
        self.ended = not data
        *lines, self._begun = (self._begun + data).split(b"\n")
        for line in lines:
            self._router.call(line.decode())


def _say(message: object) -> None:
    sys.stdout.write(f"{json.dumps(message)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
