"""A web server on this machine that is laid out as ArduPilot's firmware server, with ranges, and with bad days."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

DATE = "Tue, 04 Nov 2025 08:00:00 GMT"


@dataclass
class FirmwareServer:
    """What it serves, and how.

    files: by path. moved: redirections by path. cuts: after so many bytes of a file's body the connection is closed,
    one entry for each answer until none is left. pretend_length: a Content-Length beside the truth. pretend_start: a
    range is said to start so many bytes later than asked. ranges, etags: what it can do. asked: the requests so far, as
    (path, Range, status).
    """

    files: dict[str, bytes] = field(default_factory=dict)
    moved: dict[str, str] = field(default_factory=dict)
    cuts: list[int] = field(default_factory=list)
    pretend_length: int | str | None = None
    pretend_start: int = 0
    ranges: bool = True
    etags: bool = True
    dates: bool = False
    asked: list[tuple[str, str, int]] = field(default_factory=list)
    url: str = ""

    def bodies(self, path: str) -> list[tuple[str, int]]:
        """Range and status of the answers to requests for one path."""
        return [(asked_range, status) for asked, asked_range, status in self.asked if asked == path]

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
            asked_range = self.headers.get("Range", "")
            if self.path in server.moved:
                self._answer(302, b"", {"Location": server.moved[self.path]}, asked_range)
                return
            body = server.files.get(self.path)
            if body is None and self.path.endswith("/"):
                body = server.listing(self.path)
            if body is None:
                self._answer(404, b"not here", {}, asked_range)
                return
            etag = f'"{hashlib.md5(body).hexdigest()}"'
            headers = {"ETag": etag} if server.etags else {"Last-Modified": DATE} if server.dates else {}
            if server.dates and not server.etags and self.headers.get("If-Modified-Since") == DATE:
                self._answer(304, b"", headers, asked_range)
                return
            if server.etags and self.headers.get("If-None-Match") == etag:
                self._answer(304, b"", headers, asked_range)
                return
            start = 0
            if asked_range and server.ranges and self.headers.get("If-Range", etag) == etag:
                start = int(asked_range.removeprefix("bytes=").removesuffix("-"))
                if start >= len(body):
                    self._answer(416, b"", {"Content-Range": f"bytes */{len(body)}"}, asked_range)
                    return
                headers["Content-Range"] = f"bytes {start + server.pretend_start}-{len(body) - 1}/{len(body)}"
            self._answer(206 if start else 200, body[start:], headers, asked_range, cuttable=len(body) > 200)

        def _answer(
            self, status: int, body: bytes, headers: dict[str, str], asked_range: str, cuttable: bool = False
        ) -> None:
            server.asked.append((self.path, asked_range, status))
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
