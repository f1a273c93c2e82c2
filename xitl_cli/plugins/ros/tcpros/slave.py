"""Requests of the master and other nodes to a node by XML-RPC: the Slave API."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Sequence
from socketserver import ThreadingMixIn
from typing import Any, Protocol
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

from xitl_cli.plugins.ros.tcpros.wire import shut

MOST_REQUEST = 1 << 20
MOST_CONNECTIONS = 64
"""Largest number of connections, each with a thread. At the limit, the oldest is closed."""
TCPROS = "TCPROS"


class SlaveNode(Protocol):
    """Requests of the server to its node."""

    def publications(self) -> list[tuple[str, str]]:
        """Return topic and type."""

    def subscriptions(self) -> list[tuple[str, str]]:
        """Return topic and type."""

    def connections(self) -> list[tuple[str, str, str]]:
        """Return peer, "i" or "o", topic."""

    def place_of(self, topic: str) -> tuple[str, int] | None:
        """Return host and port of the topic's server; None for a topic that is not published."""

    def set_publishers(self, topic: str, uris: list[str]) -> None:
        """Set the publishers of a subscribed topic."""

    def asked_to_stop(self, reason: str) -> None:
        """Called when the master requests a stop."""


class SlaveServer(ThreadingMixIn, SimpleXMLRPCServer):
    """Answers in separate threads."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, host: str, bound: str, node: SlaveNode, master: str) -> None:
        self._open: dict[socket.socket, None] = {}  # oldest first
        self._open_lock = threading.Lock()
        super().__init__((bound, 0), _Handler, logRequests=False, allow_none=True)
        self.uri = f"http://{host}:{self.server_address[1]}/"
        """Address for the master."""
        self.register_instance(_SlaveApi(node, master))
        self._thread = threading.Thread(target=self.serve_forever, args=(0.1,), name="ros node", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self.shutdown()
        self.server_close()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a new thread, and make room for it."""
        with self._open_lock:
            if len(self._open) >= MOST_CONNECTIONS:
                oldest = next(iter(self._open))
                del self._open[oldest]
                shut(oldest)
            self._open[request] = None
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Handle the end of a connection."""
        with self._open_lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore a disconnected peer: it is not reported on the terminal."""


class _Handler(SimpleXMLRPCRequestHandler):
    rpc_paths = ()  # any: nodes use / or /RPC2
    timeout = 10.0

    def parse_request(self) -> bool:
        """Refuse a request longer than any of ROS."""
        if not super().parse_request():
            return False
        length = self.headers.get("content-length", "")
        if not length.isdecimal() or int(length) > MOST_REQUEST:
            self.send_error(413)
            return False
        return True


class _SlaveApi:
    """Methods of the API. Each returns code, status and value; its first argument is the caller's name."""

    def __init__(self, node: SlaveNode, master: str) -> None:
        self._node = node
        self._methods: dict[str, Callable[..., list[Any]]] = {
            "getMasterUri": lambda caller: [1, "", master],
            "getPid": lambda caller: [1, "", os.getpid()],
            "getPublications": lambda caller: [1, "publications", list(map(list, node.publications()))],
            "getSubscriptions": lambda caller: [1, "subscriptions", list(map(list, node.subscriptions()))],
            "getBusStats": lambda caller: [1, "bus stats", [[], [], []]],
            "getBusInfo": self._bus_info,
            "paramUpdate": lambda caller, name, value: [1, "", 0],
            "publisherUpdate": self._publisher_update,
            "requestTopic": self._request_topic,
            "shutdown": self._stop,
        }

    def _dispatch(self, method: str, arguments: Sequence[Any]) -> list[Any]:
        """Dispatch a method; called by the server."""
        return self._methods[method](*arguments)

    def _bus_info(self, caller: str) -> list[Any]:
        links = enumerate(self._node.connections())
        return [1, "bus info", [[number, peer, way, TCPROS, topic, True] for number, (peer, way, topic) in links]]

    def _publisher_update(self, caller: str, topic: str, publishers: Sequence[Any]) -> list[Any]:
        self._node.set_publishers(str(topic), [str(uri) for uri in publishers])
        return [1, "", 0]

    def _request_topic(self, caller: str, topic: str, protocols: Sequence[Any]) -> list[Any]:
        place = self._node.place_of(str(topic))
        if place is None:
            return [-1, f"{topic} is not published here", 0]
        if not any(isinstance(protocol, list) and protocol[:1] == [TCPROS] for protocol in protocols):
            return [0, "this node supports only TCPROS", 0]
        host, port = place
        return [1, f"ready on {host}:{port}", [TCPROS, host, port]]

    def _stop(self, caller: str, reason: str = "") -> list[Any]:
        self._node.asked_to_stop(str(reason))
        return [1, "", 0]
