"""Transports of a link's bytes: one interface, one table of schemes, one tree of errors.

    (no URL)              two ends in one process, see `memory_pair`               agent.wire.memory
    (no URL)              two processes of one machine, see `socket_pair`          agent.wire.socket_pair
    udp://host:port       datagrams over Ethernet, USB-Ethernet or loopback        agent.wire.udp
    tcp://host:port       a stream of bytes; a listener serves one peer at a time  agent.wire.tcp
    serial:///dev/…       a stream of bytes over a serial line                     agent.wire.serial_line
    can://bus/channel     a CAN bus, classic or FD, by python-can                  agent.wire.can_bus

A new transport is a class, a row in `SCHEMES`, and a row in the contract test.

    TransportError
    ├── BadUrlError               the URL names no transport that can be opened
    ├── UnknownHostError          the host name has no address
    ├── AddressInUseError         another program holds the port
    ├── AddressUnavailableError   this machine has no such address, or no route to it
    ├── AddressDeniedError        this user may not open it
    ├── DatagramTooLongError      more bytes than one datagram carries
    └── TransportClosedError      used after close()
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum
from importlib import import_module
from math import inf
from time import monotonic
from types import TracebackType
from typing import Callable, TypeVar, cast
from urllib.parse import SplitResult, urlsplit


class LineOccupancy:
    """Occupancy of a line that carries one item after the other, each for a known time."""

    def __init__(self, clock_s: Callable[[], float] = monotonic) -> None:
        self._clock_s = clock_s
        self._free_at_s = 0.0

    def add(self, busy_s: float) -> None:
        """Add an item that occupies the line for `busy_s`."""
        self._free_at_s = max(self._free_at_s, self._clock_s()) + busy_s

    def backlog_s(self) -> float:
        """Seconds until the line is free, 0 when it is."""
        return max(self._free_at_s - self._clock_s(), 0.0)


SCHEMES: dict[str, str] = {
    "udp": "agent.wire.udp:UdpTransport",
    "tcp": "agent.wire.tcp:TcpTransport",
    "serial": "agent.wire.serial_line:SerialTransport",
    "can": "agent.wire.can_bus:CanTransport",
}

DATAGRAM_BYTES = 1400  # below Ethernet's 1500, with room for IPv6 and a tunnel

ASKED_S = 1.0  # time of service after the last frame of an end that only asked
RUN_SILENCE_S = 5.0  # the same for an end that has started a run

Self = TypeVar("Self", bound="Transport")


class SenderStatus(Enum):
    """Status of the sender of a chunk with a good frame."""

    HEARD = 0  # uses the dialect
    STARTS = 1  # requests exclusive service from now on
    LEAVES = 2  # ends the service


class ServedPeer:
    """The served peer at an address that is open to anybody: one peer, until it leaves or is silent for too long.

    A peer that has started a run is served until RUN_SILENCE_S after its last good frame, and is `bound` meanwhile. A
    peer that only asked is served for `asked_s`, and gives way to a peer that starts a run.
    """

    def __init__(self, asked_s: float = ASKED_S) -> None:
        self._asked_s = asked_s
        self._patience_s = 0.0
        self._heard_s = -inf

    def called(self, now_s: float) -> None:
        """Note a new peer that has sent nothing yet."""
        self._heard_s, self._patience_s = now_s, self._asked_s

    def heard(self, standing: SenderStatus, now_s: float) -> None:
        """Note a good frame of the peer."""
        self._heard_s = now_s
        if standing is SenderStatus.STARTS:
            self._patience_s = RUN_SILENCE_S
        elif standing is SenderStatus.LEAVES:
            self._heard_s = -inf
        elif self._patience_s != RUN_SILENCE_S:
            self._patience_s = self._asked_s

    def bound(self, now_s: float) -> bool:
        """Whether the peer has an active run, so that no other is served."""
        return self._patience_s == RUN_SILENCE_S and not self._is_over(now_s)

    def gives_way(self, standing: SenderStatus, now_s: float) -> bool:
        """Whether another sender of a good frame replaces the peer."""
        return self._is_over(now_s) or (standing is SenderStatus.STARTS and not self.bound(now_s))

    def _is_over(self, now_s: float) -> bool:
        return now_s - self._heard_s > self._patience_s


class TransportError(Exception):
    """A transport cannot do what was requested. The text is one sentence: where, what, how to fix it."""

    def __init__(self, where: str, what: str, fix: str) -> None:
        super().__init__(f"{where}: {what}; {fix}")
        self.where = where
        self.what = what
        self.fix = fix


class BadUrlError(TransportError, ValueError):
    """The URL names no transport that can be opened."""


class UnknownHostError(TransportError):
    """The host name has no address."""


class AddressInUseError(TransportError):
    """Another program holds the port."""


class AddressUnavailableError(TransportError):
    """This machine has no such address, or no route to it."""


class AddressDeniedError(TransportError):
    """This user may not open the address."""


class DatagramTooLongError(TransportError):
    """More bytes than one datagram carries."""


class TransportClosedError(TransportError):
    """Used after close()."""

    def __init__(self, where: str) -> None:
        super().__init__(where, "the transport is closed", "open it again")


class Transport(ABC):
    """Carries chunks of bytes in both directions between this end and one peer.

    One end is not safe for several threads.

    address: URL of this end, for people.
    unsent: number of failed sends.
    """

    name: str = ""
    """Kind of transport, for instance "udp"."""
    stream: bool = False
    """False when each `send` arrives as one chunk or not at all; True when chunks may be split and joined."""
    learns_peer: bool = False
    """True when received chunks define the peer, by `accept_sender`."""
    serves_one: bool = False
    """True when others wait for the peer to leave, by `accept_sender`."""
    datagram_bytes: int = DATAGRAM_BYTES
    """Preferred limit of one `send`; a single frame may be longer."""
    capacity_bps: float | None = None
    """Payload capacity of the line in bytes per second, None when the line is not the limit."""
    strangers: int = 0
    """Datagrams and calls refused unread because their sender is not the peer."""
    stranger: str = ""
    """Sender of the latest."""
    lossless: bool = False
    """True when all sent chunks arrive while the connection lasts."""
    losses: int = 0
    """Number of lost connections."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.unsent = 0

    @classmethod
    def open(cls: type[Self], url: SplitResult, listen: bool) -> Self:
        """Open from a split URL. Raises a TransportError: always BadUrlError for a transport without a URL."""
        raise BadUrlError(url.geturl(), f"{cls.__name__} has no URL", "use a scheme of SCHEMES")

    @abstractmethod
    def send(self, data: bytes) -> bool:
        """Send bytes without waiting. Return False and count `unsent` without a peer, room or route.

        These cases never raise.
        """

    @abstractmethod
    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        """Return all chunks that have arrived, up to a limit, oldest first. Wait for the first at most timeout_s.

        0 does not wait. After a wait, the first chunk may be returned alone, even if others follow closely.
        """

    @abstractmethod
    def fileno(self) -> int | None:
        """Descriptor that becomes readable with new bytes, None when there is none."""

    @abstractmethod
    def close(self) -> None:
        """Release all resources. A second call does nothing."""

    @property
    def peer(self) -> str:
        """URL of the other end, empty while unknown."""
        return ""

    def accept_sender(self, index: int, standing: SenderStatus) -> bool:
        """Note that chunk `index` of the last `receive` held a good frame from a sender with the status `standing`.

        A transport that is open to anybody learns its peer from this, so that stray bytes never redirect the answers.
        Return False when the sender is not the peer. Its messages are then not for this end.
        """
        return True

    def wait_for_room(self, timeout_s: float) -> bool:
        """Wait for room for `send` at most timeout_s and return whether there is room.

        True if the transport cannot know.
        """
        return True

    def backlog_s(self) -> float:
        """Time in seconds for which sent bytes still occupy the line; 0 if the line is not a limit."""
        return 0.0

    def wake_s(self) -> float | None:
        """Seconds until `receive` should be called even without bytes, None for never."""
        return None

    def counts(self) -> dict[str, int]:
        """Counts of this end by name, in addition to those of a link."""
        return {}

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_transport(url: str, listen: bool) -> Transport:
    """Open the transport of a URL: wait there for the peer (listen) or connect to it.

    Raises BadUrlError and the other TransportErrors. Port 0 selects any free port for listening, and `address` then
    contains it.
    """
    scheme, separator, _ = url.partition("://")
    known = ", ".join(f"{name}://" for name in SCHEMES)
    if not separator:
        raise BadUrlError(
            url or "(empty)", "not a transport URL", f"write it like udp://192.168.7.2:14660 (known: {known})"
        )
    if scheme not in SCHEMES:
        raise BadUrlError(url, f"unknown scheme {scheme}://", f"use one of: {known}")
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise BadUrlError(url, str(error), "write it like udp://192.168.7.2:14660 or udp://[fe80::1]:14660") from None
    module, _, kind = SCHEMES[scheme].partition(":")
    transport = cast(type[Transport], getattr(import_module(module), kind))
    return transport.open(parts, listen)
