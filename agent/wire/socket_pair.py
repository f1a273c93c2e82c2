"""Two ends of a pair of sockets: in two processes of one machine, or in one process.

Chunks arrive complete and in order, and none is lost. The system holds some hundred in each direction, and refuses
more.
"""

from __future__ import annotations

import socket
from select import select
from time import monotonic, sleep

from agent.wire.transport import Transport, TransportClosedError

CHUNK_BYTES = 1 << 16
CHUNKS = 1024  # per receive(), so that a flood does not block the caller


class SocketPairTransport(Transport):
    """One end of a pair, with the SOCK_SEQPACKET `sock`, which it closes.

    lost: the other end is closed.

    gather: collect outgoing bytes up to this number, until `flush` or a `receive` that waits. Waking another process
    costs more than sending.
    """

    name = "pair"
    lossless = True

    def __init__(self, sock: socket.socket, name: str, gather: int = 0) -> None:
        super().__init__(f"pair://{name}")
        sock.setblocking(False)
        self.lost = False
        self._gather = gather
        self._gathered = b""
        self._socket: socket.socket | None = sock
        self._room = memoryview(bytearray(CHUNK_BYTES))

    @property
    def peer(self) -> str:
        return self.address

    def send(self, data: bytes) -> bool:
        sock = self._open_socket()
        if self._gather:
            if len(self._gathered) + len(data) <= self._gather:
                self._gathered += data
                return True
            self.flush()
        return self._hand_on(sock, data)

    def flush(self) -> None:
        """Send the collected bytes."""
        if self._gathered:
            gathered, self._gathered = self._gathered, b""
            self._hand_on(self._open_socket(), gathered)

    def _hand_on(self, sock: socket.socket, data: bytes) -> bool:
        try:
            sock.send(data)
        except (BlockingIOError, InterruptedError):
            self.unsent += 1
            return False
        except OSError:
            self.lost = True
            self.unsent += 1
            return False
        return True

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        sock = self._open_socket()
        chunks = self._drain(sock)
        if not chunks and timeout_s > 0.0:
            self.flush()
            until_s = monotonic() + timeout_s
            while not chunks and not self.lost and (left_s := until_s - monotonic()) > 0.0:
                select([sock], (), (), left_s)
                chunks = self._drain(sock)
            if self.lost and not chunks:
                sleep(max(until_s - monotonic(), 0.0))
        return chunks

    def _drain(self, sock: socket.socket) -> list[bytes]:
        chunks: list[bytes] = []
        room = self._room
        while len(chunks) < CHUNKS and not self.lost:
            try:
                size = sock.recv_into(room)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                size = 0
            if not size:
                self.lost = True
                break
            chunks.append(bytes(room[:size]))
        return chunks

    def wait_for_room(self, timeout_s: float) -> bool:
        sock = self._open_socket()
        return self.lost or bool(select((), [sock], (), timeout_s)[1])

    def finish(self, timeout_s: float) -> bool:
        """Announce the end of the data, and wait until the other end is closed. Return False at the timeout."""
        sock = self._open_socket()
        self.flush()
        try:
            sock.shutdown(socket.SHUT_WR)
        except OSError:
            return True
        until_s = monotonic() + timeout_s
        while not self.lost and (left_s := until_s - monotonic()) > 0.0:
            select([sock], (), (), left_s)
            self._drain(sock)
        return self.lost

    def _open_socket(self) -> socket.socket:
        if self._socket is None:
            raise TransportClosedError(self.address)
        return self._socket

    def fileno(self) -> int | None:
        return None if self._socket is None else self._socket.fileno()

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def socket_pair(name: str = "pair", gather: int = 0) -> tuple[SocketPairTransport, socket.socket]:
    """Return an end in this process, and the socket of the other end, for another process or a separate transport."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return SocketPairTransport(ours, name, gather), theirs
