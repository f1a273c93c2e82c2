"""Two ends in one process, for in-process runs and tests."""

from __future__ import annotations

from collections import deque
from threading import Event

from agent.wire.transport import Transport, TransportClosedError


class _Queue:
    """One direction. The event is used only while the reader waits, which keeps the common path cheap."""

    def __init__(self, capacity: int) -> None:
        self.chunks: deque[bytes] = deque()
        self.capacity = capacity
        self.waiting = False
        self.arrived = Event()


class MemoryTransport(Transport):
    """One end of a pair made by `memory_pair`. The two ends may live in different threads."""

    name = "memory"
    lossless = True

    def __init__(self, address: str, peer: str, outgoing: _Queue, incoming: _Queue) -> None:
        super().__init__(address)
        self._peer = peer
        self._outgoing = outgoing
        self._incoming = incoming
        self._closed = False

    @property
    def peer(self) -> str:
        return self._peer

    def send(self, data: bytes) -> bool:
        if self._closed:
            raise TransportClosedError(self.address)
        queue = self._outgoing
        if len(queue.chunks) >= queue.capacity:
            self.unsent += 1
            return False
        queue.chunks.append(data)
        if queue.waiting:
            queue.arrived.set()
        return True

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        if self._closed:
            raise TransportClosedError(self.address)
        queue = self._incoming
        if not queue.chunks and timeout_s > 0.0:
            queue.arrived.clear()
            queue.waiting = True
            if not queue.chunks:
                queue.arrived.wait(timeout_s)
            queue.waiting = False
        return [queue.chunks.popleft() for _ in range(len(queue.chunks))]

    def fileno(self) -> int | None:
        return None

    def close(self) -> None:
        self._closed = True
        self._incoming.chunks.clear()


def memory_pair(name: str = "pair", capacity: int = 4096) -> tuple[MemoryTransport, MemoryTransport]:
    """Return two connected ends. Each direction holds at most `capacity` chunks.

    A chunk beyond that is not sent, and the sender counts it.
    """
    if capacity < 1:
        raise ValueError(f"memory_pair: capacity = {capacity} is too small; use at least 1")
    there, back = _Queue(capacity), _Queue(capacity)
    a, b = f"memory://{name}/a", f"memory://{name}/b"
    return MemoryTransport(a, b, there, back), MemoryTransport(b, a, back, there)
