"""A ROS 1 master of a page: registrations, parameters, and the news of publishers to subscribers."""

from __future__ import annotations

import re
import threading
from contextlib import suppress
from queue import Queue
from typing import Any
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCServer


class FakeMaster:
    """number: what it says its process is; a master that was started anew has another."""

    def __init__(self, port: int = 0, number: int = 1) -> None:
        self.number = number
        self.publishers: dict[str, list[tuple[str, str]]] = {}
        self.subscribers: dict[str, list[tuple[str, str]]] = {}
        self.services: dict[str, str] = {}
        self.parameters: dict[str, Any] = {}
        self.nodes: dict[str, str] = {}
        self._updates: Queue[tuple[str, str, list[str]] | None] = Queue()
        self._server = SimpleXMLRPCServer(("127.0.0.1", port), logRequests=False, allow_none=True)
        self.port: int = self._server.server_address[1]
        self.uri = f"ros1://127.0.0.1:{self.port}"
        self._server.register_instance(self)
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()
        threading.Thread(target=self._send_updates, daemon=True).start()

    def stop(self) -> None:
        self._updates.put(None)
        self._server.shutdown()
        self._server.server_close()

    def _dispatch(self, method: str, arguments: tuple[Any, ...]) -> list[Any]:
        found = getattr(self, "on_" + re.sub("(?=[A-Z])", "_", method).lower())(*arguments)
        return [1, "", found] if found is not None else [-1, "unknown", 0]

    def on_get_pid(self, node: str) -> int:
        return self.number

    def on_lookup_node(self, node: str, wanted: str) -> str | None:
        return self.nodes.get(wanted)

    def on_register_publisher(self, node: str, topic: str, kind: str, uri: str) -> list[str]:
        self.nodes[node] = uri
        self.publishers.setdefault(topic, []).append((node, uri))
        self._news(topic)
        return [place for _, place in self.subscribers.get(topic, [])]

    def on_unregister_publisher(self, node: str, topic: str, uri: str) -> int:
        self.publishers[topic].remove((node, uri))
        self._news(topic)
        return 1

    def on_register_subscriber(self, node: str, topic: str, kind: str, uri: str) -> list[str]:
        self.nodes[node] = uri
        self.subscribers.setdefault(topic, []).append((node, uri))
        return [place for _, place in self.publishers.get(topic, [])]

    def on_unregister_subscriber(self, node: str, topic: str, uri: str) -> int:
        self.subscribers[topic].remove((node, uri))
        return 1

    def on_register_service(self, node: str, service: str, place: str, uri: str) -> int:
        self.services[service] = place
        return 1

    def on_unregister_service(self, node: str, service: str, place: str) -> int:
        return int(self.services.pop(service, None) is not None)

    def on_get_system_state(self, node: str) -> list[Any]:
        return [[[topic, [name for name, _ in each]] for topic, each in self.publishers.items()], [], []]

    def on_has_param(self, node: str, name: str) -> bool:
        return name in self.parameters

    def on_get_param(self, node: str, name: str) -> Any:
        return self.parameters[name]

    def on_set_param(self, node: str, name: str, value: Any) -> int:
        self.parameters[name] = value
        return 0

    def on_delete_param(self, node: str, name: str) -> int:
        del self.parameters[name]
        return 0

    def _news(self, topic: str) -> None:
        uris = [uri for _, uri in self.publishers[topic]]
        for _, uri in self.subscribers.get(topic, []):
            self._updates.put((uri, topic, uris))

    def _send_updates(self) -> None:
        """In order, as roscore does for each subscriber: an older list never replaces a newer one."""
        while (update := self._updates.get()) is not None:
            uri, topic, publishers = update
            with suppress(OSError), ServerProxy(uri) as node:
                node.publisherUpdate("/master", topic, publishers)
