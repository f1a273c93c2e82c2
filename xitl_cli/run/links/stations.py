"""Where ground stations meet the autopilot of a run: TCP ports that nobody else holds."""

from __future__ import annotations

import errno
import socket
import sys
from urllib.parse import SplitResult, urlsplit

from agent.wire.transport import TransportError
from agent.wire.urls import resolve
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.profile import ground_stations_of

TRIED = 100  # ports, one after the other
_HIGHEST = 65535


class StationAddresses:
    """The `urls` of a profile, each TCP port this run's alone until `close`. `warnings`: what was replaced.

    A port in use is replaced by the next free one. Runs tell each other which ports they have taken, as an autopilot
    that is started here binds its own only seconds later. Raises UserError when no port is free.
    """

    def __init__(self, profile: RunProfile) -> None:
        self.warnings: list[str] = []
        self._claims: list[socket.socket] = []
        self.urls = tuple(url if urlsplit(url).scheme != "tcp" else self._free(url) for url in _asked_for(profile))

    def _free(self, url: str) -> str:
        parts = urlsplit(url)
        first = parts.port or 0
        for port in range(first, min(first + TRIED, _HIGHEST + 1)):
            free = parts._replace(netloc=parts.netloc.rpartition(":")[0] + f":{port}")
            if is_free(free) and self._claim(port):
                if port != first:
                    self.warnings.append(
                        f"TCP port {first} is in use by another program or run: ground stations connect to "
                        f"{free.geturl()}"
                    )
                return free.geturl()
        self.close()
        raise UserError(
            f"autopilot.ground_stations: {url} and the {TRIED - 1} ports behind it are in use; give another port"
        )

    def _claim(self, port: int) -> bool:
        """Whether no other run has it. The name is gone with the process that has it, however that ends."""
        if sys.platform != "linux":
            return True
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0xitl ground stations at TCP {port}")
        except OSError:
            claim.close()
            return False
        self._claims.append(claim)
        return True

    def close(self) -> None:
        """Others may have the ports. A second call does nothing."""
        for claim in self._claims:
            claim.close()
        self._claims.clear()


def _asked_for(profile: RunProfile) -> tuple[str, ...]:
    """An autopilot that somebody else has started serves its own ground stations."""
    autopilot = profile.autopilot
    elsewhere = autopilot.kind != "embedded" and not autopilot.started_here
    return () if elsewhere else ground_stations_of(profile)


def is_free(url: SplitResult) -> bool:
    """Whether a listener could be opened there; True for what is no address of this machine, which is said later."""
    try:
        family, kind, protocol, _, target = resolve(url, True, socket.SOCK_STREAM)
    except TransportError:
        return True
    with socket.socket(family, kind, protocol) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(target)
            probe.listen(1)
        except OSError as error:
            return error.errno != errno.EADDRINUSE
    return True
