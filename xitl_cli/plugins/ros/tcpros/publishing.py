"""A published topic: each subscriber has a queue and a thread."""

from __future__ import annotations

import select
import socket
import threading
from collections import deque
from collections.abc import Callable

from xitl_cli.plugins.ros.tcpros.notes import NodeNotes
from xitl_cli.plugins.ros.tcpros.wire import Header, Ros1Type, TcprosError, block, encode_header, shut

LOOK_S = 2.0
MOST_QUEUED_BYTES = 64 << 20
MOST_SUBSCRIBERS = 128
ANY = "*"


class SubscriberLink:
    """One subscriber. A slow subscriber loses the oldest messages, and does not delay others."""

    def __init__(self, connection: socket.socket, peer: str, depth: int, drop: Callable[[], None]) -> None:
        self.peer = peer
        self.closed = False
        self._connection = connection
        self._depth = depth
        self._drop = drop
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._change = threading.Condition()
        threading.Thread(target=self._send, name=f"to {peer}", daemon=True).start()

    def offer(self, data: bytes) -> None:
        with self._change:
            self._waiting.append(data)
            self._waiting_bytes += len(data)
            while len(self._waiting) > 1 and (
                len(self._waiting) > self._depth or self._waiting_bytes > MOST_QUEUED_BYTES
            ):
                self._waiting_bytes -= len(self._waiting.popleft())
                self._drop()
            self._change.notify()

    def close(self) -> None:
        with self._change:
            self.closed = True
            self._change.notify()
        shut(self._connection)

    def _send(self) -> None:
        try:
            while not self.closed:
                with self._change:
                    if not self._waiting:
                        self._change.wait(LOOK_S)
                    data = b"".join(self._waiting)
                    self._waiting.clear()
                    self._waiting_bytes = 0
                if data:
                    self._connection.sendall(data)
                elif self._is_gone():
                    break
        except (OSError, ValueError):  # ValueError: for a socket that was closed meanwhile
            pass
        finally:
            self.close()

    def _is_gone(self) -> bool:
        if not select.select([self._connection], [], [], 0.0)[0]:
            return False
        return not self._connection.recv(1 << 10)  # a subscriber sends no data; received data is ignored


class TopicPublisher:
    """Publisher of a topic. latching: new subscribers get the last message."""

    def __init__(self, topic: str, kind: Ros1Type, latching: bool, depth: int, notes: NodeNotes) -> None:
        self.topic, self.kind = topic, kind
        self._latching = latching
        self._depth = depth
        self._notes = notes
        self._last = b""
        self._links: tuple[SubscriberLink, ...] = ()
        self._lock = threading.Lock()

    @property
    def peers(self) -> list[str]:
        return [link.peer for link in self._links if not link.closed]

    @property
    def wanted(self) -> bool:
        """Return True if anybody needs a message, now or later."""
        return self._latching or any(not link.closed for link in self._links)

    def publish(self, message: bytes) -> None:
        """Publish a ROS 1 message, from any thread."""
        data = block(message)
        with self._lock:
            if self._latching:
                self._last = data
            for link in self._links:
                if not link.closed:
                    link.offer(data)

    def accept(self, connection: socket.socket, asked: Header, node: str) -> None:
        """Add a subscriber by its header. Raises TcprosError for another type or too many subscribers, and OSError."""
        peer = asked.get("callerid", "a node without a name")
        md5, name = asked.get("md5sum", ""), asked.get("type", "")
        if md5 not in (ANY, self.kind.md5) or name not in (ANY, "", self.kind.name):
            raise TcprosError(
                f"{peer} asked for {name or 'a type without a name'} with the MD5 {md5 or '(none)'}, "
                f"{self.topic} is {self.kind.name} with {self.kind.md5}"
            )
        if len(self.peers) >= MOST_SUBSCRIBERS:
            raise TcprosError(f"{self.topic} has {MOST_SUBSCRIBERS} subscribers, and takes no more")
        connection.sendall(
            encode_header(
                {
                    "callerid": node,
                    "latching": str(int(self._latching)),
                    "md5sum": self.kind.md5,
                    "message_definition": self.kind.definition,
                    "topic": self.topic,
                    "type": self.kind.name,
                }
            )
        )
        connection.settimeout(None)
        link = SubscriberLink(connection, peer, self._depth, lambda: self._notes.drop(self.topic))
        with self._lock:
            self._links = (*(each for each in self._links if not each.closed), link)
            if self._last:
                link.offer(self._last)

    def close(self) -> None:
        for link in self._links:
            link.close()
