"""The ROS 1 master by XML-RPC, and the registrations of a node, which are renewed after a restart of the master."""

from __future__ import annotations

import http.client
import os
import socket
import threading
from collections import Counter
from typing import Any, Protocol
from urllib.parse import urlsplit
from xml.parsers.expat import ExpatError
from xmlrpc.client import Error as XmlRpcError
from xmlrpc.client import ServerProxy, Transport

URI_VARIABLE, USUAL_URI = "ROS_MASTER_URI", "http://localhost:11311"
TIMEOUT_S = 3.0
RETRY_S = 1.0
SIM_TIME = "/use_sim_time"
MOST_SAID = 400
"""Limit in characters, because names and requests of peers may have any length."""


class MasterAwayError(Exception):
    """The master does not answer; the message is the reason."""


class MasterRefusedError(Exception):
    """The master answers and refuses a request; the message is the master's."""


class _PatientTransport(Transport):
    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = TIMEOUT_S
        return connection


def call(uri: str, method: str, *arguments: Any) -> Any:
    """Return the value from a master or a node. Raises MasterAwayError, MasterRefusedError."""
    try:
        with ServerProxy(uri, transport=_PatientTransport(), allow_none=True) as proxy:
            answer: Any = getattr(proxy, method)(*arguments)
        code, status, value = answer
    except XmlRpcError as error:
        raise MasterRefusedError(str(error)[:200]) from error
    except (OSError, http.client.HTTPException, ExpatError) as error:
        raise MasterAwayError(str(error) or type(error).__name__) from error
    except (TypeError, ValueError, LookupError, ArithmeticError) as error:  # xmlrpc checks hardly anything
        raise nonsense(method) from error
    if code != 1:
        raise MasterRefusedError(str(status)[:200])
    return value


def nonsense(method: str) -> MasterRefusedError:
    """Return the error for a method with an answer that violates the ROS API."""
    return MasterRefusedError(f"the answer to {method} does not follow the API of ROS")


def master_uri(master: str) -> str:
    """Return the URI for a profile's `ros1://HOST:PORT`; for `ros1://` that of the environment."""
    place = master.removeprefix("ros1://").strip("/")
    if not place:
        return os.environ.get(URI_VARIABLE) or USUAL_URI
    return f"http://{place}" if ":" in place else f"http://{place}:11311"


def own_host(uri: str) -> str:
    """Return the name by which other nodes reach this machine, with ROS 1's rules."""
    configured = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP")
    if configured:
        return configured
    place = urlsplit(uri)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # sends no packet
            probe.connect((place.hostname or "localhost", place.port or 11311))
            return str(probe.getsockname()[0])
    except (OSError, ValueError):  # ValueError: for an invalid port
        return "127.0.0.1"


class PublisherObserver(Protocol):
    """Receives the publishers of a topic, by their URIs."""

    def registering(self) -> None:
        """Called before the request to the master."""

    def registered(self, uris: list[str]) -> None:
        """Called with the master's answer."""


class Registrar:
    """Registers the node's publishers, subscribers, services and parameters with the master, in a separate thread."""

    def __init__(self, uri: str, node: str, notes: NodeNotes) -> None:
        self.uri = uri
        self.node = node
        """Name of the node, which changes if a running node has the same name."""
        self.node_uri = ""
        self._notes = notes
        self._registrations: dict[tuple[str, ...], tuple[Any, PublisherObserver | None]] = {}
        self._known: set[tuple[str, ...]] = set()
        self._left: list[str] = []
        self._master_id: int | None = None
        self._named = False
        self._change = threading.Event()
        self._over = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="ros master", daemon=True)

    def start(self, node_uri: str) -> None:
        """Start with node_uri, the URI of the node's XML-RPC server."""
        self.node_uri = node_uri
        self._thread.start()

    def add_publisher(self, topic: str, type_name: str) -> None:
        self._want(("registerPublisher", topic, type_name), None)

    def add_subscriber(self, topic: str, type_name: str, subscription: PublisherObserver) -> None:
        """Add a subscriber; subscription receives the publishers."""
        self._want(("registerSubscriber", topic, type_name), subscription)

    def add_service(self, service: str, place: str) -> None:
        """Add a service; place: rosrpc://HOST:PORT."""
        self._want(("registerService", service, place), None)

    def set_parameter(self, name: str, value: Any) -> None:
        """Set a parameter, or change its value. It is deleted at the end."""
        with self._lock:
            self._registrations[("setParam", name)] = value, None
            self._known.discard(("setParam", name))
        self._change.set()

    @property
    def reached(self) -> bool:
        """Return True if the master answered the last request."""
        return self._master_id is not None

    def stop(self, leave: bool = True) -> None:
        """Stop; leave: unregister the node from the master."""
        self._over.set()
        self._change.set()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(2 * TIMEOUT_S)
        if not leave or not self.reached:
            return
        for method, name, *rest in sorted(self._known):
            arguments = {
                "registerPublisher": ("unregisterPublisher", name, self.node_uri),
                "registerSubscriber": ("unregisterSubscriber", name, self.node_uri),
                "registerService": ("unregisterService", name, *rest),
                "setParam": ("deleteParam", name),
            }[method]
            try:
                self._ask(*arguments)
            except MasterRefusedError:
                continue
            except MasterAwayError:
                return

    def _want(self, key: tuple[str, ...], subscription: PublisherObserver | None) -> None:
        with self._lock:
            self._registrations[key] = None, subscription
        self._change.set()

    def _run(self) -> None:
        while not self._over.is_set():
            self._change.clear()
            try:
                self._send_missing()
            except MasterAwayError as error:
                self._notes.tell(
                    f"the ROS master at {self.uri} does not answer ({error}); start `roscore` there; the run continues "
                    "and asks it again every second",
                    "away",
                )
                self._master_id = None
            self._change.wait(RETRY_S)

    def _send_missing(self) -> None:
        """Send missing registrations to the master."""
        try:
            master_id = self._ask("getPid")
        except MasterRefusedError as error:  # a page of another server
            raise MasterAwayError(str(error)) from error
        if not self._named:  # choose a name that no other node has
            try:
                call(str(self._ask("lookupNode", self.node)), "getPid", self.node)
            except (MasterRefusedError, MasterAwayError):
                pass  # no node has this name, or it has ended
            else:
                taken, self.node = self.node, f"{self.node}_{os.getpid()}"
                self._notes.tell(f"the ROS master already has a node {taken}; this node has the name {self.node}")
            self._named = True
        if master_id != self._master_id:
            with self._lock:
                self._known.clear()
            self._notes.forget("away")
        self._master_id = master_id
        with self._lock:
            pending = {key: value for key, value in self._registrations.items() if key not in self._known}
        for key, (value, subscription) in pending.items():
            if self._over.is_set():
                return
            try:
                self._register(key, value, subscription)
            except MasterRefusedError as error:
                self._notes.tell(f"the ROS master refuses {key[0]} of {key[1]}: {error}")

    def _register(self, key: tuple[str, ...], value: Any, subscription: PublisherObserver | None) -> None:
        method, name, *rest = key
        if method == "setParam":
            if name == SIM_TIME and self._ask("hasParam", name) and self._ask("getParam", name) is True:
                return  # another node's service: it remains registered at the end
            self._known.add(key)
            self._ask(method, name, value)
            return
        self._known.add(key)
        if subscription is not None:
            subscription.registering()
        uris = self._ask(method, name, *rest, self.node_uri)
        if method == "registerPublisher":
            self._look_for_others(name)
        elif subscription is not None:
            if not isinstance(uris, list) or not all(isinstance(uri, str) for uri in uris):
                raise nonsense(method)
            subscription.registered(uris)

    def _look_for_others(self, topic: str) -> None:
        """Warn of other publishers of the same topic."""
        try:
            publishers, _, _ = self._ask("getSystemState")
            others = sorted({str(node) for name, nodes in publishers if name == topic for node in nodes} - {self.node})
        except (TypeError, ValueError) as error:
            raise nonsense("getSystemState") from error
        shared = topic in ("/tf", "/tf_static")  # shared by all nodes that publish frames
        if others and not shared:
            self._notes.tell(
                f"{', '.join(others)} also publishes {topic}; give one of the two a namespace (ros.namespace)",
                "others",
            )

    def _ask(self, method: str, *arguments: Any) -> Any:
        return call(self.uri, method, self.node, *arguments)


class NodeNotes:
    """Reports of a node: sentences, each once, and counts by topic."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        """Messages that did not fit in a queue, of slow readers or fast writers."""
        self.refused: Counter[str] = Counter()
        """Messages and peers."""
        self._sentences: list[str] = []
        self._reported: set[str] = set()
        self._lock = threading.Lock()

    def tell(self, sentence: str, again: str = "") -> None:
        """Report a sentence once, until `forget(again)`."""
        key = again or sentence
        with self._lock:
            if key not in self._reported:
                self._reported.add(key)
                self._sentences.append(sentence[:MOST_SAID])

    def forget(self, again: str) -> None:
        with self._lock:
            self._reported.discard(again)

    def refuse(self, topic: str, sentence: str) -> None:
        """Report a refusal once, and count it: the report explains the count."""
        self.tell(sentence, f"refused {topic}")
        with self._lock:
            self.refused[topic] += 1

    def drop(self, topic: str) -> None:
        with self._lock:
            self.dropped[topic] += 1

    def sentences(self) -> list[str]:
        """Return new sentences since the last call."""
        with self._lock:
            sentences, self._sentences = self._sentences, []
        return sentences
