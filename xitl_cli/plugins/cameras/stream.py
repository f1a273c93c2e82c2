"""Server of the newest image of each camera. By HTTP, `/NAME.mjpeg` is a stream and `/NAME.jpg` is one image.

The same port speaks RTSP: `rtsp://ADDRESS:PORT/NAME`, for ground stations.

The server runs in a separate thread and keeps only the newest image. A slow client therefore skips images, and the run
never waits. Programs on the machines that reach the address may read; pages of other sites may not.
"""

from __future__ import annotations

import asyncio
import contextlib
import html
import socket
import threading
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any
from urllib.parse import urlsplit

from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.errors import UserError
from xitl_cli.http_access import (
    HEAD_BYTES,
    HEAD_S,
    BadRequestError,
    HttpRequest,
    listening_socket,
    parse_request,
    stranger,
)
from xitl_cli.plugins.cameras.image_feed import NewestImage, StreamCounts, write_all
from xitl_cli.plugins.cameras.images import CameraImage
from xitl_cli.plugins.cameras.rtsp import RtspSession, is_rtsp

USUAL_PORT = 8600
MOST_CLIENTS = 32
"""Above this number of connections, a new one is refused. Each connection uses a file descriptor of the run."""
SEND_BYTES = 1 << 18
"""Buffer of the system for each client. A larger one would delay the images of a slow client."""
MOST_PICTURES = 5
"""Streams in the index page. A browser opens six connections to a server."""
BOUNDARY = "xitl-image"
_WAIT_S = 5.0
"""Longest time that a request for one image waits for the first one."""


class CameraStream:
    """Serves the images of `cameras`: by the name in the address, such as `front`, or `alpha/front` in a fleet.

    Images before `start` and after `close` are not served.
    """

    def __init__(self, cameras: Mapping[str, CameraSpec], title: str = "xitl") -> None:
        self.counts = StreamCounts()
        self._title = title
        self._newest: dict[str, NewestImage] = {}
        self.add(cameras)
        self._host = ""
        self.connections = 0
        """Open connections."""
        self._listener: socket.socket | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._thread: threading.Thread | None = None

    def add(self, cameras: Mapping[str, CameraSpec]) -> None:
        """Serve further cameras, such as those of another vessel."""
        self._newest |= {name: NewestImage(spec) for name, spec in cameras.items()}

    def start(self, url: str, key: str = "sensors.cameras.serve") -> str:
        """Serve at `http://ADDRESS:PORT`, by default at port 8600, and return the address. Port 0 is any free one.

        key: the name of the address in errors. Raises UserError for an address that is not one of this machine or is in
        use.
        """
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError as error:
            raise UserError(f"{key} = {url!r} is not an address ({error}); write http://127.0.0.1:8600") from error
        if parts.scheme != "http" or not host or parts.path.strip("/") or parts.query:
            raise UserError(f"{key} = {url!r} is not an address of a server; write http://127.0.0.1:8600")
        try:
            listener = listening_socket(host, USUAL_PORT if port is None else port, MOST_CLIENTS)
        except OSError as error:
            reason = error.strerror or str(error)
            raise UserError(
                f"{key} = {url}: cannot listen there ({reason}); use a free port and an address of this machine"
            ) from error
        self._host, self._listener = host, listener
        up = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(up)), name="cameras", daemon=True)
        self._thread.start()
        up.wait()
        named = f"[{host}]" if ":" in host else host
        return f"http://{named}:{listener.getsockname()[1]}"

    def show(self, image: CameraImage, name: str = "") -> None:
        """Serve an image from now on. It never waits for clients. name: name in the address, by default the camera."""
        newest, loop = self._newest[name or image.camera], self._loop
        if loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has just ended
                loop.call_soon_threadsafe(newest.put, image)

    def close(self) -> None:
        """Close all connections and stop. A second call does nothing."""
        loop, self._loop = self._loop, None
        if loop is not None and self._stop is not None:
            loop.call_soon_threadsafe(self._stop.set)
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def report(self) -> dict[str, Any]:
        """Return the counts as plain data."""
        return asdict(self.counts)

    async def _serve(self, up: threading.Event) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        server = await asyncio.start_server(self._connected, sock=self._listener, limit=HEAD_BYTES)
        up.set()
        await self._stop.wait()
        server.close()  # asyncio.run cancels the connections

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        try:
            if self.connections > MOST_CLIENTS:
                self.counts.refused += 1
                return
            writer.transport.set_write_buffer_limits(high=0)  # `drain` waits until the system has all bytes
            connection = writer.get_extra_info("socket")
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
            await self._answer(reader, writer)
        except TimeoutError:
            self.counts.stuck += 1
            writer.transport.abort()
        except (OSError, asyncio.CancelledError):  # the client has gone, or the server stops
            return
        finally:
            self.connections -= 1
            writer.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(HEAD_S):
                head = await reader.readuntil(b"\r\n\r\n")
            if is_rtsp(head):
                self.counts.clients += 1
                await RtspSession(self._host, self._newest, reader, writer, self.counts).serve(head)
                return
            request = parse_request(head[:-4])
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            self.counts.refused += 1
            return
        except BadRequestError as error:
            self.counts.refused += 1
            await _send(writer, "400 Bad Request", "text/plain; charset=utf-8", f"{error}\n".encode())
            return
        if reason := _refusal(self._host, request):
            self.counts.refused += 1
            await _send(writer, "403 Forbidden", "text/plain; charset=utf-8", f"{reason}\n".encode())
            return
        self.counts.clients += 1
        name, _, kind = request.path[1:].rpartition(".")
        newest = self._newest.get(name)
        if request.path == "/":
            await _send(writer, "200 OK", "text/html; charset=utf-8", self._page().encode())
        elif newest is not None and kind == "mjpeg":
            await self._stream(newest, reader, writer)
        elif newest is not None and kind == "jpg":
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_WAIT_S):
                    while newest.image is None:
                        await newest.following()
            if newest.image is None:
                await _send(writer, "503 Service Unavailable", "text/plain; charset=utf-8", b"there is no image yet\n")
                return
            await _send(writer, "200 OK", "image/jpeg", newest.encode()[2])
            self.counts.images_sent += 1
        else:
            known = ", ".join(f"/{name}.mjpeg, /{name}.jpg" for name in self._newest)
            body = f"there is no {request.path}; use /, {known}\n"
            await _send(writer, "404 Not Found", "text/plain; charset=utf-8", body.encode())

    async def _stream(self, newest: NewestImage, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        kind = f"multipart/x-mixed-replace; boundary={BOUNDARY}"
        # A browser shows an image when its closing boundary has arrived, so the boundary follows it immediately.
        writer.write(f"{_head('200 OK', kind)}\r\n--{BOUNDARY}\r\n".encode())
        gone = asyncio.ensure_future(reader.read(1))
        sent = 0
        try:
            while not gone.done():
                if newest.shown == sent:
                    await asyncio.wait((gone, newest.following()), return_when=asyncio.FIRST_COMPLETED)
                    continue
                number, image, encoded = newest.encode()
                part = (
                    f"Content-Type: image/jpeg\r\nContent-Length: {len(encoded)}\r\n"
                    f"X-Timestamp: {image.stamp_ns // 1_000_000_000}.{image.stamp_ns % 1_000_000_000:09d}\r\n\r\n"
                )
                await write_all(writer, part.encode() + encoded + f"\r\n--{BOUNDARY}\r\n".encode())
                self.counts.images_sent += 1
                self.counts.images_skipped += number - sent - 1 if sent else 0
                sent = number
        finally:
            gone.cancel()

    def _page(self) -> str:
        figures = []
        for count, (name, newest) in enumerate(sorted(self._newest.items())):
            spec, path = newest.spec, html.escape(f"/{name}")
            source = f"{path}.mjpeg" if count < MOST_PICTURES else f"{path}.jpg"
            caption = f"{html.escape(name)}: {spec.kind}, {spec.width_px} × {spec.height_px}, {spec.rate_hz:g} Hz"
            figures.append(
                f'<figure><img src="{source}" width="{spec.width_px}" height="{spec.height_px}" alt="{caption}">'
                f'<figcaption>{caption} · <a href="{path}.mjpeg">stream</a> · <a href="{path}.jpg">image</a>'
                "</figcaption></figure>"
            )
        return _PAGE.format(title=html.escape(self._title), figures="\n".join(figures))


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Cameras of {title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; margin: 24px; color: #1c2430; background: #f4f6f8; }}
h1 {{ font-size: 22px; }}
main {{ display: flex; flex-wrap: wrap; gap: 24px; }}
figure {{ margin: 0; }}
img {{ display: block; max-width: 100%; height: auto; background: #cfd6dd; }}
</style></head>
<body><h1>Cameras of {title}</h1><main>
{figures}
</main></body></html>
"""


def _refusal(listening: str, request: HttpRequest) -> str:
    """Return the reason to refuse a request, empty if it is allowed."""
    headers = request.headers
    if reason := stranger(listening, headers.get("host", ""), headers.get("origin")):
        return reason
    # A browser sends no Origin for the images in a page. It does say where the page is.
    elsewhere = headers.get("sec-fetch-site", "none") in ("cross-site", "same-site")
    if elsewhere and headers.get("sec-fetch-dest") != "document":
        return "a page of another site may not show these images"
    return ""


def _head(status: str, kind: str) -> str:
    lines = (
        f"HTTP/1.1 {status}",
        f"Content-Type: {kind}",
        "Cache-Control: no-store",
        "Connection: close",
        "Cross-Origin-Resource-Policy: same-origin",
        "Content-Security-Policy: default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; "
        "frame-ancestors 'none'",
        "X-Content-Type-Options: nosniff",
    )
    return "".join(f"{line}\r\n" for line in lines)


async def _send(writer: asyncio.StreamWriter, status: str, kind: str, body: bytes) -> None:
    await write_all(writer, f"{_head(status, kind)}Content-Length: {len(body)}\r\n\r\n".encode() + body)
