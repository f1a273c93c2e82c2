"""Ports of this machine for a run and for the programs that it starts. Each run and vessel gets different ports."""

from __future__ import annotations

import errno
import socket
import sys
from urllib.parse import SplitResult, urlsplit

from agent.wire.transport import TransportError
from agent.wire.urls import resolve
from xitl_cli.errors import UserError

TRIED = 100  # ports in sequence
_HIGHEST = 65535
_KINDS = {"tcp": socket.SOCK_STREAM, "udp": socket.SOCK_DGRAM}


class PortClaims:
    """Ports that this run has claimed until `close`.

    A program, such as an autopilot, may open its port only seconds later. Runs therefore claim ports by names of
    abstract sockets. These names disappear with their process, however it ends.
    """

    def __init__(self) -> None:
        self._claims: list[socket.socket] = []

    def free(self, scheme: str) -> int:
        """Return a free port of the loopback address. scheme: `tcp` or `udp`. Raises UserError."""
        for _ in range(TRIED):
            with socket.socket(socket.AF_INET, _KINDS[scheme]) as probe:
                try:
                    probe.bind(("127.0.0.1", 0))
                except OSError:
                    break
                port: int = probe.getsockname()[1]
                if self.claim(scheme, port):
                    return port
        raise UserError(f"127.0.0.1: no {scheme.upper()} port is free; end some of the programs that use ports")

    def free_url(self, url: str) -> str:
        """Return the address with a free port in place of port 0."""
        parts = urlsplit(url)
        if parts.scheme not in _KINDS or parts.port != 0:
            return url
        return f"{parts.scheme}://{parts.hostname}:{self.free(parts.scheme)}"

    def nearest(self, url: str) -> str | None:
        """Return the address with the first free port from its own on, or None when about a hundred are in use."""
        parts = urlsplit(url)
        first = parts.port or 1
        for port in range(first, min(first + TRIED, _HIGHEST + 1)):
            candidate = parts._replace(netloc=parts.netloc.rpartition(":")[0] + f":{port}")
            if is_free(candidate) and self.claim(parts.scheme, port):
                return candidate.geturl()
        return None

    def claim(self, scheme: str, port: int) -> bool:
        """Claim the port. Returns False when another run, or vessel of this run, has it."""
        if sys.platform != "linux":
            return True
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0xitl {scheme} {port}")
        except OSError:
            claim.close()
            return False
        self._claims.append(claim)
        return True

    def close(self) -> None:
        """Release the ports. A second call does nothing."""
        for claim in self._claims:
            claim.close()
        self._claims.clear()

    __del__ = close


def is_free(url: SplitResult) -> bool:
    """Whether the address can be opened. True also for an address of another machine, which is reported later."""
    kind = _KINDS[url.scheme]
    try:
        family, kind, protocol, _, target = resolve(url, True, kind)
    except TransportError:
        return True
    with socket.socket(family, kind, protocol) as probe:
        if kind == socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(target)
            if kind == socket.SOCK_STREAM:
                probe.listen(1)
        except OSError as error:
            return error.errno != errno.EADDRINUSE
    return True
