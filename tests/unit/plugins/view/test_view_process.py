"""The view process of a run, in a thread."""

from __future__ import annotations

import gc
import socket
import threading
from typing import Any
from weakref import WeakSet

import pytest

from tests.bench.soak_clients import VIEWER_CAMERA
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.pipe import Pipe
from xitl_cli.plugins.view import process
from xitl_cli.plugins.view.messages import ViewEnd, ViewStart
from xitl_cli.plugins.view.server import listen, make_server
from xitl_cli.profile import load_profile

viser = pytest.importorskip("viser")
msgspec = pytest.importorskip("msgspec")
connect = pytest.importorskip("websockets.sync.client").connect


@pytest.mark.medium
def test_the_objects_of_browsers_that_left_are_freed(monkeypatch: pytest.MonkeyPatch) -> None:
    joined: list[int] = []
    alive: WeakSet[Any] = WeakSet()

    def watched_server(*arguments: Any) -> Any:
        server = made[0] = make_server(*arguments)
        server.on_client_connect(lambda client: (joined.append(client.client_id), alive.add(client)))
        return server

    made: dict[int, Any] = {}
    monkeypatch.setattr(process, "make_server", watched_server)
    monkeypatch.setattr(process, "COLLECT_S", 0.1)
    listener, address = listen("127.0.0.1", None)
    ours, theirs = socket.socketpair()
    run = Pipe.of_run(ours)
    start = ViewStart("sitl", address, False, (), (load_profile("sitl").runnable(),))
    view = threading.Thread(target=process.ViewProcess(listener, Pipe.of_process(theirs), start).run, args=([],))
    gc.disable()  # Python frees some of them by itself, at any time
    try:
        view.start()
        for number in range(1, 4):
            path = address.url.replace("http", "ws", 1)
            with connect(path, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, proxy=None) as browser:
                browser.send(msgspec.msgpack.encode(VIEWER_CAMERA))
                assert browser.recv(timeout=PATIENCE_S)
                wait_until(lambda number=number: len(joined) == number)
        wait_until(lambda: not alive, "objects of a browser stay")
    finally:
        gc.enable()
        run.send(ViewEnd("over"))
        view.join()
        made[0].stop()
        run.close()
        theirs.close()
        listener.close()
