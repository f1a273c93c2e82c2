"""Services of ROS 2 without an installed ROS: a separate participant that implements RTPS.

A parameter of the response's message identifies its request (`related sample identity`, DDS-RPC 7.3.2, as in
rmw_fastrtps). Cyclone DDS does not let applications write it. Clients of rmw_cyclonedds put 16 bytes before the
request, and expect them before the response.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import field
from functools import partial
from itertools import count
from operator import attrgetter

from agent.timing.clock import wait_readable
from sim_core.dataclass import dataclass
from xitl_cli.plugins.ros import rtps
from xitl_cli.plugins.ros.rtps import Submessage

GROUP, LOOPBACK = "239.255.0.1", "127.0.0.1"
IP_MULTICAST_ALL = 49
"""Constant of Linux (ip(7)); Python has no name for it."""
LOCAL_PARTICIPANTS = range(32)
"""Participants of this machine, by number, that receive announcements without multicast."""
ANNOUNCED_S = (0.1, 3.0)
"""Interval of announcements: of the first ten, and later."""
FIRST_ANNOUNCEMENTS = 10
LEASE_S = 20
HEARTBEAT_S = 0.5
PARTICIPANTS = range(120)
KEPT_RESPONSES = 32
HEADER_BYTES, CYCLONE_HEADER_BYTES = 4, 16
MOST_IN_PACKET = 12
"""Descriptions of endpoints in a packet."""
MOST_PARTICIPANTS, MOST_ENDPOINTS, MOST_LOCATORS = 512, 256, 8
"""Limits: known participants; endpoints of a participant; its addresses."""
MOST_AHEAD = 1024
"""Largest number of samples of a writer that are noted ahead of a missing one."""
MOST_AT_ONCE = 256
"""Packets per turn, before the other socket and the clock have their turn."""
_SEDP = (
    (rtps.PUBLICATIONS_WRITER, rtps.PUBLICATIONS_READER),
    (rtps.SUBSCRIPTIONS_WRITER, rtps.SUBSCRIPTIONS_READER),
)
_SEDP_READERS = dict(_SEDP)
_ENDPOINTS = 0x3F  # announces and detects participants, publications and subscriptions


class Received:
    """Received samples of a writer. A sample that is `MOST_AHEAD` behind another is given up."""

    def __init__(self) -> None:
        self._base = 1
        self._beyond: set[int] = set()

    def add(self, number: int) -> bool:
        """Return True if it is new."""
        if number < self._base or number in self._beyond:
            return False
        if number >= self._base + MOST_AHEAD:
            self.skip_to(number - MOST_AHEAD + 1)
        self._beyond.add(number)
        self._advance()
        return True

    def skip(self, first: int, end: int) -> None:
        """Mark the samples from `first` to before `end` as lost. Later ones are noted up to the number that can be
        requested.
        """
        if first <= self._base:
            self.skip_to(end)
        else:
            self._beyond.update(range(first, min(end, self._base + rtps.MOST_BITS)))

    def skip_to(self, first: int) -> None:
        """Mark the samples before `first` as lost."""
        if first <= self._base:
            return
        self._base = first
        self._beyond = {number for number in self._beyond if number >= self._base}
        self._advance()

    def missing(self, last: int) -> tuple[int, list[int]]:
        """Return the first missing sample, and all missing ones up to `last`."""
        end = min(last + 1, self._base + rtps.MOST_BITS)
        return self._base, [number for number in range(self._base, end) if number not in self._beyond]

    def _advance(self) -> None:
        while self._base in self._beyond:
            self._beyond.remove(self._base)
            self._base += 1


@dataclass(slots=True)
class Remote:
    """Another participant."""

    prefix: bytes
    meta: list[tuple[str, int]]
    user: list[tuple[str, int]]
    heard_s: float
    lease_s: float
    readers: dict[bytes, str] = field(default_factory=dict)
    """Readers of responses, by GUID, with their topic."""
    requesters: dict[bytes, RtpsService] = field(default_factory=dict)
    """Writers of requests, by GUID."""
    received: dict[bytes, Received] = field(default_factory=dict)
    acked: dict[bytes, int] = field(default_factory=dict)
    """Acknowledged samples, by local writer."""


@dataclass(slots=True)
class RtpsService:
    """A local service."""

    name: str
    type: str
    reader: bytes
    """Reader of requests."""
    writer: bytes
    """Writer of responses."""
    responses: dict[int, tuple[bytes, tuple[tuple[int, bytes], ...]]] = field(default_factory=dict)
    """Responses kept for readers that have not received them."""
    last: int = 0

    @property
    def request_topic(self) -> str:
        return f"rq{self.name}Request"

    @property
    def response_topic(self) -> str:
        return f"rr{self.name}Reply"


@dataclass(frozen=True, slots=True)
class ServiceRequest:
    """A received request, with the destination of its response."""

    service: RtpsService
    cdr: bytes
    """CDR of the request."""
    writer: bytes
    """GUID of the client's writer."""
    identity: bytes
    """Parameter that relates the response to the request."""
    before: bytes
    """Header of a client of Cyclone DDS, which its response repeats."""

    def response(self, cdr: bytes) -> bytes:
        """Return the payload of the response for its CDR."""
        return cdr[:HEADER_BYTES] + self.before + cdr[HEADER_BYTES:]


class RtpsServices:
    """Serves in a domain, in a separate thread, which calls `on_request` with each request; call `respond` later.

    local: only on this machine. Raises OSError if the network is not available.
    """

    def __init__(self, domain: int, on_request: Callable[[ServiceRequest], object], local: bool = False) -> None:
        self._domain = domain
        self._on_request = on_request
        self._prefix = rtps.UNKNOWN_VENDOR + os.urandom(rtps.PREFIX_BYTES - 2)
        self._keys = count(1)
        self._counts = count(1)
        self._services: list[RtpsService] = []
        self._descriptions: dict[bytes, list[bytes]] = {writer: [] for writer, _ in _SEDP}
        self.remotes: dict[bytes, Remote] = {}
        """Known participants by prefix."""
        self._lock = threading.RLock()
        self._local = local
        self._address = LOOPBACK if local else own_address()
        self._unicast, self.port = self._bind_unicast()
        self._multicast = self._join()
        self.announced = 0
        """Number of announcements."""
        self.refused = 0
        """Number of submessages that were invalid or exceeded a limit."""
        self._next_s = self._beat_s = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="rtps", daemon=True)
        self._thread.start()

    def serve(self, name: str, type_name: str) -> RtpsService:
        """Offer a service from now on; type_name such as `std_srvs/srv/Trigger`."""
        key = next(self._keys).to_bytes(3, "big")
        service = RtpsService(name, type_name, key + rtps.READER_KIND, key + rtps.WRITER_KIND)
        package, kind, last = type_name.split("/")
        typed = f"{package}::{kind}::dds_::{last}"
        with self._lock:
            self._services.append(service)
            self._describe(rtps.SUBSCRIPTIONS_WRITER, service.reader, service.request_topic, f"{typed}_Request_")
            self._describe(rtps.PUBLICATIONS_WRITER, service.writer, service.response_topic, f"{typed}_Response_")
            for remote in self.remotes.values():
                self._tell_endpoints(remote)
        return service

    def respond(self, request: ServiceRequest, cdr: bytes) -> None:
        """Send the response to all readers of this service's responses: each selects its responses."""
        service = request.service
        related = tuple((pid, request.identity) for pid in (rtps.PID_RELATED, rtps.PID_RELATED_EPROSIMA))
        with self._lock:
            service.last += 1
            service.responses[service.last] = request.response(cdr), related
            service.responses.pop(service.last - KEPT_RESPONSES, None)
            for remote in self.remotes.values():
                if service.response_topic in remote.readers.values():
                    self._send_responses(remote, service, [service.last])

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the GUIDs of all readers and of all writers."""
        with self._lock:
            services = list(self._services)
        readers = [self._prefix + service.reader for service in services]
        return readers, [self._prefix + service.writer for service in services]

    def close(self) -> None:
        """Close the sockets. A second call does nothing."""
        self._over.set()
        self._thread.join()
        self._unicast.close()
        self._multicast.close()

    # Sockets

    def _bind_unicast(self) -> tuple[socket.socket, int]:
        """Bind the first free port of a participant."""
        for number in PARTICIPANTS:
            port = 7410 + 250 * self._domain + 2 * number
            if port > 65535:
                break
            end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                end.bind((LOOPBACK if self._local else "", port))
            except OSError:
                end.close()
                continue
            end.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(self._address))
            end.setblocking(False)
            return end, port
        raise OSError(f"domain {self._domain}: no port of a participant is free")

    def _join(self) -> socket.socket:
        """Open a socket for packets to the group. With `local`, packets from other interfaces are excluded."""
        end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        port = 7400 + 250 * self._domain
        if not self._local:
            end.bind(("", port))
        elif sys.platform == "win32":  # cannot bind to a group
            end.bind((LOOPBACK, port))
        else:
            end.bind((GROUP, port))
        if sys.platform == "linux":
            end.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)  # without groups that other sockets have joined
        for address in dict.fromkeys((self._address, LOOPBACK)):
            membership = socket.inet_aton(GROUP) + socket.inet_aton(address)
            try:
                end.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            except OSError:  # an interface without multicast
                continue
        end.setblocking(False)
        return end

    def _run(self) -> None:
        while not self._over.is_set():
            wait_readable((self._unicast.fileno(), self._multicast.fileno()), 0.05)
            self._read(self._unicast)
            self._read(self._multicast)
            with self._lock:
                now_s = time.monotonic()
                if now_s >= self._next_s:
                    self._next_s = now_s + ANNOUNCED_S[0 if self.announced < FIRST_ANNOUNCEMENTS else 1]
                    self.announced += 1
                    self._announce()
                if now_s >= self._beat_s:
                    self._beat_s = now_s + HEARTBEAT_S
                    for remote in [gone for gone in self.remotes.values() if now_s - gone.heard_s > gone.lease_s]:
                        del self.remotes[remote.prefix]
                    for remote in self.remotes.values():
                        self._send_heartbeats(remote)

    def _read(self, end: socket.socket) -> None:
        for _ in range(MOST_AT_ONCE):
            try:
                received = end.recv(65536)
            except OSError:
                return
            packet = rtps.read_packet(received)
            if packet is None or packet.prefix == self._prefix:
                continue
            with self._lock:
                for destination, part in packet.parts:
                    if destination in (self._prefix, b"\0" * rtps.PREFIX_BYTES):
                        try:
                            self._on_submessage(packet.prefix, packet.vendor, part)
                        except (struct.error, IndexError, ValueError):
                            self.refused += 1

    def _send(self, to: list[tuple[str, int]], parts: list[bytes], prefix: bytes = b"") -> None:
        message = rtps.packet(self._prefix, parts, prefix)
        for address in to:
            try:
                self._unicast.sendto(message, address)
            except OSError:  # the peer will request it again
                continue

    # Discovery

    def _announce(self) -> None:
        """Announce to the group, and to each known participant, which may not receive the group."""
        base = 7400 + 250 * self._domain
        self._send([(GROUP, base)], [self._announcement()])
        to = dict.fromkeys(place for remote in self.remotes.values() for place in remote.meta)
        if self._local:
            to |= dict.fromkeys((LOOPBACK, base + 10 + 2 * number) for number in LOCAL_PARTICIPANTS)
        self._send(list(to), [self._announcement()])

    def _announcement(self) -> bytes:
        place = rtps.locator(self._address, self.port)
        values = [
            (rtps.PID_VERSION, rtps.VERSION),
            (rtps.PID_VENDOR, rtps.UNKNOWN_VENDOR),
            (rtps.PID_PARTICIPANT_GUID, self._prefix + rtps.PARTICIPANT),
            (rtps.PID_ENDPOINTS, struct.pack("<I", _ENDPOINTS)),
            (rtps.PID_META_UNICAST, place),
            (rtps.PID_DEFAULT_UNICAST, place),
            (rtps.PID_LEASE, struct.pack("<iI", LEASE_S, 0)),
            (rtps.PID_USER_DATA, rtps.text("enclave=/;")),
        ]
        payload = rtps.PARAMETERS_LE + rtps.parameters(values)
        return rtps.data(rtps.NO_ENTITY, rtps.SPDP_WRITER, 1, payload)

    def _describe(self, writer: bytes, entity: bytes, topic: str, type_name: str) -> None:
        values = [
            (rtps.PID_ENDPOINT_GUID, self._prefix + entity),
            (rtps.PID_PARTICIPANT_GUID, self._prefix + rtps.PARTICIPANT),
            (rtps.PID_TOPIC, rtps.text(topic)),
            (rtps.PID_TYPE, rtps.text(type_name)),
            (rtps.PID_RELIABILITY, rtps.RELIABLE),
            (rtps.PID_DURABILITY, rtps.VOLATILE),
            (rtps.PID_REPRESENTATION, struct.pack("<Ihxx", 1, 0)),
            (rtps.PID_UNICAST, rtps.locator(self._address, self.port)),
        ]
        self._descriptions[writer].append(rtps.PARAMETERS_LE + rtps.parameters(values))

    def _tell_endpoints(self, remote: Remote) -> None:
        for writer, reader in _SEDP:
            last = len(self._descriptions[writer])
            self._send_descriptions(remote, writer, reader, range(remote.acked.get(writer, 0) + 1, last + 1))

    def _send_descriptions(self, remote: Remote, writer: bytes, reader: bytes, numbers: range | list[int]) -> None:
        known = self._descriptions[writer]
        parts = [rtps.data(reader, writer, number, known[number - 1]) for number in numbers if 0 < number <= len(known)]
        beat = rtps.heartbeat(reader, writer, 1, len(known), next(self._counts))
        for start in range(0, max(len(parts), 1), MOST_IN_PACKET):
            self._send(remote.meta, [*parts[start : start + MOST_IN_PACKET], beat], remote.prefix)

    def _send_heartbeats(self, remote: Remote) -> None:
        """Send heartbeats to a participant that has not confirmed all samples."""
        for writer, reader in _SEDP:
            last = len(self._descriptions[writer])
            if remote.acked.get(writer, 0) < last:
                beat = rtps.heartbeat(reader, writer, 1, last, next(self._counts))
                self._send(remote.meta, [beat], remote.prefix)
        for service in self._services:
            if service.last > remote.acked.get(service.writer, 0) and service.response_topic in remote.readers.values():
                self._send_responses(remote, service, [])

    def _send_responses(self, remote: Remote, service: RtpsService, numbers: list[int]) -> None:
        known = [(number, *service.responses[number]) for number in numbers if number in service.responses]
        parts = [rtps.data(rtps.NO_ENTITY, service.writer, *response) for response in known]
        first = min(service.responses, default=service.last + 1)
        parts.append(rtps.heartbeat(rtps.NO_ENTITY, service.writer, first, service.last, next(self._counts)))
        self._send(remote.user or remote.meta, parts, remote.prefix)

    # Received submessages

    def _on_submessage(self, prefix: bytes, vendor: bytes, part: Submessage) -> None:
        if part.writer == rtps.SPDP_WRITER:
            if part.kind == rtps.DATA:
                self._on_participant(prefix, part)
            return
        remote = self.remotes.get(prefix)
        if remote is None:
            return
        remote.heard_s = time.monotonic()
        if part.kind == rtps.ACKNACK:
            self._on_acknack(remote, part)
            return
        if part.writer in _SEDP_READERS:
            self._on_writer(remote, part, _SEDP_READERS[part.writer], remote.meta, self._on_endpoint)
            return
        by_reader = (known for known in self._services if known.reader == part.reader)
        service = remote.requesters.get(prefix + part.writer) or next(by_reader, None)
        if service is not None:
            to = remote.user or remote.meta
            self._on_writer(remote, part, service.reader, to, partial(self._on_sample, service, vendor))

    def _on_participant(self, prefix: bytes, part: Submessage) -> None:
        if part.inline.get(rtps.PID_STATUS, b"\0")[-1] & 3:
            self.remotes.pop(prefix, None)
            return
        order, values = rtps.number_order(part.payload), rtps.read_parameters(part.payload)
        meta, user = (
            [place for value in values.get(pid, []) if (place := rtps.read_locator(value, order))][:MOST_LOCATORS]
            for pid in (rtps.PID_META_UNICAST, rtps.PID_DEFAULT_UNICAST)
        )
        lease_s = struct.unpack(f"{order}iI", values.get(rtps.PID_LEASE, [b"\0\0\0\x14\0\0\0\0"])[0][:8])[0]
        known = self.remotes.get(prefix)
        if known is not None:
            known.heard_s = time.monotonic()
        elif meta:
            if len(self.remotes) >= MOST_PARTICIPANTS:
                del self.remotes[min(self.remotes.values(), key=attrgetter("heard_s")).prefix]
                self.refused += 1
            remote = Remote(prefix, meta, user, time.monotonic(), max(float(lease_s), 1.0))
            self.remotes[prefix] = remote
            self._send(meta, [self._announcement()])
            self._tell_endpoints(remote)

    def _on_acknack(self, remote: Remote, part: Submessage) -> None:
        confirmed = max(part.first - 1, 0)
        for writer, reader in _SEDP:
            if part.writer == writer:
                remote.acked[writer] = confirmed
                if part.numbers or not part.final:
                    self._send_descriptions(remote, writer, reader, list(part.numbers))
                return
        for service in self._services:
            if service.writer == part.writer:
                remote.acked[service.writer] = confirmed
                if part.numbers or not part.final:
                    self._send_responses(remote, service, list(part.numbers))

    def _on_writer(
        self,
        remote: Remote,
        part: Submessage,
        reader: bytes,
        to: list[tuple[str, int]],
        sample: Callable[[Remote, Submessage], object],
    ) -> None:
        """Process each sample once, and request missing samples."""
        _check_room(remote.received, part.writer)
        received = remote.received.setdefault(part.writer, Received())
        if part.kind == rtps.DATA:
            if received.add(part.first):
                sample(remote, part)
        elif part.kind == rtps.GAP:
            received.skip(part.first, part.last)
            for number in part.numbers:
                received.skip(number, number + 1)
        elif part.kind == rtps.HEARTBEAT:
            received.skip_to(part.first)
            base, missing = received.missing(part.last)
            if missing or not part.final:
                answer = rtps.acknack(reader, part.writer, base, missing, next(self._counts))
                self._send(to, [answer], remote.prefix)

    def _on_sample(self, service: RtpsService, vendor: bytes, remote: Remote, part: Submessage) -> None:
        """Pass a request on, with the identity and the header that its response needs."""
        payload, before = part.payload, b""
        if vendor == rtps.CYCLONE:
            end = HEADER_BYTES + CYCLONE_HEADER_BYTES
            payload, before = payload[:HEADER_BYTES] + payload[end:], payload[HEADER_BYTES:end]
        related = (part.inline.get(pid, b"")[:16] for pid in (rtps.PID_RELATED, rtps.PID_RELATED_EPROSIMA))
        writer = remote.prefix + part.writer
        client = next((guid for guid in related if len(guid) == 16 and any(guid)), writer)
        identity = client + rtps.sequence_number(part.first)
        self._on_request(ServiceRequest(service, payload, writer, identity, before))

    def _on_endpoint(self, remote: Remote, part: Submessage) -> None:
        """Process a new or removed reader of responses or writer of requests."""
        order, values = rtps.number_order(part.payload), rtps.read_parameters(part.payload)
        guid = values.get(rtps.PID_ENDPOINT_GUID, [part.inline.get(rtps.PID_KEY, b"")])[0][:16]
        if part.inline.get(rtps.PID_STATUS, b"\0")[-1] & 3:
            remote.readers.pop(guid, None)
            remote.requesters.pop(guid, None)
            return
        topic = rtps.read_text(values.get(rtps.PID_TOPIC, [b""])[0], order)
        for service in self._services:
            if part.writer == rtps.PUBLICATIONS_WRITER and topic == service.request_topic:
                _check_room(remote.requesters, guid)
                remote.requesters[guid] = service
            elif part.writer == rtps.SUBSCRIPTIONS_WRITER and topic == service.response_topic:
                _check_room(remote.readers, guid)
                remote.readers[guid] = topic


def _check_room(table: Mapping[bytes, object], key: bytes) -> None:
    """Raises ValueError if a participant exceeds a limit."""
    if key not in table and len(table) >= MOST_ENDPOINTS:
        raise ValueError(f"more than {MOST_ENDPOINTS} endpoints of a participant")


def own_address() -> str:
    """Return the address by which others in the network reach this machine; the loopback's without a network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        try:
            end.connect((GROUP, 7400))
        except OSError:
            return LOOPBACK
        address: str = end.getsockname()[0]
        return address
