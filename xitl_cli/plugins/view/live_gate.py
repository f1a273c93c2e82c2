"""The gate in front of foxglove-sdk's server, because that server accepts connections from any web page.

The gate listens at the published port. It reads the head of each request, checks Host, Origin and token, and forwards
the connection to the server. The server listens at a random address of 127.0.0.0/8 and a random port. Therefore, a page
of another site cannot find it. A program on this machine can find it in the kernel's table of sockets.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import secrets
import socket
import threading
from urllib.parse import parse_qs, urlsplit

from xitl_cli.http_access import HEAD_BYTES, HEAD_S, BadRequestError, is_loopback, parse_request, stranger
from xitl_cli.plugins.view.server import ViewAddress

MOST_WAITING = 64
"""Maximum number of connections without a complete request. Above it, the gate closes the oldest of them.

Each connection uses a file descriptor of the run.
"""
CHUNK_BYTES = 1 << 16
_TRUSTED = "foxglove.dev"


def hidden_host() -> str:
    """Return a random address in 127.0.0.0/8, or 127.0.0.1 if the system allows no other."""
    drawn = f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(256)}.{secrets.randbelow(254) + 1}"
    with socket.socket() as probe:
        try:
            probe.bind((drawn, 0))
        except OSError:
            return "127.0.0.1"
    return drawn


def is_foxglove(origin: str) -> bool:
    """Return whether a page is the Foxglove application: its web site, desktop program, or served on this machine."""
    parts = urlsplit(origin)
    name = parts.hostname or ""
    site = parts.scheme == "https" and (name == _TRUSTED or name.endswith(f".{_TRUSTED}"))
    return site or origin == "file://" or is_loopback(name)


def refusal(address: ViewAddress, head: bytes) -> str:
    """Return the reason to refuse a request, empty if it is allowed. head: HTTP head without the empty line."""
    try:
        request = parse_request(head)
    except BadRequestError as error:
        return str(error)
    headers = request.headers
    if reason := stranger(address.host, headers.get("host", ""), headers.get("origin"), is_foxglove):
        return reason
    token = parse_qs(request.target.partition("?")[2]).get("token", [""])[0]
    if not hmac.compare_digest(token.encode(), address.token.encode()):
        return "the token of the printed address is missing or wrong"
    return ""


class Gate:
    """Serves `listener` in a thread and forwards connections with the token of `address`.

    inner: host and port of the server behind.
    """

    def __init__(self, listener: socket.socket, address: ViewAddress, inner: tuple[str, int]) -> None:
        self.refused = 0
        """Connections that were closed with 403 or sent no valid request."""
        self._address = address
        self._inner = inner
        self._listener = listener
        self._waiting: dict[asyncio.StreamWriter, None] = {}  # oldest first
        self._up = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="foxglove gate", daemon=True)
        self._thread.start()
        self._up.wait()

    def close(self) -> None:
        """Close all connections and stop."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()

    async def _serve(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        self._up.set()
        server = await asyncio.start_server(self._connected, sock=self._listener, limit=HEAD_BYTES)
        await self._stop.wait()
        server.close()  # asyncio.run cancels the connections

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with contextlib.suppress(OSError):
                await self._pass(reader, writer)
        finally:
            writer.close()

    async def _head(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
        """Read the head of a request, including its empty line."""
        if len(self._waiting) >= MOST_WAITING:
            oldest = next(iter(self._waiting))
            del self._waiting[oldest]
            oldest.transport.abort()
        self._waiting[writer] = None
        try:
            async with asyncio.timeout(HEAD_S):
                return await reader.readuntil(b"\r\n\r\n")
        finally:
            self._waiting.pop(writer, None)

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = await self._head(reader, writer)
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            self.refused += 1
            return
        if reason := refusal(self._address, head[:-4]):
            self.refused += 1
            body = f"{reason}\n".encode()
            kind = f"Content-Type: text/plain; charset=utf-8\r\nContent-Length: {len(body)}\r\nConnection: close"
            writer.write(f"HTTP/1.1 403 Forbidden\r\n{kind}\r\n\r\n".encode() + body)
            await writer.drain()
            return
        served, serving = await asyncio.open_connection(*self._inner)
        try:
            serving.write(b"GET / HTTP/1.1\r\n" + head.partition(b"\r\n")[2])
            both = [asyncio.ensure_future(_pump(*ends)) for ends in ((reader, serving), (served, writer))]
            try:
                await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for direction in both:
                    direction.cancel()
                await asyncio.gather(*both, return_exceptions=True)
        finally:
            serving.close()


async def _pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    """Forward bytes until one side ends. A slow sink slows down the source."""
    while chunk := await source.read(CHUNK_BYTES):
        sink.write(chunk)
        await sink.drain()
