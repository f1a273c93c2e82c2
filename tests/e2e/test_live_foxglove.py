"""`xitl sim --live foxglove` as a client of Foxglove's WebSocket protocol meets it."""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from conftest import payloads

from tests.patience import PATIENCE_S, wait_until
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.operator.operation import Operation
from xitl_cli.run.session import Result, run

PROTOCOL = "foxglove.sdk.v1"
MESSAGE, TIME, ANSWER = 1, 2, 3
PUBLISH, CALL = 1, 2


class FoxgloveClient:
    """Frames of the protocol by hand: what comes is kept, `until` waits for it."""

    def __init__(self, socket: Any) -> None:
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.parameters: dict[str, Any] = {}
        self.statuses: list[str] = []
        self.answers: dict[int, dict[str, Any]] = {}
        self.payloads: dict[str, list[tuple[int, bytes]]] = {}
        self.now_ns = 0
        self.capabilities: set[str] = set()
        self._socket = socket
        self._topics: dict[int, str] = {}
        self._calls = 0

    def until(self, true: Any) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while not true():
            assert time.monotonic() < until_s, "it does not come"
            try:
                self._take_in(self._socket.recv(timeout=1.0))
            except TimeoutError:
                continue

    def _take_in(self, frame: str | bytes) -> None:
        if isinstance(frame, bytes):
            if frame[0] == MESSAGE:
                subscription, stamp_ns = struct.unpack_from("<IQ", frame, 1)
                self.payloads.setdefault(self._topics[subscription], []).append((stamp_ns, frame[13:]))
            elif frame[0] == TIME:
                (self.now_ns,) = struct.unpack_from("<Q", frame, 1)
            elif frame[0] == ANSWER:
                _, call, length = struct.unpack_from("<III", frame, 1)
                self.answers[call] = json.loads(frame[13 + length :])
            return
        said = json.loads(frame)
        if said["op"] == "serverInfo":
            self.capabilities = set(said["capabilities"])
        elif said["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in said["channels"]}
        elif said["op"] == "advertiseServices":
            self.services |= {service["name"]: service for service in said["services"]}
        elif said["op"] == "parameterValues":
            self.parameters |= {one["name"]: one.get("value") for one in said["parameters"]}
        elif said["op"] == "status":
            self.statuses.append(said["message"])

    def tell(self, **operation: Any) -> None:
        self._socket.send(json.dumps(operation))

    def subscribe(self, *topics: str) -> None:
        wanted = []
        for topic in topics:
            number = len(self._topics) + 1
            self._topics[number] = topic
            wanted.append({"id": number, "channelId": self.channels[topic]["id"]})
        self.tell(op="subscribe", subscriptions=wanted)

    def call(self, action: str, **keys: Any) -> dict[str, Any]:
        return self.call_json(action, json.dumps(keys))

    def call_json(self, action: str, text: str) -> dict[str, Any]:
        self._calls += 1
        number, service = self._calls, self.services[f"/operator/{action}"]["id"]
        head = struct.pack("<BIII", CALL, service, number, 4)
        self._socket.send(head + b"json" + text.encode())
        self.until(lambda: number in self.answers)
        return self.answers[number]

    def publish(self, topic: str, message: Any) -> None:
        number = len(topic)
        channel = {"id": number, "topic": topic, "encoding": "json", "schemaName": "any"}
        self.tell(op="advertise", channels=[channel])
        self._socket.send(struct.pack("<BI", PUBLISH, number) + json.dumps(message).encode())


@contextmanager
def client_at(address: str) -> Iterator[FoxgloveClient]:
    from websockets.sync.client import connect

    with connect(address, subprotocols=[PROTOCOL], max_size=None) as socket:  # type: ignore[list-item]
        yield FoxgloveClient(socket)


@pytest.mark.slow
def test_foxglove_sees_what_is_recorded_and_acts(tmp_path: Path) -> None:
    pytest.importorskip("websockets")
    profile = load_profile("sitl", ["clock.duration_s=15.0", "live.foxglove=true", "live.commands=true"])
    addresses: list[str] = []
    results: list[Result] = []
    operation = Operation(pace=0.1)  # it has not ended before it is paused, however slow the client

    def sail() -> None:
        results.append(run(profile, tmp_path / "run", False, NoDisplay, operation=operation, tell=addresses.append))

    sailing = threading.Thread(target=sail)
    sailing.start()
    try:
        wait_until(lambda: addresses)
        address = addresses[0].split()[1]
        with client_at(address) as idle, client_at(address) as client:
            client.until(lambda: {"/truth/state", "/scene", "/log"} <= client.channels.keys())
            client.until(lambda: "/operator/launch" in client.services)
            client.until(lambda: client.now_ns > 0)
            # One that asks for everything and never reads again.
            idle.until(lambda: "/truth/state" in idle.channels)
            idle.subscribe(*idle.channels)

            client.subscribe("/truth/state", "/scene", "/log")
            client.until(lambda: client.payloads.keys() >= {"/truth/state", "/scene"})
            assert client.call("pause") == {"success": True, "message": ""}
            assert not client.call("pause")["success"]
            assert "write its keys as a JSON object" in client.call_json("pause", "null")["message"]
            assert not client.call("launch", kind="tree", north_m=0.0, east_m=0.0)["success"]
            assert client.call("launch", kind="trunk", north_m=5.0, east_m=40.0)["success"]
            client.tell(op="getParameters", parameterNames=["paused", "environment.wind.mean_mps"], id="any")
            client.until(lambda: client.parameters.get("paused") is True)
            client.tell(op="subscribeParameterUpdates", parameterNames=["environment.wind.mean_mps"])
            changes = [{"name": "environment.wind.mean_mps", "value": value} for value in (9, 900)]
            client.tell(op="setParameters", parameters=changes, id="other")
            client.until(lambda: any("mean_mps = 900 is too large" in text for text in client.statuses))
            assert client.call("step", seconds=0.1)["success"]  # what was asked for is done when time goes on
            client.until(lambda: client.parameters.get("environment.wind.mean_mps") == 9.0)
            client.publish("/goal", {"pose": {"position": {"x": 20.0, "y": 10.0, "z": 0.0}}})
            client.publish("/nowhere/at-all", {})
            client.until(lambda: any("the run does not use" in text for text in client.statuses))
            client.publish("/operator/ask", {"action": "pace", "factor": None})
            assert client.call("resume")["success"]
            client.until(lambda: any(b"go to 10.0 N 20.0 E" in payload for _, payload in client.payloads["/log"]))
            shown = {topic: list(client.payloads[topic]) for topic in ("/truth/state", "/log")}
            definition = client.channels["/truth/state"]["schema"]
    finally:
        sailing.join(3 * PATIENCE_S)
    assert not sailing.is_alive()
    summary = results[0].summary
    assert summary["live"] == {
        "address": address.partition("/?")[0],
        "clients": 2,
        "refused_connections": 0,
        "dropped": None,
        "actions": 10,
        "refused": 3,
    }
    actions = summary["operator"]["actions"]
    assert actions == {"pause": 1, "launch": 1, "step": 1, "wind": 1, "goto": 1, "pace": 1, "resume": 1}
    assert summary["debris"]["by"] == {"trunk": 1}
    # Payload and stamp of what came are those of the recording.
    recorded = payloads(results[0].recording)
    for topic, messages in shown.items():
        assert set(messages) <= set(recorded[topic])
    assert "float64[3] position_ned_m" in definition
    sources = [payload for _, payload in recorded["/operator/action"]]
    assert all(b"foxglove" in payload for payload in sources)


def shaken(address: str, host: str, target: str, origin: str | None) -> int:
    """The HTTP status of a WebSocket handshake whose head is written by hand."""
    import socket

    where = urlsplit(address)
    assert where.hostname is not None
    lines = [f"GET {target} HTTP/1.1", f"Host: {host}", "Upgrade: websocket", "Connection: Upgrade"]
    lines += ["Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="]
    lines += [f"Sec-WebSocket-Protocol: {PROTOCOL}", *([] if origin is None else [f"Origin: {origin}"]), "", ""]
    with socket.create_connection((where.hostname, where.port), timeout=PATIENCE_S) as asking:
        asking.sendall("\r\n".join(lines).encode())
        return int(asking.recv(4096).split()[1])


@pytest.mark.slow
def test_a_page_of_another_site_is_refused_and_a_client_only_reads_by_default(tmp_path: Path) -> None:
    profile = load_profile("sitl", ["clock.duration_s=20.0", "live.foxglove=true"])
    addresses: list[str] = []
    results: list[Result] = []
    operation = Operation(pace=1.0)

    def sail() -> None:
        results.append(run(profile, tmp_path / "run", False, NoDisplay, operation=operation, tell=addresses.append))

    sailing = threading.Thread(target=sail)
    sailing.start()
    try:
        wait_until(lambda: addresses)
        address = addresses[0].split()[1]
        parts = urlsplit(address)
        own, token = parts.netloc, f"/?{parts.query}"
        assert "read-only" in addresses[0]
        assert shaken(address, own, token, None) == 101
        assert shaken(address, own, token, "https://app.foxglove.dev") == 101
        assert shaken(address, own, token, f"http://{own}") == 101
        for host, target, origin in (
            (own, token, "https://elsewhere.example"),
            (own, token, "https://foxglove.dev.elsewhere.example"),
            (own, token, "null"),
            ("elsewhere.example", token, None),
            (f"elsewhere.example:{parts.port}", token, f"http://elsewhere.example:{parts.port}"),
            (own, "/", None),
            (own, "/", "https://app.foxglove.dev"),
            (own, "/?token=wrong", None),
        ):
            assert shaken(address, host, target, origin) == 403, (host, target, origin)
        with client_at(address) as client:
            client.until(lambda: "/truth/state" in client.channels)
            assert client.capabilities == {"time"}
            assert client.services == {}
            client.publish("/operator/ask", {"action": "end"})
            client.tell(op="setParameters", parameters=[{"name": "paused", "value": True}], id="x")
            before_ns = client.now_ns
            client.until(lambda: client.now_ns > before_ns + 500_000_000)
    finally:
        sailing.join(3 * PATIENCE_S)
    assert results[0].summary["operator"] is None  # nobody acted
    assert results[0].summary["live"]["refused_connections"] == 8


@pytest.mark.medium
def test_a_port_that_is_taken_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import socket

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        profile = load_profile("sitl", [f"live.port={port}"])
        with pytest.raises(UserError, match=f"live.port = {port}: another program listens there"):
            run(profile, tmp_path / "run", False, NoDisplay)
    assert not (tmp_path / "run").exists()
