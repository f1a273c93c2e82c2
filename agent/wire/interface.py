"""Network interfaces by name: the address to listen at when a URL names one."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from pathlib import Path
from urllib.parse import SplitResult

from agent.wire.transport import AddressUnavailableError

_SIOCGIFADDR = 0x8915  # linux/sockios.h
_SO_BINDTODEVICE = 25  # asm-generic/socket.h
_IF_INET6 = Path("/proc/net/if_inet6")


def interface_of(url: SplitResult) -> str | None:
    """The interface that stands in place of the host, None when the host is none of this machine's interfaces."""
    host = url.hostname
    names = [name for _, name in socket.if_nameindex()] if host else []
    return next((name for name in names if name.lower() == host), None)  # a split URL's host is lower case


def address_of(interface: str, where: str) -> str:
    """An address of an interface, IPv4 if it has one. Raises AddressUnavailableError when it has none."""
    address = _ipv4(interface) or _ipv6(interface)
    if address is None:
        raise AddressUnavailableError(
            where,
            f"the interface {interface} has no address",
            f"bring it up (ip link set {interface} up) and give it one (ip address add 192.168.7.2/24 dev {interface})",
        )
    return address


def keep_to(sock: socket.socket, interface: str) -> None:
    """Take nothing that comes in elsewhere, where the system permits to ask for that."""
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
