"""A ROS 1 node: see Middleware."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from operator import itemgetter
from typing import Any

from rosbags.serde import SerdeError

from xitl_cli.plugins.ros.definitions import deserialize, from_ros1, ros1_definition, service_md5, to_ros1
from xitl_cli.plugins.ros.discovery import Commanders
from xitl_cli.plugins.ros.middleware import NODE_NAME, MiddlewareLosses, QosProfile
from xitl_cli.plugins.ros.tcpros.master import SIM_TIME, NodeNotes, Registrar, master_uri, own_host
from xitl_cli.plugins.ros.tcpros.slave import SlaveServer
from xitl_cli.plugins.ros.tcpros.topics import ANY, HEADER_S, TopicPublisher, TopicSubscriber
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
from xitl_cli.profile.schema.ros import RosSpec

MOST_CONNECTIONS, MOST_OF_HOST = 256, 64
"""Largest number of connections, of all hosts and of one. At the limit, the longest idle connection is closed."""
IDLE_S = 300.0
"""Timeout of an idle persistent service call."""
ANSWER_S = 15.0
ACCEPT_AGAIN_S = 0.1
DESCRIPTION = "robot_description"


def ros1_name(type_name: str) -> str:
    """Return `sensor_msgs/Imu` for `sensor_msgs/msg/Imu`."""
    return type_name.replace("/msg/", "/").replace("/srv/", "/")


def ros1_type(type_name: str) -> Ros1Type:
    """Return a type by its ROS 2 name."""
    definition, md5 = ros1_definition(type_name)
    return Ros1Type(ros1_name(type_name), md5, definition)


MALFORMED: tuple[Any, ...] = (SerdeError, ValueError, IndexError, AssertionError)
"""Errors of rosbags for invalid data."""


class PeerConnection:
    """A connection to the node's port."""

    def __init__(self, end: socket.socket, host: str, port: int) -> None:
        self.end, self.host = end, host
        self.name = f"{host}:{port}"
        self.idle_since_s: float | None = time.monotonic()
        """Start of the peer's silence; None while it waits for an answer."""

    def close(self) -> None:
        shut(self.end)


class OfferedService:
    """A service. type_name: `std_srvs/srv/Trigger`. answer: takes and returns CDR."""

    def __init__(self, type_name: str, answer: Callable[[bytes], bytes]) -> None:
        self.type_name = type_name
        self.answer = answer
        self.kind = ros1_name(type_name)
        self.md5 = service_md5(type_name)


class TcprosMiddleware:
    """Middleware by TCPROS. Publishers send in separate threads; messages and requests wait for `spin`."""

    def __init__(self, spec: RosSpec, node_name: str = NODE_NAME) -> None:
        uri = master_uri(spec.master or "ros1://")
        host = own_host(uri)
        bound = "127.0.0.1" if host in ("localhost", "127.0.0.1") else ""
        self.name = f"ROS 1, master {uri}"
        self._notes = NodeNotes()
        self._commanders = Commanders(spec.commanders)
        self._publishers: dict[str, TopicPublisher] = {}
        self._subscribers: dict[str, TopicSubscriber] = {}
        self._services: dict[str, OfferedService] = {}
        self._inbox: deque[Callable[[], None]] = deque()
        self._arrived = threading.Condition()
        self._connections: set[PeerConnection] = set()
        self._closed = False
        self._host = host
        self._listener = socket.create_server((bound, 0))
        self.port: int = self._listener.getsockname()[1]
        """TCP port for topics and services."""
        node = "/".join(part for part in (spec.namespace.strip("/"), node_name) if part)
        self._registrar = Registrar(uri, f"/{node}", self._notes)
        self._registrar.set_parameter(SIM_TIME, True)
        self._slave = SlaveServer(host, bound, self, uri)
        self._registrar.start(self._slave.uri)
        threading.Thread(target=self._accept, name="tcpros", daemon=True).start()

    @property
    def node(self) -> str:
        """Name of the node at the master."""
        return self._registrar.node

    def losses(self) -> MiddlewareLosses:
        """See Middleware."""
        return MiddlewareLosses(dict(self._notes.dropped), dict(self._notes.refused))

    def advertise(self, topic: str, type_name: str, qos: QosProfile) -> Callable[[bytes], None]:
        """See Middleware. Data published on robot_description is also set as a parameter of the same name."""
        latching = qos.durability == "transient_local"
        kind = ros1_type(type_name)
        publisher = self._publishers[topic] = TopicPublisher(topic, kind, latching, qos.depth, self._notes)
        self._registrar.add_publisher(topic, kind.name)
        described = topic.rpartition("/")[2] == DESCRIPTION and type_name == "std_msgs/msg/String"

        def publish(cdr: bytes) -> None:
            if publisher.wanted:
                publisher.publish(to_ros1(cdr, type_name))
            if described:
                self._registrar.set_parameter(topic, str(deserialize(cdr, type_name).data))

        return publish

    def subscribe(self, topic: str, type_name: str, qos: QosProfile, handle: Callable[[bytes], None]) -> None:
        """See Middleware. If more than `qos.depth` messages wait, the oldest are dropped and counted."""
        waiting: deque[bytes] = deque()

        def deliver() -> None:
            with self._arrived:
                data = waiting.popleft() if waiting else None
            if data is None:
                return
            try:
                cdr = from_ros1(data, type_name)
            except MALFORMED:
                text = f"{topic}: a message of {len(data)} bytes is not a valid {ros1_name(type_name)}"
                self._notes.refuse(topic, text)
                return
            handle(cdr)

        def arrive(data: bytes) -> None:
            with self._arrived:
                waiting.append(data)
                if len(waiting) > qos.depth:
                    waiting.popleft()
                    self._notes.drop(topic)
                else:
                    self._inbox.append(deliver)
                self._arrived.notify()

        kind = ros1_type(type_name)
        subscriber = TopicSubscriber(
            topic, kind, arrive, lambda: self._registrar.node, self._notes, self._commanders.listed
        )
        self._subscribers[topic] = subscriber
        self._registrar.add_subscriber(topic, kind.name, subscriber)

    def serve(self, service: str, type_name: str, answer: Callable[[bytes], bytes]) -> None:
        """See Middleware."""
        self._services[service] = OfferedService(type_name, answer)
        self._registrar.add_service(service, f"rosrpc://{self._host}:{self.port}")

    def spin(self, timeout_s: float) -> None:
        """See Middleware."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._inbox, timeout_s)
            due = list(self._inbox)
            self._inbox.clear()
        for deliver in due:
            deliver()

    def problems(self) -> list[str]:
        """See Middleware."""
        return self._notes.sentences()

    def close(self) -> None:
        """See Middleware."""
        if self._closed:
            return
        self._closed = True
        self._registrar.stop()
        self._slave.stop()
        self._stop_talking()

    # Requests of the Slave API: see SlaveNode

    def publications(self) -> list[tuple[str, str]]:
        return [(publisher.topic, publisher.kind.name) for publisher in tuple(self._publishers.values())]

    def subscriptions(self) -> list[tuple[str, str]]:
        return [(subscriber.topic, subscriber.kind.name) for subscriber in tuple(self._subscribers.values())]

    def connections(self) -> list[tuple[str, str, str]]:
        publishers, subscribers = tuple(self._publishers.values()), tuple(self._subscribers.values())
        out = [(peer, "o", publisher.topic) for publisher in publishers for peer in publisher.peers]
        return out + [(peer, "i", subscriber.topic) for subscriber in subscribers for peer in subscriber.peers]

    def place_of(self, topic: str) -> tuple[str, int] | None:
        return (self._host, self.port) if topic in self._publishers else None

    def set_publishers(self, topic: str, uris: list[str]) -> None:
        if topic in self._subscribers and not self._closed:
            self._subscribers[topic].set_publishers(uris)

    def asked_to_stop(self, reason: str) -> None:
        why = reason or "no reason given"
        self._notes.tell(f"the ROS master stopped the node ({why}); the run continues without it")
        self._closed = True
        self._registrar.stop(leave=False)
        self._stop_talking()
        threading.Thread(target=self._slave.stop, daemon=True).start()  # not from the server's thread

    def _stop_talking(self) -> None:
        shut(self._listener)
        for subscriber in self._subscribers.values():
            subscriber.close()
        for publisher in self._publishers.values():
            publisher.close()
        for connection in tuple(self._connections):
            connection.close()

    # Connections of peers, for topics and services

    def _accept(self) -> None:
        while not self._closed:
            try:
                connection, place = self._listener.accept()
            except OSError:  # also for a connection that has already ended, or for too many open files
                if not self._closed:
                    time.sleep(ACCEPT_AGAIN_S)
                continue
            peer = PeerConnection(connection, *place[:2])
            if not self._has_room(peer.host):
                peer.close()
                continue
            self._connections.add(peer)
            threading.Thread(target=self._greet, args=(peer,), name="tcpros peer", daemon=True).start()

    def _has_room(self, host: str) -> bool:
        """Return True if a connection of the host may be added; close the longest idle one to make room."""
        of_host = [peer for peer in tuple(self._connections) if peer.host == host]
        limits = ((of_host, MOST_OF_HOST, f" of {host}"), (list(self._connections), MOST_CONNECTIONS, ""))
        for peers, most, of in limits:
            if len(peers) < most:
                continue
            idle = [(since_s, peer) for peer in peers if (since_s := peer.idle_since_s) is not None]
            if not idle:
                self._notes.refuse("connections", f"more than {most} connections{of} at once are refused")
                return False
            _, longest = min(idle, key=itemgetter(0))
            text = f"more than {most} connections{of} at once: the longest idle one, of {longest.name}, is closed"
            self._notes.refuse("connections", text)
            self._connections.discard(longest)
            longest.close()
        return True

    def _greet(self, peer: PeerConnection) -> None:
        """Read the request of the peer."""
        asked: Header = {}
        try:
            peer.end.settimeout(HEADER_S)
            peer.end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            asked = receive_header(peer.end)
            if "service" in asked:
                self._serve(peer, asked)
            elif (topic := asked.get("topic", "")) in self._publishers:
                self._publishers[topic].accept(peer.end, asked, self.node)
                self._connections.discard(peer)  # it now belongs to the publisher
                return
            else:
                raise TcprosError(f"it requested the topic {topic!r}, which is not published here")
        except TcprosError as error:
            ours = (*self._publishers, *self._services)
            about = next((name for key in ("topic", "service") if (name := asked.get(key)) in ours), "connections")
            self._notes.refuse(about, f"{about}: the peer at {peer.name} is refused: {error}")
            with contextlib.suppress(OSError):
                peer.end.sendall(encode_header({"error": str(error)}))
        except OSError:
            pass
        self._connections.discard(peer)
        peer.close()

    def _serve(self, peer: PeerConnection, asked: Header) -> None:
        """Answer requests until the peer closes or is idle for too long; answer one if the peer requests no more."""
        service = self._services.get(asked["service"])
        if service is None:
            raise TcprosError(f"it requested the service {asked['service']!r}, which is not offered here")
        kind = service.kind
        if asked.get("md5sum") not in (ANY, service.md5):
            raise TcprosError(f"it called the service as {asked.get('type', 'another type')}, but its type is {kind}")
        probe, persistent = (asked.get(key) == "1" for key in ("probe", "persistent"))
        if not probe and not self._commanders.listed(asked.get("callerid")):
            raise TcprosError(f"{asked.get('callerid', 'a node without a name')} is not in ros.commanders")
        peer.end.sendall(
            encode_header(
                {
                    "callerid": self.node,
                    "md5sum": service.md5,
                    "request_type": f"{kind}Request",
                    "response_type": f"{kind}Response",
                    "service": asked["service"],
                    "type": kind,
                }
            )
        )
        if probe:
            return
        peer.end.settimeout(IDLE_S if persistent else HEADER_S)
        while (request := self._next_request(peer, asked["service"])) is not None:
            peer.end.sendall(self._response(service, request))
            if not persistent:
                return

    def _next_request(self, peer: PeerConnection, service: str) -> bytes | None:
        """Return None if the peer has closed, or has sent no request for too long."""
        peer.idle_since_s = time.monotonic()
        try:
            return receive_block(peer.end, MOST_MESSAGE)
        except TimeoutError:
            self._notes.refuse(service, f"{service}: the connection of {peer.name} was idle for too long and is closed")
            return None
        finally:
            peer.idle_since_s = None

    def _response(self, service: OfferedService, request: bytes) -> bytes:
        """Return the response on the wire: a byte for success, then the response or an error."""
        response = Future[bytes]()
        with self._arrived:
            self._inbox.append(partial(self._answer, service, request, response))
            self._arrived.notify()
        try:
            return b"\1" + block(response.result(ANSWER_S))
        except TimeoutError:
            response.cancel()
            text = "the run did not answer in time"
        except TcprosError as error:
            text = str(error)
        return b"\0" + block(text.encode())

    def _answer(self, service: OfferedService, request: bytes, response: Future[bytes]) -> None:
        """Answer a request; called by `spin`."""
        if not response.set_running_or_notify_cancel():  # the peer has already received an error
            return
        try:
            answer = service.answer(from_ros1(request, f"{service.type_name}_Request"))
            response.set_result(to_ros1(answer, f"{service.type_name}_Response"))
        except MALFORMED as error:
            text = f"the request is not a valid {service.kind} ({type(error).__name__})"
            response.set_exception(TcprosError(text))
