"""Pairs of joined ends, one row for each kind of transport, and how the tests use them."""

from __future__ import annotations

import itertools
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack

from agent.wire.can_transfer import LARGEST_CHUNK, CanLine
from agent.wire.impaired import ImpairedTransport
from agent.wire.memory import memory_pair
from agent.wire.socket_pair import SocketPairTransport, socket_pair
from agent.wire.transport import SenderStatus, Transport, open_transport
from tests.patience import PATIENCE_S
from xitl_cli.run.links.loopback import CanLoopback, SerialLoopback

GROUP = "239.74.163.2"
Ends = tuple[Transport, Transport]
opened = ExitStack()  # what the ends of a test stand on


def udp_pair() -> Ends:
    listener = open_transport("udp://127.0.0.1:0", listen=True)
    return listener, open_transport(listener.address, listen=False)


def tcp_pair() -> Ends:
    listener = open_transport("tcp://127.0.0.1:0", listen=True)
    return listener, open_transport(listener.address, listen=False)


def serial_pair() -> Ends:
    line = SerialLoopback(4_000_000)
    opened.callback(line.close)
    return open_transport(line.agent_url, listen=True), open_transport(line.host_url, listen=False)


slcan_buses: list[CanLoopback] = []


def slcan_pair(line: CanLine) -> Ends:
    bus = CanLoopback(line)
    slcan_buses[:] = [bus]
    opened.callback(bus.close)
    return open_transport(bus.agent_url, listen=True), open_transport(bus.host_url, listen=False)


buses = itertools.count()


def virtual_pair(rates: str) -> Ends:
    url = f"can://virtual/{next(buses)}?{rates}"
    return open_transport(url, listen=True), open_transport(url, listen=False)


def multicast_pair(rates: str) -> Ends:
    url = f"can://udp_multicast/{GROUP}?port={43000 + next(buses)}&{rates}"
    return open_transport(url, listen=True), open_transport(url, listen=False)


def impaired_pair() -> Ends:
    """Without a fault in force nothing may differ."""
    listening, calling = udp_pair()
    return ImpairedTransport(listening), ImpairedTransport(calling)


def sockets_pair() -> Ends:
    here, there = socket_pair()
    return SocketPairTransport(there, "pair"), here


CLASSIC, FD = "bitrate=1000000", "bitrate=1000000&fd=true&data_bitrate=5000000"

PAIRS: dict[str, Callable[[], Ends]] = {
    "memory": memory_pair,
    "sockets": sockets_pair,
    "udp": udp_pair,
    "tcp": tcp_pair,
    "impaired": impaired_pair,
    "serial": serial_pair,
    "slcan": lambda: slcan_pair(CanLine(1_000_000)),
    "slcan FD": lambda: slcan_pair(CanLine(1_000_000, True, 5_000_000)),
    "can virtual": lambda: virtual_pair(CLASSIC),
    "can virtual FD": lambda: virtual_pair(FD),
}
if [name for _, name in socket.if_nameindex()] == ["lo"]:  # nobody else hears it: test_multicast_keeps_the_contract
    PAIRS["can multicast"] = lambda: multicast_pair(CLASSIC)
    PAIRS["can multicast FD"] = lambda: multicast_pair(FD)
LISTENING: dict[str, str] = {"udp": "udp://127.0.0.1:0", "tcp": "tcp://127.0.0.1:0"}


def largest(transport: Transport) -> int:
    """The longest chunk that fits. A serial line: what the kernel holds for a reader that a busy machine keeps waiting.

    A line overruns a late reader. More than one buffer of the sender, 4096 bytes, so that it has to send a rest.
    """
    return {"can": LARGEST_CHUNK, "serial": 16_000}.get(transport.name, 64_000)


def take(
    transport: Transport, count: int, standing: SenderStatus = SenderStatus.HEARD, sender: Transport | None = None
) -> list[bytes]:
    """The next `count` chunks, as a link takes them: each credited to its sender, which is served meanwhile."""
    chunks: list[bytes] = []
    until_s = time.monotonic() + PATIENCE_S
    while len(chunks) < count and time.monotonic() < until_s:
        new = transport.receive(0.2 if sender is None else 0.001)
        for index in range(len(new)):
            transport.accept_sender(index, standing)
        chunks += new
        if sender is not None:
            assert sender.receive() == []
    return chunks


def take_bytes(transport: Transport, size: int, sender: Transport | None = None) -> bytes:
    """So many bytes; a stream cuts and joins chunks as it likes."""
    data = b""
    until_s = time.monotonic() + PATIENCE_S
    while len(data) < size and time.monotonic() < until_s:
        data += b"".join(take(transport, 1, sender=sender))
    return data


def send(transport: Transport, data: bytes) -> None:
    """As soon as there is room."""
    until_s = time.monotonic() + PATIENCE_S
    while not transport.send(data):
        assert time.monotonic() < until_s
        transport.receive(0.001)
