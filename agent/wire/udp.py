"""MAVLink over UDP: one datagram carries one or more complete frames."""

from __future__ import annotations

import errno
import socket
from time import monotonic
from typing import Callable
from urllib.parse import SplitResult

from agent.timing.clock import wait_readable
from agent.wire.transport import DatagramTooLongError, SenderStatus, ServedPeer, Transport, TransportClosedError
from agent.wire.urls import Address, address_url, bind_to_interface, interface_named_by, resolve, transport_error

# More than a second of 400 Hz sensors while the reader is blocked. The kernel limits it to net.core.rmem_max.
BUFFER_BYTES = 1 << 20
BATCH = 512  # datagrams per receive(), so that a flood does not block the caller
STRANGERS = 32  # limit while they may be from anybody
LARGEST = 65507


class UdpTransport(Transport):
    """A bound socket that learns its peer (listen), or a connected one.

    A listening socket answers its peer: the first sender of a good frame, until it gives way, see `ServedPeer`. So
    garbage never changes the peer, and a second host that only asks does not redirect the answers. A host that restarts
    on another port is served. While the peer has an active run, datagrams of others are refused unread. At other times
    those of any sender are returned, a few at a time, because they may be a flood.

    refused: number of reports by the other machine that no program listens at the port (ICMP).
    peer_changes: number of changes of the peer.
    batch: largest number of datagrams per `receive`.
    longest: longer datagrams are dropped, and counted in `too_long`.
    """

    name = "udp"

    def __init__(
        self, sock: socket.socket, address: str, listen: bool, clock_s: Callable[[], float] = monotonic
    ) -> None:
        super().__init__(address)
        self.learns_peer = listen
        self.batch = BATCH
        self.longest = LARGEST
        self.too_long = 0
        self.refused = 0
        self.peer_changes = 0
        self._socket = sock
        self._listen = listen
        self._clock_s = clock_s
        self._peer: Address | None = None if listen else sock.getpeername()
        self._served = ServedPeer()
        self._sources: list[Address] = []
        self._buffer = bytearray(LARGEST + 29)
        self._view = memoryview(self._buffer)
        self._closed = False

    @classmethod
    def open(cls, url: SplitResult, listen: bool) -> UdpTransport:
        family, kind, protocol, _, target = resolve(url, listen, socket.SOCK_DGRAM)
        sock = socket.socket(family, kind, protocol)
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
            if listen:
                interface = interface_named_by(url)
                if interface is not None:
                    bind_to_interface(sock, interface)
                sock.bind(target)
            else:
                sock.connect(target)
        except OSError as error:
            sock.close()
            raise transport_error(error, url, listen) from None
        return cls(sock, address_url("udp", sock.getsockname()) if listen else url.geturl(), listen)

    @property
    def peer(self) -> str:
        return "" if self._peer is None else address_url("udp", self._peer)

    def send(self, data: bytes) -> bool:
        """See Transport. Raises DatagramTooLongError above 65507 bytes."""
        if self._closed:
            raise TransportClosedError(self.address)
        try:
            if not self._listen:
                self._socket.send(data)
                return True
            if self._peer is not None:
                self._socket.sendto(data, self._peer)
                return True
        except ConnectionRefusedError:
            self.refused += 1  # the answer to an earlier datagram, which also prevented this one
        except OSError as error:  # buffers full, cable out, interface down: the next one may succeed
            if error.errno == errno.EMSGSIZE:
                raise DatagramTooLongError(
                    self.address, f"{len(data)} bytes do not fit a datagram", f"send at most {LARGEST}"
                ) from None
        self.unsent += 1
        return False

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        if self._closed:
            raise TransportClosedError(self.address)
        chunks = self._drain(self.batch)
        if not chunks and timeout_s > 0.0:
            until_s = monotonic() + timeout_s
            left_s = timeout_s
            while not chunks and left_s > 0.0:
                wait_readable((self._socket.fileno(),), left_s)
                chunks = self._drain(1)  # the caller waits: checking for another would cost more than its next call
                left_s = until_s - monotonic()
        return chunks

    def _drain(self, most: int) -> list[bytes]:
        chunks: list[bytes] = []
        self._sources = sources = []
        view, take = self._view, self._socket.recvfrom_into
        bound = False
        if self._listen:
            bound = self._served.bound(self._clock_s())
            most = most if bound else min(most, STRANGERS)
        for _ in range(most):
            try:
                size, source = take(self._buffer)
            except BlockingIOError:
                break
            except ConnectionRefusedError:
                self.refused += 1
                continue
            except OSError:  # an interface that went down is reported here once
                break
            if bound and source != self._peer:
                if size:  # an empty one has no content to refuse
                    self.strangers += 1
                    self.stranger = address_url("udp", source)
                continue
            if size > self.longest:
                self.too_long += 1
                continue
            chunks.append(bytes(view[:size]))
            sources.append(source)
        return chunks

    def accept_sender(self, index: int, standing: SenderStatus) -> bool:
        source, now_s = self._sources[index], self._clock_s()
        if source != self._peer:
            if not self._served.gives_way(standing, now_s):
                self.stranger = address_url("udp", source)
                return False
            self.peer_changes += self._peer is not None
            self._peer, self._served = source, ServedPeer()
        self._served.heard(standing, now_s)
        return True

    def counts(self) -> dict[str, int]:
        return {"refused": self.refused, "peer_changes": self.peer_changes}

    def fileno(self) -> int | None:
        return None if self._closed else self._socket.fileno()

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._socket.close()
