"""Where a run hears what to put into the water: XITL_LAUNCH by UDP, answered with COMMAND_ACK.

Anybody may ask, and each is answered at his own address. Who hears no answer asks again with the same number, and the
answer is then the same, without another body.
"""

from __future__ import annotations

import math
import socket
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict, dataclass
from urllib.parse import urlsplit

from agent.wire import dialect
from agent.wire.codec import Packer, decode
from agent.wire.framing import Framer
from agent.wire.transport import TransportError
from agent.wire.urls import Address, address_url, explained, resolve
from sim_core.world.bodies import BodyKind
from sim_core.world.drifting import Launch
from xitl_cli.errors import UserError
from xitl_cli.run.links.peer import HOST_COMPONENT_ID, HOST_SYSTEM_ID

LARGEST = 2048
AT_ONCE = 32  # datagrams of one look: a flood may not hold the run
REMEMBERED = 64
FARTHEST_M = 100e3

Ask = Callable[[Launch], bool]
"""Puts it into the water; False when it cannot be."""


@dataclass(slots=True)
class Counts:
    """Requests that came, those that came again, those that were refused, and datagrams that held none."""

    asked: int = 0
    again: int = 0
    refused: int = 0
    dropped: int = 0


class ControlPort:
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
            raise UserError(f"world.debris.control: {explained(error, parts, True)}") from None
        self.address = address_url("udp", self._socket.getsockname())
        self.counts = Counts()
        self._packer = Packer(HOST_SYSTEM_ID, HOST_COMPONENT_ID)
        self._answers: OrderedDict[tuple[Address, int], int] = OrderedDict()

    def serve(self, now_ns: int, ask: Ask) -> None:
        """Hear and answer what has come."""
        for _ in range(AT_ONCE):
            try:
                data, source = self._socket.recvfrom(LARGEST)
            except BlockingIOError:
                return
            except OSError:  # an answer went to somebody who is gone
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
        """Counts by name."""
        return asdict(self.counts)

    def close(self) -> None:
        """Hear no more."""
        self._socket.close()

    def _answer(self, request: dialect.MAVLink_xitl_launch_message, source: Address, now_ns: int, ask: Ask) -> None:
        key = (source, request.request)
        result = self._answers.get(key)
        if result is not None:
            self.counts.again += 1
        else:
            self.counts.asked += 1
            launch = launch_asked(request, now_ns)
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
        except OSError:  # buffers full, or he is gone: he asks again
            return


def launch_asked(request: dialect.MAVLink_xitl_launch_message, now_ns: int) -> Launch | None:
    """The launch that a request is for, None for one that cannot be."""
    north_m, east_m = request.pos_ne
    numbers = (north_m, east_m, request.heading, request.size)
    if not all(map(math.isfinite, numbers)) or max(abs(north_m), abs(east_m)) > FARTHEST_M or request.size < 0.0:
        return None
    if request.kind not in BodyKind._value2member_map_:
        return None
    return Launch(now_ns, BodyKind(request.kind), north_m, east_m, request.heading, request.size or None)
