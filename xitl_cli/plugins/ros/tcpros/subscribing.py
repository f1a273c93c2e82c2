"""A subscribed topic: each of its publishers has a connection and a thread."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable

from xitl_cli.plugins.ros.tcpros.master import MasterAwayError, MasterRefusedError, call
from xitl_cli.plugins.ros.tcpros.notes import NodeNotes
from xitl_cli.plugins.ros.tcpros.publishing import ANY
from xitl_cli.plugins.ros.tcpros.slave import TCPROS
from xitl_cli.plugins.ros.tcpros.wire import (
    MOST_MESSAGE,
    Ros1Type,
    TcprosError,
    encode_header,
    receive_block,
    receive_header,
    shut,
)

HEADER_S = 10.0
AGAIN_S = 1.0
MOST_PUBLISHERS = 64


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
        threading.Thread(target=self._keep, name=f"from {uri}", daemon=True).start()

    def close(self) -> None:
        self._over.set()
        if self._connection is not None:
            shut(self._connection)

    def _keep(self) -> None:
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
        told = receive_header(connection)
        self.peer = told.get("callerid", self._uri)
        if "error" in told:
            raise TcprosError(f"{told['error'][:200]}; publish {kind.name}")
        if told.get("md5sum") not in (ANY, kind.md5):
            raise TcprosError(f"it publishes {told.get('type', 'another type')}; publish {kind.name}")
        if not own.listed(told.get("callerid")):
            raise TcprosError(f"{told.get('callerid', 'a node without a name')} is not in ros.commanders")
        connection.settimeout(None)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.connected = True
        while (data := receive_block(connection, MOST_MESSAGE)) is not None:
            own.taken(data)
