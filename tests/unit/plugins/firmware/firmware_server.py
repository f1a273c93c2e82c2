"""A web server on this machine that is laid out as ArduPilot's firmware server, with failures on demand."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class FirmwareServer:
    """What it serves, and how.

    files: by path. moved: redirections by path. cuts: after so many bytes of a file's body the connection is closed,
    one entry for each answer until none is left. pretend_length: a Content-Length beside the truth. asked: the paths
    requested so far.
    """

    files: dict[str, bytes] = field(default_factory=dict)
    moved: dict[str, str] = field(default_factory=dict)
    cuts: list[int] = field(default_factory=list)
    pretend_length: int | str | None = None
    asked: list[str] = field(default_factory=list)
    url: str = ""

    def listing(self, folder: str) -> bytes | None:
        """The page of a folder: links by absolute path, in a table, between others."""
        names = sorted({path[len(folder) :].split("/")[0] for path in self.files if path.startswith(folder)})
        if not names:
            return None
        rows = "".join(
            f'<tr><td><img src="/i.gif"></td><td><a href="{folder}{name}">{name}</A></td></tr>\n' for name in names
        )
        return f'<html><a href="/">Home</a><a href="https://elsewhere.invalid/x">x</a><table>{rows}</table></html>'.encode()


@contextmanager
def served(server: FirmwareServer) -> Iterator[FirmwareServer]:
    """The server, listening; `url` says where."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            server.asked.append(self.path)
            if self.path in server.moved:
                self._answer(302, b"", {"Location": server.moved[self.path]})
                return
            body = server.files.get(self.path)
            if body is None and self.path.endswith("/"):
                body = server.listing(self.path)
            if body is None:
                self._answer(404, b"not here", {})
                return
            self._answer(200, body, {}, cuttable=len(body) > 200)

        def _answer(self, status: int, body: bytes, headers: dict[str, str], cuttable: bool = False) -> None:
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            length = len(body) if server.pretend_length is None or not cuttable else server.pretend_length
            self.send_header("Content-Length", str(length))
            self.send_header("Connection", "close")
            self.end_headers()
            self.close_connection = True
            self.wfile.write(body[: server.cuts.pop(0)] if cuttable and server.cuts else body)

        def log_message(self, format: str, *arguments: object) -> None:
            pass

    listening = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.url = f"http://127.0.0.1:{listening.server_address[1]}"
    thread = threading.Thread(target=listening.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield server
    finally:
        listening.shutdown()
        thread.join()
        listening.server_close()
