"""Lines that are made when a run starts: `serial://pty?baud=…` and `can://slcan/pty?bitrate=…`."""

from __future__ import annotations

from typing import Protocol
from urllib.parse import urlsplit

from agent.wire.can_bus import can_settings
from agent.wire.serial_line import device_and_baud
from agent.wire.transport import BadUrlError
from xitl_cli.errors import UserError
from xitl_cli.run.links.can_loopback import CanLoopback
from xitl_cli.run.links.serial_loopback import SerialLoopback


class Loopback(Protocol):
    """A line within this machine. Each end is opened by its URL."""

    host_url: str
    agent_url: str

    def close(self) -> None:
        """Take the line away. A second call does nothing."""


def loopback_of(link: str) -> Loopback | None:
    """The line that a link asks to be made, None for a link that is there or elsewhere. Raises UserError."""
    url = urlsplit(link)
    try:
        if url.scheme == "serial" and url.netloc == "pty":
            return SerialLoopback(device_and_baud(url._replace(netloc="", path="/pty"))[1])
        if url.scheme == "can" and url.netloc == "slcan" and url.path == "/pty":
            return CanLoopback(can_settings(url, listen=False).line)
    except BadUrlError as error:
        raise UserError(f"autopilot.link: {error}") from error
    return None
