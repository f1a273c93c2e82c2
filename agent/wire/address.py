"""Host and port of a URL, and what the operating system says about them in words."""

from __future__ import annotations

import errno
import socket
from typing import Any
from urllib.parse import SplitResult

from agent.wire.interface import address_of, interface_of
from agent.wire.transport import (
    AddressDeniedError,
    AddressInUseError,
    AddressUnavailableError,
    BadUrlError,
    TransportError,
    UnknownHostError,
)

Address = tuple[Any, ...]  # what the socket module gives for IPv4 and IPv6


def resolve(url: SplitResult, listen: bool, kind: socket.SocketKind) -> tuple[Any, ...]:
    """The first entry of getaddrinfo for a URL.

    To listen, the host may be the name of an interface. Raises BadUrlError, UnknownHostError and, when that interface
    has no address, AddressUnavailableError.
    """
    host, port = host_port(url, listen)
    interface = interface_of(url) if listen else None
    if interface is not None:
        host = address_of(interface, url.geturl())
    try:
        return socket.getaddrinfo(host, port, type=kind)[0]
    except (socket.gaierror, UnicodeError):
        raise UnknownHostError(
            url.geturl(), f"the host name {host} is not known", "check its spelling or write its IP address"
        ) from None


def host_port(url: SplitResult, listen: bool) -> tuple[str, int]:
    """Host and port; a URL has nothing else. Raises BadUrlError."""
    where = url.geturl()
    example = f"write it like {url.scheme}://192.168.7.2:{5760 if url.scheme == 'tcp' else 14660}"
    try:
        port = url.port
    except ValueError:
        raise BadUrlError(where, "the port is not a number from 0 to 65535", example) from None
    if not url.hostname:
        raise BadUrlError(where, "the host is missing", example)
    if port is None:
        raise BadUrlError(where, "the port is missing", example)
    if port == 0 and not listen:
        raise BadUrlError(where, "port 0 cannot be reached", "give the port the other end listens on")
    for part, text in (
        ("path", url.path.strip("/")),
        ("query", url.query),
        ("fragment", url.fragment),
        ("user", url.username),
    ):
        if text:
            raise BadUrlError(where, f"{url.scheme}:// takes no {part} ({text})", example)
    return url.hostname, port


def explained(error: OSError, url: SplitResult, listen: bool) -> TransportError:
    """The error of an open or bind as one of the TransportErrors."""
    where = url.geturl()
    if error.errno == errno.EADDRINUSE:
        return AddressInUseError(where, "the port is in use by another program", "stop it or choose another port")
    if error.errno == errno.EADDRNOTAVAIL and listen:
        return AddressUnavailableError(
            where,
            f"no interface of this machine has the address {url.hostname}",
            "bring the interface up or listen on another address",
        )
    if error.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EADDRNOTAVAIL):
        return AddressUnavailableError(
            where, f"this machine has no route to {url.hostname}", "check the cable, the interface and its address"
        )
    if error.errno in (errno.EACCES, errno.EPERM):
        return AddressDeniedError(
            where, "this user may not open it", "choose a port above 1023 and an address that is not a broadcast"
        )
    return TransportError(where, f"cannot be opened ({error.strerror})", "check the address and the port")


def address_url(scheme: str, address: Address) -> str:
    """A socket's address as a URL."""
    host, port = address[0], address[1]
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"
