"""Parts of a transport's URL: host and port, the interface to listen at, the keys of the query."""

from __future__ import annotations

import errno
import socket
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any, Union
from urllib.parse import SplitResult, parse_qsl

from agent.wire.transport import (
    AddressDeniedError,
    AddressInUseError,
    AddressUnavailableError,
    BadUrlError,
    TransportError,
    UnknownHostError,
)

Value = Union[int, float, bool, str]


def url_text(url: SplitResult) -> str:
    """Return the URL as it was written. geturl() drops the slashes of unknown schemes."""
    query_text = f"?{url.query}" if url.query else ""
    return f"{url.scheme}://{url.netloc}{url.path}{query_text}" + (f"#{url.fragment}" if url.fragment else "")


def parse_query(url: SplitResult, example: str) -> dict[str, Value]:
    """Return the keys and values of a URL's query. Raises BadUrlError for a repeated key or a missing value."""
    values: dict[str, Value] = {}
    try:
        pairs = parse_qsl(url.query, keep_blank_values=True, strict_parsing=bool(url.query), max_num_fields=64)
    except ValueError:
        raise BadUrlError(url_text(url), f"the query {url.query} is not key=value&key=value", example) from None
    for key, text in pairs:
        if key in values:
            raise BadUrlError(url_text(url), f"{key} is given twice", "remove one")
        values[key] = parse_value(text)
    return values


def parse_value(text: str) -> Value:
    """Convert true, false, integers (also 0x) and other numbers. Return any other text unchanged."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return int(text, 0)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        return text


def whole_number(url: SplitResult, key: str, value: Value | None, lowest: int, highest: int, example: str) -> int:
    """Return an integer of the query. Raises BadUrlError when it is missing, not an integer, or out of range."""
    if value is None:
        raise BadUrlError(url_text(url), f"{key} is missing", example)
    if isinstance(value, bool) or not isinstance(value, int):
        raise BadUrlError(url_text(url), f"{key} = {value} is not a whole number", example)
    if not lowest <= value <= highest:
        raise BadUrlError(url_text(url), f"{key} = {value} is out of range", f"use {lowest} to {highest}")
    return value


def true_or_false(url: SplitResult, key: str, value: Value) -> bool:
    """Return a boolean of the query. Raises BadUrlError for any other value."""
    if not isinstance(value, bool):
        raise BadUrlError(url_text(url), f"{key} = {value} is neither true nor false", f"write {key}=true")
    return value


_SIOCGIFADDR = 0x8915  # linux/sockios.h
_SO_BINDTODEVICE = 25  # asm-generic/socket.h
_IF_INET6 = Path("/proc/net/if_inet6")


def interface_named_by(url: SplitResult) -> str | None:
    """Return the interface named in place of the host, None when the host is not an interface of this machine."""
    host = url.hostname
    names = [name for _, name in socket.if_nameindex()] if host else []
    return next((name for name in names if name.lower() == host), None)  # urlsplit converts the host to lower case


def interface_address(interface: str, where: str) -> str:
    """Return an address of an interface, IPv4 if it has one. Raises AddressUnavailableError when it has none."""
    address = _ipv4(interface) or _ipv6(interface)
    if address is None:
        raise AddressUnavailableError(
            where,
            f"the interface {interface} has no address",
            f"bring it up (ip link set {interface} up) and give it one (ip address add 192.168.7.2/24 dev {interface})",
        )
    return address


def bind_to_interface(sock: socket.socket, interface: str) -> None:
    """Receive only through this interface, if the system permits it."""
    with suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, _SO_BINDTODEVICE, interface.encode() + b"\0")


def _ipv4(interface: str) -> str | None:
    try:
        import fcntl

        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            answer = fcntl.ioctl(sock.fileno(), _SIOCGIFADDR, struct.pack("256s", interface.encode()[:15]))
    except (ImportError, OSError):
        return None
    return socket.inet_ntoa(answer[20:24])


def _ipv6(interface: str) -> str | None:
    try:
        lines = _IF_INET6.read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        digits, _, _, scope, _, name = line.split()
        if name == interface:
            address = socket.inet_ntop(socket.AF_INET6, bytes.fromhex(digits))
            return f"{address}%{interface}" if scope == "20" else address
    return None


Address = tuple[Any, ...]  # address of the socket module for IPv4 and IPv6


def resolve(url: SplitResult, listen: bool, kind: socket.SocketKind) -> tuple[Any, ...]:
    """Return the first entry of getaddrinfo for a URL.

    To listen, the host may be the name of an interface. Raises BadUrlError and UnknownHostError. Raises
    AddressUnavailableError when that interface has no address.
    """
    host, port = host_port(url, listen)
    interface = interface_named_by(url) if listen else None
    if interface is not None:
        host = interface_address(interface, url.geturl())
    try:
        return socket.getaddrinfo(host, port, type=kind)[0]
    except (socket.gaierror, UnicodeError):
        raise UnknownHostError(
            url.geturl(), f"the host name {host} is not known", "check its spelling or write its IP address"
        ) from None


def host_port(url: SplitResult, listen: bool) -> tuple[str, int]:
    """Return host and port of a URL with no other parts. Raises BadUrlError."""
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
        raise BadUrlError(where, "port 0 cannot be reached", "give the port that the other end listens at")
    for part, text in (
        ("path", url.path.strip("/")),
        ("query", url.query),
        ("fragment", url.fragment),
        ("user", url.username),
    ):
        if text:
            raise BadUrlError(where, f"{url.scheme}:// takes no {part} ({text})", example)
    return url.hostname, port


def transport_error(error: OSError, url: SplitResult, listen: bool) -> TransportError:
    """Return the TransportError of a failed open or bind."""
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
    """Return a socket's address as a URL."""
    host, port = address[0], address[1]
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"
