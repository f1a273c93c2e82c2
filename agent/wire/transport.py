"""What carries the bytes of a link: one interface, one table of schemes, one tree of errors.

    (no URL)              two ends in one process, see `memory_pair`               agent.wire.memory
    (no URL)              two processes of one machine, see `socket_pair`          agent.wire.socket_pair
    udp://host:port       datagrams over Ethernet, USB-Ethernet or loopback        agent.wire.udp
    tcp://host:port       a stream of bytes; listening, one peer after the other   agent.wire.tcp
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
    """A line that carries one thing after the other, each for a known time."""

    def __init__(self, clock_s: Callable[[], float] = monotonic) -> None:
        self._clock_s = clock_s
        self._free_at_s = 0.0

    def add(self, busy_s: float) -> None:
        """It was given something that keeps it busy for so long."""
        self._free_at_s = max(self._free_at_s, self._clock_s()) + busy_s

    def backlog_s(self) -> float:
        """Seconds until it is free, 0 when it is."""
        return max(self._free_at_s - self._clock_s(), 0.0)


SCHEMES: dict[str, str] = {
    "udp": "agent.wire.udp:UdpTransport",
    "tcp": "agent.wire.tcp:TcpTransport",
    "serial": "agent.wire.serial_line:SerialTransport",
    "can": "agent.wire.can_bus:CanTransport",
}

DATAGRAM_BYTES = 1400  # below the 1500 of Ethernet with room for IPv6 and a tunnel

ASKED_S = 1.0  # an end that only asked is served for so long after its last word
RUN_SILENCE_S = 5.0  # and one that has started a run for so long

Self = TypeVar("Self", bound="Transport")


class SenderStatus(Enum):
    """What the sender of a chunk with a good frame is to this end."""

    HEARD = 0  # somebody who speaks the dialect
    STARTS = 1  # asks to be served from now on, and nobody else
    LEAVES = 2  # wants nothing more


class ServedPeer:
    """Who is served at an address where anybody may call: one, until it leaves or has been silent for too long.

    One that has started a run is served until RUN_SILENCE_S after its last good frame, and `bound` meanwhile; one that
    only asked, for `asked_s`, and it gives way to one that starts a run.
    """

    def __init__(self, asked_s: float = ASKED_S) -> None:
        self._asked_s = asked_s
        self._patience_s = 0.0
        self._heard_s = -inf

    def called(self, now_s: float) -> None:
        """A new one is there that has said nothing yet."""
        self._heard_s, self._patience_s = now_s, self._asked_s

    def heard(self, standing: SenderStatus, now_s: float) -> None:
        """It has sent a good frame."""
        self._heard_s = now_s
        if standing is SenderStatus.STARTS:
            self._patience_s = RUN_SILENCE_S
        elif standing is SenderStatus.LEAVES:
            self._heard_s = -inf
        elif self._patience_s != RUN_SILENCE_S:
            self._patience_s = self._asked_s

    def bound(self, now_s: float) -> bool:
        """Whether it has a run on: nobody else is heard."""
        return self._patience_s == RUN_SILENCE_S and not self._is_over(now_s)

    def gives_way(self, standing: SenderStatus, now_s: float) -> bool:
        """Whether another one is served from now on that has sent a good frame."""
        return self._is_over(now_s) or (standing is SenderStatus.STARTS and not self.bound(now_s))

    def _is_over(self, now_s: float) -> bool:
        return now_s - self._heard_s > self._patience_s


class TransportError(Exception):
    """A transport cannot do what was asked. The text is one sentence: where, what, how to fix it."""

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
    """Carries chunks of bytes both ways between this end and one peer. Not safe for use by several threads on one end.

    name: the kind, for instance "udp". address: this end as a URL, for people. stream: False when each `send` arrives
    as one chunk or not at all, True when chunks may be cut and joined on the way. unsent: sends that `send` could not
    hand on. learns_peer: True when the peer is learned from what comes. serves_one: True when others wait for the peer
    to leave; for both `accept_sender` matters. strangers: datagrams and calls that were refused unheard because they
    came from another than the peer; stranger: who sent the latest. datagram_bytes: the most that one `send` should
    carry, when there is a choice; a single frame may be longer. capacity_bps: bytes of payload per second that the line
    carries, None when the line is not what limits a link. lossless: True when what `send` took arrives, as long as the
    connection lasts; losses: how often one has ended.
    """

    name: str = ""
    stream: bool = False
    learns_peer: bool = False
    serves_one: bool = False
    datagram_bytes: int = DATAGRAM_BYTES
    capacity_bps: float | None = None
    strangers: int = 0
    stranger: str = ""
    lossless: bool = False
    losses: int = 0

    def __init__(self, address: str) -> None:
        self.address = address
        self.unsent = 0

    @classmethod
    @abstractmethod
    def open(cls: type[Self], url: SplitResult, listen: bool) -> Self:
        """Open from a split URL. Raises a TransportError."""

    @abstractmethod
    def send(self, data: bytes) -> bool:
        """Hand bytes on without waiting. False, and `unsent` counts, when there is no peer yet, no room or no way.

        Never an exception for that.
        """

    @abstractmethod
    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        """All chunks that are there, up to a bound, oldest first. Waits for the first at most timeout_s.

        0 does not wait. One that was waited for may come alone, though others are close behind.
        """

    @abstractmethod
    def fileno(self) -> int | None:
        """Descriptor that becomes readable with new bytes, or None when there is none."""

    @abstractmethod
    def close(self) -> None:
        """Give everything back. A second call does nothing."""

    @property
    def peer(self) -> str:
        """The other end as a URL, or an empty text while it is not known."""
        return ""

    def accept_sender(self, index: int, standing: SenderStatus) -> bool:
        """Chunk `index` of the last `receive` held a good frame, which makes its sender what `standing` says.

        A transport that takes bytes from anybody learns its peer from this, so that stray bytes never redirect the
        answers. False when the sender is not the peer: what it says is not for this end.
        """
        return True

    def wait_for_room(self, timeout_s: float) -> bool:
        """Whether `send` has room, waiting for it at most timeout_s. True where nothing says when there is."""
        return True

    def backlog_s(self) -> float:
        """How long what `send` took still occupies the line, in seconds; 0 where the line does not matter."""
        return 0.0

    def wake_s(self) -> float | None:
        """Seconds until `receive` wants to be called although no bytes came, None for never."""
        return None

    def counts(self) -> dict[str, int]:
        """What this end has counted beside what a link counts, by name."""
        return {}

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_transport(url: str, listen: bool) -> Transport:
    """Open the transport a URL names: wait there for the peer (listen) or go to it.

    Raises BadUrlError and the other TransportErrors. `port 0` asks for any free port when listening; `address` then
    tells which.
    """
    scheme, found, _ = url.partition("://")
    known = ", ".join(f"{name}://" for name in SCHEMES)
    if not found:
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
