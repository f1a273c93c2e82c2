"""Access rules of the HTTP servers of a run: listening sockets, request heads, and pages of other sites."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Callable
from ipaddress import ip_address
from urllib.parse import urlsplit

from sim_core.dataclass import dataclass

HEAD_BYTES = 16_384
"""Longest head of a request."""
HEAD_S = 10.0
"""Longest time for a head to arrive."""
_REQUEST = re.compile(r"GET /[!-~]* HTTP/1\.1")
_HEADER = re.compile(r"[!#$%&'*+.^_`|~0-9A-Za-z-]+:[^\r\n\0]*")
"""RFC 9112, 5: no spaces in the name and no continued lines, because another server could parse them differently."""


class BadRequestError(ValueError):
    """The bytes are no valid HTTP/1.1 request. The message is the reason."""


@dataclass(frozen=True, slots=True)
class HttpRequest:
    """Head of a GET request."""

    target: str
    """Path and query, as sent."""
    headers: dict[str, str]
    """By name in small letters."""

    @property
    def path(self) -> str:
        """Path without the query."""
        return self.target.partition("?")[0]


def parse_request(head: bytes) -> HttpRequest:
    """Parse an HTTP head without its empty line. Raises BadRequestError."""
    first, *lines = head.decode("latin-1").split("\r\n")
    if not _REQUEST.fullmatch(first) or not all(map(_HEADER.fullmatch, lines)):
        raise BadRequestError("it is not a valid HTTP/1.1 request")
    headers: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition(":")
        if name.lower() in headers and name.lower() in ("host", "origin"):
            raise BadRequestError(f"it has two headers {name}")
        headers[name.lower()] = value.strip()
    return HttpRequest(first.split(" ")[1], headers)


def is_loopback(host: str) -> bool:
    """Return whether only this machine can connect to the host."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def stranger(
    listening: str, host: str, origin: str | None, trusted: Callable[[str], bool] = lambda origin: False
) -> str:
    """Return the reason to refuse a request from a page of another site, empty if it is allowed.

    listening: address at which the server listens. host, origin: headers of the request; origin is None if absent.
    trusted: returns whether pages of an origin may connect.
    """
    try:
        name = urlsplit(f"//{host}").hostname or ""
        page = None if origin is None else urlsplit(origin).netloc
    except ValueError:  # such as of `[`
        return "its Host or Origin is not an address"
    if is_loopback(listening) and not (name == listening or is_loopback(name)):
        return f"this address is only for this machine, and {name!r} is not its name"
    if origin is not None and page != host and not trusted(origin):
        return "a page of another site may not connect here"
    return ""


def listening_socket(host: str, port: int, backlog: int) -> socket.socket:
    """Return a TCP socket that listens at an address of this machine. Raises OSError."""
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, kind, protocol)
    try:
        if os.name == "posix":  # elsewhere it would let two programs have the port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(backlog)
    except OSError:
        listener.close()
        raise
    return listener
