"""MAVLink over TCP: a stream of bytes in which the link's `Framer` finds frames.

Sending does not wait for the other end. Bytes that the system's buffer does not accept are refused. If it accepts a
part of a chunk, the rest is sent before anything else. So a slow reader loses complete chunks and never parts. Call
`wait_for_room` first to wait instead.
"""

from __future__ import annotations

import errno
import select
import socket
from time import monotonic
from typing import Callable
from urllib.parse import SplitResult

from agent.wire.transport import SenderStatus, ServedPeer, Transport, TransportClosedError
from agent.wire.urls import Address, address_url, bind_to_interface, interface_named_by, resolve, transport_error

BUFFER_BYTES = 1 << 16  # limit of unread bytes at the other end: a second or two of telemetry, not minutes
CHUNK_BYTES = 1 << 16
SENT_BYTES = 1 << 14  # at once: a stream has no datagrams, and a cloud of 40 kB in such of UDP is thirty system calls
CHUNKS = 16  # per receive(), so that a flood does not block the caller
RETRY_S = 0.5
WAITING = 16  # connections that the system holds until they are accepted
CHECK_S = 0.1  # interval of checks for other callers while a peer is connected
IDLE_S = 1.5  # a silent peer gives way after this time
EXHAUSTED_S = 1.0  # pause after a call found no free descriptor


_NO_DESCRIPTORS = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)


class _Connection:
    """A connected socket, until `lost`."""

    def __init__(self, sock: socket.socket, peer: str) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket = sock
        self.peer = peer
        self.lost = False
        self._rest = b""
        self._full = False

    def stuck(self) -> bool:
        """Whether there was no room and still is none."""
        if self._full:
            self._full = not self.flush() or not select.select((), [self.socket], (), 0.0)[1]
        return self._full

    def wait_for_room(self, timeout_s: float) -> bool:
        until_s = monotonic() + timeout_s
        while not self.lost:
            writable = select.select((), [self.socket], (), max(until_s - monotonic(), 0.0))[1]
            if writable and self.flush():
                return True
            if not writable:
                return False
        return True  # `send` will detect the loss

    def flush(self) -> bool:
        """Send the waiting bytes. Return True when none remains."""
        if self._rest:
            self._rest = self._rest[self._hand_on(self._rest) :]
        return not self._rest and not self.lost

    def send(self, data: bytes) -> bool:
        if not self.flush():
            return False
        taken = self._hand_on(data)
        self._full = taken < len(data)
        if taken:
            self._rest = data[taken:]
        return taken > 0 or not data

    def _hand_on(self, data: bytes) -> int:
        try:
            return self.socket.send(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            self.lost = True
            return 0

    def receive(self, most: int, chunk_bytes: int) -> list[bytes]:
        self.flush()
        chunks: list[bytes] = []
        while len(chunks) < most and not self.lost:
            try:
                chunk = self.socket.recv(chunk_bytes)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                self.lost = True
                break
            if not chunk:
                self.lost = True
                break
            chunks.append(chunk)
        return chunks


class TcpTransport(Transport):
    """A stream to one peer. Subclasses define the source of a peer.

    losses: connections that the other side ended or the network broke.
    """

    name = "tcp"
    stream = True
    lossless = True
    datagram_bytes = SENT_BYTES
    chunks = CHUNKS
    """Limit of one `receive`, also in `chunk_bytes`. The rest waits in the system's buffer."""
    chunk_bytes = CHUNK_BYTES

    def __init__(self, address: str) -> None:
        super().__init__(address)
        self._connection: _Connection | None = None
        self._closed = False

    @classmethod
    def open(cls, url: SplitResult, listen: bool) -> TcpTransport:
        return TcpPeerOfListener(TcpListener(url)) if listen else TcpCaller(url)

    def _find_peer(self) -> None:
        """Make a connection if that needs no waiting."""

    def call_at_once(self) -> None:
        """Try to connect at the next send or receive, even soon after a failure."""

    @property
    def peer(self) -> str:
        return "" if self._connection is None else self._connection.peer

    @property
    def connected(self) -> bool:
        """Whether there is a peer, as far as known."""
        return self._connection is not None

    @property
    def stuck(self) -> bool:
        """Whether the peer does not accept sent data."""
        return self._connection is not None and not self._connection.lost and self._connection.stuck()

    def send(self, data: bytes) -> bool:
        connection = self._ready()
        if connection is not None and connection.send(data):
            return True
        self._drop_lost()
        self.unsent += 1
        return False

    def wait_for_room(self, timeout_s: float) -> bool:
        return self._connection is None or self._connection.wait_for_room(timeout_s)

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        chunks = self._drain()
        if not chunks and timeout_s > 0.0:
            until_s = monotonic() + timeout_s
            left_s = timeout_s
            while not chunks and left_s > 0.0:
                descriptor = self.fileno()
                # without a descriptor, wait only for the next attempt to connect
                select.select([] if descriptor is None else [descriptor], (), (), min(left_s, RETRY_S))
                chunks = self._drain()
                left_s = until_s - monotonic()
        return chunks

    def _drain(self) -> list[bytes]:
        connection = self._ready()
        if connection is None:
            return []
        chunks = connection.receive(self.chunks, self.chunk_bytes)
        self._drop_lost()
        return chunks

    def _ready(self) -> _Connection | None:
        if self._closed:
            raise TransportClosedError(self.address)
        if self._connection is None:
            self._find_peer()
        return self._connection

    def _drop_lost(self) -> None:
        if self._connection is not None and self._connection.lost:
            self._connection.socket.close()
            self._connection = None
            self.losses += 1

    def counts(self) -> dict[str, int]:
        return {"losses": self.losses}

    def fileno(self) -> int | None:
        return None if self._closed or self._connection is None else self._connection.socket.fileno()

    def close(self) -> None:
        self._closed = True
        if self._connection is not None:
            self._connection.socket.close()
            self._connection = None


class TcpAccepted(TcpTransport):
    """A connection that a `TcpListener` accepted. Once lost, it is not reopened."""

    def __init__(self, sock: socket.socket, address: str, peer: str) -> None:
        super().__init__(address)
        self._connection = _Connection(sock, peer)


class TcpListener:
    """A listening socket. `accept` returns its connections."""

    def __init__(self, url: SplitResult) -> None:
        family, kind, protocol, _, target = resolve(url, True, socket.SOCK_STREAM)
        self._socket = socket.socket(family, kind, protocol)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a restart need not wait a minute
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)  # accepted ones inherit it
            interface = interface_named_by(url)
            if interface is not None:
                bind_to_interface(self._socket, interface)
            self._socket.bind(target)
            self._socket.listen(WAITING)
        except OSError as error:
            self._socket.close()
            raise transport_error(error, url, True) from None
        self.address = address_url("tcp", self._socket.getsockname())
        self.exhausted = 0
        self._again_s = 0.0
        self._closed = False

    def accept(self) -> tuple[socket.socket, str] | None:
        """Return the next connection and its peer, None without a caller or a free descriptor.

        exhausted: number of calls without a free descriptor. The caller then waits, and is checked again after
        `EXHAUSTED_S`.
        """
        if monotonic() < self._again_s:
            return None
        try:
            sock, source = self._socket.accept()
        except OSError as error:  # usually no caller, or a caller that gave up meanwhile
            if error.errno in _NO_DESCRIPTORS:
                self.pause(EXHAUSTED_S)
                self.exhausted += 1
            return None
        return sock, address_url("tcp", source)

    def pause(self, seconds: float) -> None:
        """Let callers wait for this time. Otherwise the readable descriptor would wake the program at once."""
        self._again_s = monotonic() + seconds

    def fileno(self) -> int | None:
        """Descriptor that becomes readable when a caller connects, None during a pause."""
        return None if self._closed or monotonic() < self._again_s else self._socket.fileno()

    def close(self) -> None:
        """Stop listening. Accepted connections remain open."""
        self._closed = True
        self._socket.close()


class TcpPeerOfListener(TcpTransport):
    """Listens at an address and serves one peer at a time, until it leaves or gives way, see `ServedPeer`.

    Other callers wait. While the peer has an active run, they are refused and counted as `strangers`.
    peer_changes: number of times that a peer gave way.
    """

    serves_one = True

    def __init__(self, listener: TcpListener, clock_s: Callable[[], float] = monotonic) -> None:
        super().__init__(listener.address)
        self.peer_changes = 0
        self._listener = listener
        self._clock_s = clock_s
        self._served = ServedPeer(IDLE_S)
        self._next_check_s = 0.0

    def _find_peer(self) -> None:
        called = self._listener.accept()
        if called is not None:
            self._connection = _Connection(*called)
            self._served = ServedPeer(IDLE_S)
            self._served.called(self._clock_s())

    def _ready(self) -> _Connection | None:
        if self._connection is not None and not self._closed:
            now_s = self._clock_s()
            if now_s >= self._next_check_s:
                self._next_check_s = now_s + CHECK_S
                self._check_callers(now_s)
        return super()._ready()

    def _check_callers(self, now_s: float) -> None:
        """Replace the peer when it gives way. Refuse all callers while the peer has an active run."""
        if self._served.gives_way(SenderStatus.HEARD, now_s):
            before = self._connection
            self._find_peer()
            if before is not None and self._connection is not before:
                self.peer_changes += 1
                before.socket.close()
        elif self._served.bound(now_s):
            for _ in range(WAITING):
                called = self._listener.accept()
                if called is None:
                    return
                called[0].close()
                self.strangers += 1
                self.stranger = called[1]

    def accept_sender(self, index: int, standing: SenderStatus) -> bool:
        self._served.heard(standing, self._clock_s())
        return True

    def counts(self) -> dict[str, int]:
        return {**super().counts(), "peer_changes": self.peer_changes}

    def fileno(self) -> int | None:
        return super().fileno() if self._connection is not None else self._listener.fileno()

    def close(self) -> None:
        super().close()
        self._listener.close()


class TcpCaller(TcpTransport):
    """Connects to an address on the first send or receive, and again `RETRY_S` after a failure or a disconnection."""

    def __init__(self, url: SplitResult) -> None:
        super().__init__(url.geturl())
        self._family, self._kind, self._protocol, _, target = resolve(url, False, socket.SOCK_STREAM)
        self._target: Address = target
        self._calling: socket.socket | None = None
        self._next_try_s = 0.0

    def _find_peer(self) -> None:
        if self._calling is None:
            if monotonic() < self._next_try_s:
                return
            self._next_try_s = monotonic() + RETRY_S
            try:
                self._calling = socket.socket(self._family, self._kind, self._protocol)
            except OSError:  # no free descriptor
                return
            self._calling.setblocking(False)
            self._calling.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
            if self._calling.connect_ex(self._target) not in (0, errno.EINPROGRESS):
                self._give_up()
                return
        if not select.select((), [self._calling], (), 0.0)[1]:
            return
        if self._calling.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) != 0:
            self._give_up()
            return
        self._connection, self._calling = _Connection(self._calling, self.address), None

    def call_at_once(self) -> None:
        self._next_try_s = 0.0

    def _give_up(self) -> None:
        if self._calling is not None:
            self._calling.close()
            self._calling = None

    def close(self) -> None:
        super().close()
        self._give_up()
