"""What a CAN URL says: can://INTERFACE/CHANNEL?bitrate=…&fd=true&data_bitrate=…&node=2&peer=1&…

Keys other than these go to python-can as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import SplitResult, unquote

from agent.wire.can_line import CanLine
from agent.wire.can_transfer import NODES
from agent.wire.query import Value, query, switch, text_of, whole
from agent.wire.transport import BadUrlError

CALLER, LISTENER = 1, 2  # the nodes' numbers when the URL gives none
EXAMPLE = "write it like can://socketcan/can0?bitrate=1000000"


@dataclass(frozen=True)
class CanSettings:
    """interface and channel are python-can's; extra: its other arguments."""

    interface: str
    channel: str | int
    line: CanLine
    node: int
    peer: int
    extra: Mapping[str, Value]

    def url(self, node: int) -> str:
        """A node of this bus, for people."""
        return f"can://{self.interface}/{str(self.channel).lstrip('/')}?node={node}"


def can_settings(url: SplitResult, listen: bool) -> CanSettings:
    """The settings in a URL. Raises BadUrlError."""
    where = text_of(url)
    channel = unquote(url.path).lstrip("/")
    if not url.netloc or "@" in url.netloc or ":" in url.netloc:
        raise BadUrlError(where, "the interface is missing", EXAMPLE)
    if not channel:
        raise BadUrlError(where, "the channel is missing", EXAMPLE)
    if url.fragment:
        raise BadUrlError(where, f"can:// takes no fragment ({url.fragment})", EXAMPLE)
    keys = query(url, EXAMPLE)
    fd = switch(url, "fd", keys.pop("fd", False))
    bitrate = whole(url, "bitrate", keys.pop("bitrate", None), 5_000, 1_000_000, EXAMPLE)
    data_bitrate = whole(url, "data_bitrate", keys.pop("data_bitrate", bitrate), bitrate, 20_000_000, EXAMPLE)
    if not fd and data_bitrate != bitrate:
        raise BadUrlError(where, "data_bitrate is for CAN FD alone", "add fd=true or drop it")
    default = (LISTENER, CALLER) if listen else (CALLER, LISTENER)
    node = whole(url, "node", keys.pop("node", default[0]), 0, NODES - 1, EXAMPLE)
    peer = whole(url, "peer", keys.pop("peer", default[1]), 0, NODES - 1, EXAMPLE)
    if node == peer:
        raise BadUrlError(where, f"node and peer are both {node}", "give each end a number of its own")
    if url.netloc == "udp_multicast":
        keys.setdefault("hop_limit", 0)
    return CanSettings(
        interface=url.netloc,
        channel=_channel(url.netloc, channel),
        line=CanLine(bitrate, fd, data_bitrate if fd else 0),
        node=node,
        peer=peer,
        extra=keys,
    )


def _channel(interface: str, channel: str) -> str | int:
    if "/" in channel:  # a device
        return f"/{channel}"
    return int(channel) if channel.isascii() and channel.isdigit() and interface != "virtual" else channel
