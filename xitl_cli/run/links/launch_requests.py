"""Requests to put a body into the water, XITL_LAUNCH by UDP: the port of a run, and the client."""

from __future__ import annotations

import math
import os
import socket
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict
from urllib.parse import urlsplit

from agent.wire import dialect
from agent.wire.codec import Packer, decode
from agent.wire.framing import Framer
from agent.wire.link import Link
from agent.wire.transport import Transport, TransportError, open_transport
from agent.wire.urls import Address, address_url, resolve, transport_error
from sim_core.dataclass import dataclass
from sim_core.world.debris import BodyKind, Launch
from xitl_cli.errors import UserError
from xitl_cli.run.links.peer import HOST_COMPONENT_ID, HOST_SYSTEM_ID

LARGEST = 2048
AT_ONCE = 32  # datagrams in one call, so that a flood does not hold up the run
REMEMBERED = 64
FARTHEST_M = 100e3

Ask = Callable[[Launch], bool]
"""Puts the body into the water; returns False when that is impossible."""


@dataclass(slots=True)
class LaunchCounts:
    """Counts of requests."""

    asked: int = 0
    """New requests."""
    again: int = 0
    """Repeated requests."""
    refused: int = 0
    """Requests that were refused."""
    dropped: int = 0
    """Datagrams without a request."""


class LaunchPort:
    """A bound socket; see the module."""

    def __init__(self, url: str) -> None:
        """Raises UserError when it cannot listen at `url`."""
        parts = urlsplit(url)
        try:
            family, kind, protocol, _, target = resolve(parts, True, socket.SOCK_DGRAM)
            self._socket = socket.socket(family, kind, protocol)
        except TransportError as error:
            raise UserError(f"world.debris.control: {error}") from error
        try:
            self._socket.setblocking(False)
            self._socket.bind(target)
        except OSError as error:
            self._socket.close()
            raise UserError(f"world.debris.control: {transport_error(error, parts, True)}") from None
        self.address = address_url("udp", self._socket.getsockname())
        self.counts = LaunchCounts()
        self._packer = Packer(HOST_SYSTEM_ID, HOST_COMPONENT_ID)
        self._answers: OrderedDict[tuple[Address, int], int] = OrderedDict()

    def serve(self, now_ns: int, ask: Ask) -> None:
        """Read and answer the requests that have arrived."""
        for _ in range(AT_ONCE):
            try:
                data, source = self._socket.recvfrom(LARGEST)
            except BlockingIOError:
                return
            except OSError:  # an earlier answer went to a socket that is gone
                continue
            requests = [
                message
                for message in map(decode, Framer(stream=False).feed(data))
                if isinstance(message, dialect.MAVLink_xitl_launch_message)
            ]
            self.counts.dropped += not requests
            for request in requests:
                self._answer(request, source, now_ns, ask)

    def report(self) -> dict[str, int]:
        """Return the counts by name."""
        return asdict(self.counts)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _answer(self, request: dialect.MAVLink_xitl_launch_message, source: Address, now_ns: int, ask: Ask) -> None:
        key = (source, request.request)
        result = self._answers.get(key)
        if result is not None:
            self.counts.again += 1
        else:
            self.counts.asked += 1
            launch = launch_from_request(request, now_ns)
            if launch is None:
                result = dialect.MAV_RESULT_DENIED
            else:
                result = dialect.MAV_RESULT_ACCEPTED if ask(launch) else dialect.MAV_RESULT_FAILED
            self.counts.refused += result != dialect.MAV_RESULT_ACCEPTED
            self._answers[key] = result
            if len(self._answers) > REMEMBERED:
                self._answers.popitem(last=False)
        ack = dialect.MAVLink_command_ack_message(
            dialect.MAVLINK_MSG_ID_XITL_LAUNCH,
            result,
            0,
            request.request,
            request.get_srcSystem(),
            request.get_srcComponent(),
        )
        try:
            self._socket.sendto(self._packer.pack(ack), source)
        except OSError:  # buffers are full or the client has gone: the client repeats the request
            return


def launch_from_request(request: dialect.MAVLink_xitl_launch_message, now_ns: int) -> Launch | None:
    """Return the launch of a request, or None for an invalid request."""
    north_m, east_m = request.pos_ne
    numbers = (north_m, east_m, request.heading, request.size)
    if not all(map(math.isfinite, numbers)) or max(abs(north_m), abs(east_m)) > FARTHEST_M or request.size < 0.0:
        return None
    if request.kind >= dialect.XITL_BODY_KIND_ENUM_END:
        return None
    return Launch(now_ns, BodyKind(request.kind), north_m, east_m, request.heading, request.size or None)


WAIT_S = 3.0
AGAIN_S = 0.5
SYSTEM_ID, COMPONENT_ID = 255, 191

_REFUSALS = {
    dialect.MAV_RESULT_DENIED: "there is no such body or place",
    dialect.MAV_RESULT_FAILED: "no body is as long, land, the boom or the vessel is in its place, or there are too "
    "many in the water",
}


def request_launch(
    url: str,
    kind: str,
    north_m: float,
    east_m: float,
    heading_rad: float,
    length_m: float | None,
    wait_s: float = WAIT_S,
) -> None:
    """Return when the run has accepted the launch. Raises UserError when it refuses, or when `url` does not answer."""
    if not url.startswith("udp://"):
        raise UserError(f"{url}: launches need UDP; write it like udp://127.0.0.1:14670")
    # A random number distinguishes requests, because two commands in sequence may get the same port.
    request = int.from_bytes(os.urandom(2), "little")
    message = dialect.MAVLink_xitl_launch_message(
        (north_m, east_m), heading_rad, length_m or 0.0, request, BodyKind[kind.upper()]
    )
    try:
        transport = open_transport(url, listen=False)
    except TransportError as error:
        raise UserError(str(error)) from error
    with transport:
        result = _answer(transport, message, request, wait_s)
    if result is None:
        raise UserError(
            f"{url}: no run answers; start one with world.debris.control set to this address, or name another with --to"
        )
    if result != dialect.MAV_RESULT_ACCEPTED:
        raise UserError(f"{url}: the run refused the {kind}: {_REFUSALS.get(result, f'result {result}')}")


def _answer(
    transport: Transport, message: dialect.MAVLink_xitl_launch_message, request: int, wait_s: float
) -> int | None:
    link = Link(transport, SYSTEM_ID, COMPONENT_ID)
    until_s = time.monotonic() + wait_s
    while True:
        left_s = until_s - time.monotonic()
        if left_s <= 0.0:
            return None
        link.send(message)
        again_s = time.monotonic() + min(AGAIN_S, left_s)
        while time.monotonic() < again_s:
            for heard in link.receive(max(again_s - time.monotonic(), 0.0)):
                if isinstance(heard, dialect.MAVLink_command_ack_message) and heard.result_param2 == request:
                    return int(heard.result)
