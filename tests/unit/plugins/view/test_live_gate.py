"""The gate in front of the server of Foxglove, against hostile peers."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from tests.patience import PATIENCE_S
from xitl_cli.plugins.view import live_gate
from xitl_cli.plugins.view.live_gate import Gate, refusal
from xitl_cli.plugins.view.server import ViewAddress, listen

GREETING = b"HTTP/1.1 101 Switching Protocols\r\n\r\n"


@pytest.fixture
def inner() -> Iterator[tuple[str, int]]:
    """A server behind the gate that greets and keeps each connection."""
    listener = socket.create_server(("127.0.0.1", 0))
    kept: list[socket.socket] = []

    def serve() -> None:
        while True:
            try:
                end, _ = listener.accept()
            except OSError:
                return
            kept.append(end)
            end.sendall(GREETING)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield listener.getsockname()
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()
    thread.join()
    for end in kept:
        end.close()


@pytest.fixture
def gate(inner: tuple[str, int]) -> Iterator[tuple[Gate, ViewAddress]]:
    listener, address = listen("127.0.0.1", None, usual=18_765)
    made = Gate(listener, address, inner)
    yield made, address
    made.close()


def request(address: ViewAddress, first: str = "", *headers: str) -> bytes:
    line = first or f"GET /?token={address.token} HTTP/1.1"
    return "\r\n".join([line, f"Host: 127.0.0.1:{address.port}", *headers, "", ""]).encode("latin-1")


def answer(address: ViewAddress, sent: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", address.port), PATIENCE_S) as client:
        client.sendall(sent)
        return client.recv(1 << 12)


@pytest.mark.parametrize(
    "sent",
    [
        ("GET /?token={token} HTTP/1.0",),
        ("POST /?token={token} HTTP/1.1",),
        ("GET http://evil.example/?token={token} HTTP/1.1",),
        ("GET  /?token={token} HTTP/1.1",),
        ("", "Origin : https://evil.example"),
        ("", "X: a\nOrigin: https://evil.example"),
        ("", "X: a\rOrigin: https://evil.example"),
        ("", "X: a", " Origin: https://evil.example"),
        ("", "no colon"),
    ],
)
def test_a_request_that_two_servers_may_read_differently_is_refused(
    gate: tuple[Gate, ViewAddress], sent: tuple[str, ...]
) -> None:
    _, address = gate
    first, *headers = sent
    got = answer(address, request(address, first.format(token=address.token), *headers))
    assert got.startswith(b"HTTP/1.1 403")
    assert b"not a valid HTTP/1.1 request" in got
    assert answer(address, request(address)) == GREETING


def test_what_follows_a_refused_request_is_not_read(gate: tuple[Gate, ViewAddress]) -> None:
    _, address = gate
    with socket.create_connection(("127.0.0.1", address.port), PATIENCE_S) as client:
        client.sendall(request(address, "GET / HTTP/1.1") + request(address))
        got = b""
        while chunk := client.recv(1 << 12):
            got += chunk
    assert got.count(b"HTTP/1.1") == 1
    assert got.startswith(b"HTTP/1.1 403")


def test_the_host_is_a_name_of_this_machine_and_the_token_is_in_the_query() -> None:
    address = ViewAddress("127.0.0.1", 8765, "secret")
    good = "GET /?token=secret HTTP/1.1\r\nHost: localhost:8765"
    assert refusal(address, good.encode()) == ""
    for changed in (
        good.replace("localhost:8765", "evil.example:8765"),
        good.replace("localhost:8765", "127.0.0.1.nip.io"),
        good.replace("localhost:8765", "127.0.0.1@evil.example"),
        good.replace("\r\nHost: localhost:8765", ""),
        good.replace("/?token=secret", "/secret/"),
        good.replace("?token=secret", "?token=bad&token=secret"),
        good + "\r\nHost: localhost:8765",
        good + "\r\nOrigin: null",
        good + "\r\nOrigin: https://foxglove.dev@evil.example",
    ):
        assert refusal(address, changed.encode()), changed


def test_silent_connections_lock_nobody_out_and_hold_few_descriptors(gate: tuple[Gate, ViewAddress]) -> None:
    made, address = gate
    idle = [socket.create_connection(("127.0.0.1", address.port), PATIENCE_S) for _ in range(300)]
    assert answer(address, request(address)) == GREETING
    closed = 0
    for end in idle[: 300 - live_gate.MOST_WAITING]:
        end.settimeout(PATIENCE_S)
        try:
            closed += not end.recv(1)
        except ConnectionResetError:
            closed += 1
    assert closed == 300 - live_gate.MOST_WAITING
    for end in idle:
        end.close()
    assert made.refused >= closed
