"""Published and subscribed topics: each peer has a connection and a thread."""

from __future__ import annotations

import select
import socket
import threading
from collections import deque
from collections.abc import Callable

from xitl_cli.plugins.ros.tcpros.master import MasterAwayError, MasterRefusedError, NodeNotes, call
from xitl_cli.plugins.ros.tcpros.slave import TCPROS
from xitl_cli.plugins.ros.tcpros.wire import (
    MOST_MESSAGE,
    Header,
    Ros1Type,
    TcprosError,
    block,
    encode_header,
    receive_block,
    receive_header,
    shut,
)

CHECK_S = 2.0
MOST_QUEUED_BYTES = 64 << 20
MOST_SUBSCRIBERS = 128
ANY = "*"
HEADER_S = 10.0
AGAIN_S = 1.0
MOST_PUBLISHERS = 64


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
                        self._change.wait(CHECK_S)
                    data = b"".join(self._waiting)
                    self._waiting.clear()
                    self._waiting_bytes = 0
                if data:
                    self._connection.sendall(data)
                elif select.select([self._connection], [], [], 0.0)[0] and not self._connection.recv(1 << 10):
                    break  # a subscriber sends no data, so only its end makes the connection readable
        except (OSError, ValueError):  # ValueError: for a socket that was closed meanwhile
            pass
        finally:
            self.close()


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
                f"{peer} requested {name or 'a type without a name'} with the MD5 {md5 or '(none)'}, "
                f"but {self.topic} is {self.kind.name} with {self.kind.md5}"
            )
        if len(self.peers) >= MOST_SUBSCRIBERS:
            raise TcprosError(f"{self.topic} accepts no more than {MOST_SUBSCRIBERS} subscribers")
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
            self._links = (*(known for known in self._links if not known.closed), link)
            if self._last:
                link.offer(self._last)

    def close(self) -> None:
        for link in self._links:
            link.close()


class TopicSubscriber:
    """Subscriber of a topic.

    taken: called with each ROS 1 message, in the thread of its publisher. node: returns the node's name. listed:
    returns True if a publisher may command, by the name of its node.
    """

    def __init__(
        self,
        topic: str,
        kind: Ros1Type,
        taken: Callable[[bytes], None],
        node: Callable[[], str],
        notes: NodeNotes,
        listed: Callable[[str | None], bool],
    ) -> None:
        self.topic, self.kind = topic, kind
        self.node = node
        self.taken = taken
        self.notes = notes
        self.listed = listed
        self._links: dict[str, PublisherLink] = {}
        self._updated = False
        self._lock = threading.Lock()

    @property
    def peers(self) -> list[str]:
        with self._lock:
            return [link.peer for link in self._links.values() if link.connected]

    def registering(self) -> None:
        """Note the request to the master: later updates may arrive before its answer."""
        with self._lock:
            self._updated = False

    def registered(self, uris: list[str]) -> None:
        """Use the master's answer, unless a later update has arrived."""
        with self._lock:
            if not self._updated:
                self._connect(uris)

    def set_publishers(self, uris: list[str]) -> None:
        """Use an update of the master."""
        with self._lock:
            self._updated = True
            self._connect(uris)

    def close(self) -> None:
        self.set_publishers([])

    def _connect(self, uris: list[str]) -> None:
        """Connect to new publishers, and disconnect from removed ones."""
        for uri in self._links.keys() - set(uris):
            self._links.pop(uri).close()
        for uri in uris[:MOST_PUBLISHERS]:
            if uri not in self._links:
                self._links[uri] = PublisherLink(self, uri)


class PublisherLink:
    """The connection to one publisher, renewed while the master lists it."""

    def __init__(self, subscriber: TopicSubscriber, uri: str) -> None:
        self.peer = uri
        self.connected = False
        self._subscriber = subscriber
        self._uri = uri
        self._over = threading.Event()
        self._connection: socket.socket | None = None
        threading.Thread(target=self._run, name=f"from {uri}", daemon=True).start()

    def close(self) -> None:
        self._over.set()
        if self._connection is not None:
            shut(self._connection)

    def _run(self) -> None:
        topic = self._subscriber.topic
        while not self._over.is_set():
            try:
                self._receive()
            except TcprosError as error:
                self._subscriber.notes.refuse(topic, f"{topic}: the publisher {self.peer} is refused: {error}")
                return
            except (OSError, MasterAwayError, MasterRefusedError):
                pass  # it is starting or ending; the master reports its end
            finally:
                self.connected = False
                if self._connection is not None:
                    shut(self._connection)
            self._over.wait(AGAIN_S)

    def _receive(self) -> None:
        """Receive until the publisher closes."""
        own, name = self._subscriber, self._subscriber.node()
        answer = call(self._uri, "requestTopic", name, own.topic, [[TCPROS]])
        try:
            protocol, host, port = answer
            if protocol != TCPROS or not 0 < int(port) < 65536:
                raise ValueError(answer)
            self._connection = connection = socket.create_connection((str(host), int(port)), HEADER_S)
        except (TypeError, ValueError) as error:  # also for an invalid host
            raise TcprosError(f"it offers {str(answer)[:80]}, not {TCPROS} at a host and a port") from error
        if self._over.is_set():
            return
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        kind = own.kind
        connection.sendall(
            encode_header(
                {
                    "callerid": name,
                    "md5sum": kind.md5,
                    "message_definition": kind.definition,
                    "tcp_nodelay": "1",
                    "topic": own.topic,
                    "type": kind.name,
                }
            )
        )
        header = receive_header(connection)
        self.peer = header.get("callerid", self._uri)
        if "error" in header:
            raise TcprosError(f"{header['error'][:200]}; publish {kind.name}")
        if header.get("md5sum") not in (ANY, kind.md5):
            raise TcprosError(f"it publishes {header.get('type', 'another type')}; publish {kind.name}")
        if not own.listed(header.get("callerid")):
            raise TcprosError(f"{header.get('callerid', 'a node without a name')} is not in ros.commanders")
        connection.settimeout(None)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.connected = True
        while (data := receive_block(connection, MOST_MESSAGE)) is not None:
            own.taken(data)
