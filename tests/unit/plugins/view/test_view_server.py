"""Where a view listens, and whom it lets in."""

from __future__ import annotations

import asyncio
import gzip
import http.client
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.patience import PATIENCE_S, let_pass
from xitl_cli.errors import UserError
from xitl_cli.http_access import is_loopback
from xitl_cli.plugins.view import server as view_server
from xitl_cli.plugins.view.server import ViewAddress, listen, make_server

viser = pytest.importorskip("viser")
connect = pytest.importorskip("websockets.sync.client").connect
refused = pytest.importorskip("websockets.exceptions").InvalidStatus

SUBPROTOCOL = f"viser-v{viser.__version__}"


@pytest.fixture(scope="module")
def guarded() -> Iterator[ViewAddress]:
    """One that listens everywhere, and so has a token."""
    listener, address = listen("0.0.0.0", None)
    server = make_server(listener, address, "with a token")
    yield address
    server.stop()


@pytest.fixture(scope="module")
def own() -> Iterator[ViewAddress]:
    listener, address = listen("127.0.0.1", None)
    server = make_server(listener, address, "A <title>")
    yield address
    server.stop()


def get(address: ViewAddress, path: str, **headers: str) -> tuple[int, str]:
    client = http.client.HTTPConnection("127.0.0.1", address.port, timeout=PATIENCE_S)
    client.request("GET", path, headers=headers)
    answer = client.getresponse()
    body = answer.read()
    client.close()
    if answer.headers.get("Content-Encoding") == "gzip":
        body = gzip.decompress(body)
    return answer.status, body.decode(errors="replace")


def join(address: ViewAddress, path: str, origin: str | None = None) -> None:
    with connect(f"ws://127.0.0.1:{address.port}{path}", subprotocols=[SUBPROTOCOL], origin=origin, proxy=None) as one:
        assert one.recv(timeout=PATIENCE_S)


def test_a_browser_that_comes_while_the_server_is_made_is_let_in(monkeypatch: pytest.MonkeyPatch) -> None:
    listener, address = listen("127.0.0.1", None)
    came = threading.Event()
    start = viser.infra.WebsockServer.start

    def start_slowly(server: Any) -> None:
        start(server)
        assert came.wait(PATIENCE_S)
        let_pass(0.3)  # in which the server of before failed the connection

    def come() -> bytes:
        with connect(f"ws://127.0.0.1:{address.port}/{address.token}/", subprotocols=[SUBPROTOCOL], proxy=None) as one:
            came.set()
            first: bytes = one.recv(timeout=PATIENCE_S)
            return first

    monkeypatch.setattr(viser.infra.WebsockServer, "start", start_slowly)
    with ThreadPoolExecutor(1) as pool:
        said = pool.submit(come)
        server = make_server(listener, address, "slow to be made")
        assert said.result()
    server.stop()


def test_without_the_token_nothing_is_served(guarded: ViewAddress) -> None:
    assert len(guarded.token) >= 20
    assert guarded.url.endswith(f":{guarded.port}/{guarded.token}/")
    for path in ("/", "/index.html", "/?token=", "/wrong/", f"/{guarded.token[:-1]}/", f"/x/../{guarded.token}"):
        status, body = get(guarded, path)
        assert status == 403, path
        assert "token" in body
        assert "<html" not in body
        with pytest.raises(refused, match="403"):
            join(guarded, path)


def test_with_the_token_page_and_connection_are(guarded: ViewAddress) -> None:
    status, body = get(guarded, f"/{guarded.token}/")
    assert status == 200
    assert "<html" in body
    join(guarded, f"/{guarded.token}")
    join(guarded, f"/{guarded.token}/", origin=f"http://127.0.0.1:{guarded.port}")


def test_this_machine_needs_the_token_too(own: ViewAddress) -> None:
    assert own.url == f"http://127.0.0.1:{own.port}/{own.token}/"
    assert get(own, "/")[0] == 403
    assert get(own, f"/{own.token}/")[0] == 200
    assert get(own, f"/{own.token}/", Host=f"localhost:{own.port}")[0] == 200
    with pytest.raises(refused, match="403"):
        join(own, "/")
    join(own, f"/{own.token}/")


def test_another_page_may_not_connect(own: ViewAddress, guarded: ViewAddress) -> None:
    with pytest.raises(refused, match="403"):
        join(own, f"/{own.token}", origin="http://elsewhere.example")
    with pytest.raises(refused, match="403"):
        join(guarded, f"/{guarded.token}", origin="http://elsewhere.example")


def test_a_page_of_another_port_of_this_machine_may_not_connect(own: ViewAddress, guarded: ViewAddress) -> None:
    for address, path in ((own, "/"), (guarded, f"/{guarded.token}")):
        with pytest.raises(refused, match="403"):
            join(address, path, origin=f"http://127.0.0.1:{address.port + 1}")
        with pytest.raises(refused, match="403"):
            join(address, path, origin="http://127.0.0.1")


def test_a_name_that_points_here_may_not_either(own: ViewAddress) -> None:
    status, body = get(own, f"/{own.token}/", Host="elsewhere.example")
    assert (status, "elsewhere.example" in body) == (403, True)


def test_the_page_has_its_title_and_a_word_for_who_has_no_webgl(own: ViewAddress) -> None:
    for headers in ({}, {"Accept-Encoding": "gzip"}):
        _, body = get(own, f"/{own.token}/", **headers)
        assert "<title>A &lt;title&gt;</title>" in body
        assert body.count("<title>") == 1
        assert "xitl-no-webgl" in body


def test_a_thread_that_draws_wakes_nobody_outside_the_event_loop(own: ViewAddress) -> None:
    """Or what waits may leave while the thread goes through all that wait: RuntimeError, once in a while."""
    from viser._messages import SetCameraFovMessage
    from viser.infra._infra import AsyncMessageBuffer

    loop = asyncio.new_event_loop()
    buffers = [AsyncMessageBuffer(loop, persistent_messages=persistent) for persistent in (True, False)]
    for buffer in buffers:
        event = buffer.message_event
        waiting = loop.create_task(event.wait())
        loop.run_until_complete(asyncio.sleep(0))
        buffer.event_loop.call_soon_threadsafe = lambda told: None
        buffer.push(SetCameraFovMessage(0.9))
        assert event.is_set()
        assert not any(future.done() for future in event._waiters)
        del buffer.event_loop.call_soon_threadsafe
        buffer.push(SetCameraFovMessage(0.8))
        assert loop.run_until_complete(asyncio.wait_for(waiting, PATIENCE_S))
    loop.close()


def test_no_page_may_have_it_shown_through_a_machine_elsewhere() -> None:
    """As viser's own server does for any page that asks."""
    from viser._messages import ShareUrlDisconnect, ShareUrlRequest

    usual = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    ours = make_server(*listen("127.0.0.1", None), "test")
    asked = {ShareUrlRequest, ShareUrlDisconnect}
    answered = [asked & server._websock_server._incoming_handlers.keys() for server in (usual, ours)]
    for server in (usual, ours):
        server.stop()
    assert answered == [asked, set()]


def test_a_port_that_is_taken() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(UserError, match=rf"view.port = {port}: another program listens there"):
            listen("127.0.0.1", port)


def test_the_usual_port_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        monkeypatch.setattr(view_server, "USUAL_PORT", port)
        listener, address = listen("127.0.0.1", None)
        with listener:
            assert address.port > port
            assert address.moved == port


@pytest.mark.parametrize("host", ["203.0.113.7", "no-such-host.invalid"])
def test_an_address_that_this_machine_has_not(host: str) -> None:
    with pytest.raises(UserError, match=rf"view.host = {host}: cannot listen there"):
        listen(host, None)


def test_what_only_this_machine_reaches() -> None:
    assert all(map(is_loopback, ("127.0.0.1", "localhost", "::1", "127.8.8.8")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.1.4", "boat.local", "")))


def test_a_request_with_two_origins_or_a_strange_token_is_refused(own: ViewAddress) -> None:
    page = f"http://127.0.0.1:{own.port}"
    host = f"Host: 127.0.0.1:{own.port}\r\n"
    for sent in (
        f"GET /{own.token}/ HTTP/1.1\r\n{host}Origin: {page}\r\nOrigin: https://evil.example\r\n\r\n",
        f"GET /{own.token}/ HTTP/1.1\r\n{host}Host: evil.example\r\n\r\n",
        f"GET /\xe9\xff/ HTTP/1.1\r\n{host}\r\n",
    ):
        with socket.create_connection(("127.0.0.1", own.port), PATIENCE_S) as client:
            client.sendall(sent.encode("latin-1"))
            assert client.recv(1 << 12).startswith(b"HTTP/1.1 403")


def test_the_page_keeps_its_address_from_other_sites(own: ViewAddress) -> None:
    client = http.client.HTTPConnection("127.0.0.1", own.port, timeout=PATIENCE_S)
    client.request("GET", f"/{own.token}/")
    assert client.getresponse().headers["Referrer-Policy"] == "no-referrer"
    client.close()


def test_silent_connections_are_closed_when_they_are_too_many(own: ViewAddress) -> None:
    idle = [socket.create_connection(("127.0.0.1", own.port), PATIENCE_S) for _ in range(200)]
    assert get(own, f"/{own.token}/")[0] == 200
    for end in idle[: 200 - view_server.CLIENTS_KEPT]:
        end.settimeout(PATIENCE_S)
        try:
            assert not end.recv(1)
        except ConnectionResetError:
            continue
    for end in idle:
        end.close()
