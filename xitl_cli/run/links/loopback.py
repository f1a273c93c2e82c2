"""Lines and buses without hardware, created for a run: `serial://pty?baud=…` and `can://slcan/pty?bitrate=…`."""

from __future__ import annotations

import os
import select
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from contextlib import suppress
from typing import NamedTuple, Protocol
from urllib.parse import urlsplit

from agent.wire.can_bus import EXAMPLE, read_can_settings
from agent.wire.can_transfer import FD_LENGTHS, CanLine
from agent.wire.serial_line import BITS_PER_BYTE, device_and_baud
from agent.wire.transport import BadUrlError
from agent.wire.urls import parse_query
from xitl_cli.errors import UserError
from xitl_cli.run.links.ports import PortClaims

TICK_S = 0.001


class PtyPair(ABC):
    """Two devices, `devices`. Subclasses move the bytes, about every millisecond.

    Raises UserError, which begins with `where`, when there are no pseudo-terminals.
    """

    def __init__(self, where: str) -> None:
        try:
            import tty
        except ImportError:
            raise UserError(f"{where}: this system has no pseudo-terminals; use udp:// or tcp://") from None
        self._masters: list[int] = []
        self._slaves: list[int] = []
        try:
            for _ in range(2):
                master, slave = os.openpty()
                self._masters.append(master)
                self._slaves.append(slave)  # kept open, so that the line does not hang up while it has no user
                tty.setraw(slave)
                os.set_blocking(master, False)
        except OSError as error:
            self._give_back()
            raise UserError(f"{where}: no pseudo-terminal can be opened ({error.strerror}); mount /dev/pts") from error
        self.devices = (os.ttyname(self._slaves[0]), os.ttyname(self._slaves[1]))
        self._stop_reader, self._stop_writer = os.pipe()
        self._closed = False
        self._thread = threading.Thread(target=self._carry, name=where, daemon=True)
        self._thread.start()

    @abstractmethod
    def _room(self, end: int) -> int:
        """Return the number of bytes to read from an end, 0 for none."""

    @abstractmethod
    def _take(self, end: int, data: bytes, now_s: float) -> None:
        """Accept the bytes that an end has sent."""

    @abstractmethod
    def _due(self, now_s: float) -> list[tuple[int, bytes]]:
        """Return the (end, bytes) that have arrived by now."""

    @abstractmethod
    def _busy(self) -> bool:
        """Whether bytes are in transit."""

    def _carry(self) -> None:
        while True:
            wanted = [end for end in (0, 1) if self._room(end) > 0]
            sources = [self._masters[end] for end in wanted]
            ready, _, _ = select.select([*sources, self._stop_reader], (), (), TICK_S if self._busy() else None)
            if self._stop_reader in ready:
                return
            now_s = time.monotonic()
            for end in wanted:
                if self._masters[end] in ready:
                    with suppress(OSError):
                        self._take(end, os.read(self._masters[end], self._room(end)), now_s)
            for end, data in self._due(now_s):
                with suppress(OSError):  # bytes that a full or absent receiver refuses are lost, as on a real line
                    os.write(self._masters[end], data)

    def close(self) -> None:
        """Stop, and remove the devices. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        os.write(self._stop_writer, b"x")
        self._thread.join()
        os.close(self._stop_reader)
        os.close(self._stop_writer)
        self._give_back()

    def _give_back(self) -> None:
        for descriptor in (*self._masters, *self._slaves):
            with suppress(OSError):
                os.close(descriptor)


BUFFER_BYTES = 4096  # as in a UART driver; the sender keeps further bytes


class SerialLoopback(PtyPair):
    """Two ends, each opened by its URL. Carries `baud` / 10 bytes a second in each direction, with start and stop bit.

    Bytes arrive when a real line would deliver them, to about a millisecond. Raises UserError when there are no
    pseudo-terminals.
    """

    def __init__(self, baud: int) -> None:
        if baud <= 0:
            raise ValueError(f"serial loopback: baud = {baud}; use more than 0")
        self._byte_s = BITS_PER_BYTE / baud
        self._queued = [b"", b""]
        self._through_s = [0.0, 0.0]  # time until which the delivered bytes occupy the line
        super().__init__("serial://pty")
        self.host_url, self.agent_url = (f"serial://{device}?baud={baud}" for device in self.devices)

    def _room(self, end: int) -> int:
        return BUFFER_BYTES - len(self._queued[end])

    def _take(self, end: int, data: bytes, now_s: float) -> None:
        if not self._queued[end]:
            self._through_s[end] = max(self._through_s[end], now_s)
        self._queued[end] += data

    def _due(self, now_s: float) -> list[tuple[int, bytes]]:
        arrived = []
        for end, queued in enumerate(self._queued):
            count = min(int((now_s - self._through_s[end]) / self._byte_s), len(queued))
            if count > 0:
                self._through_s[end] += count * self._byte_s
                self._queued[end] = queued[count:]
                arrived.append((1 - end, queued[:count]))
        return arrived

    def _busy(self) -> bool:
        return any(self._queued)


MOST_FRAMES = 256  # frames that an adapter queues; the computer queues the rest
SHORTEST_LINE, LONGEST_LINE = 6, 140
_IDENTIFIERS = {b"t": 3, b"T": 8, b"d": 3, b"D": 8, b"b": 3, b"B": 8}  # hex digits; capital: 29 bits
_END = b"\r"


class _Frame(NamedTuple):
    line: bytes
    identifier: int
    took_s: float


class CanLoopback(PtyPair):
    """Two nodes of a bus, each opened by its URL. `line` gives the speed of the bus.

    Of the frames that wait at the two nodes, the one with the lower identifier goes first. Each node's frames keep
    their order. Commands to the adapters (bit rates, open, close) are read and change nothing. Raises UserError when
    there are no pseudo-terminals.
    """

    def __init__(self, line: CanLine) -> None:
        self._line = line
        self._text = [b"", b""]
        self._waiting: tuple[deque[_Frame], deque[_Frame]] = deque(), deque()
        self._on_bus: tuple[int, _Frame] | None = None
        self._free_at_s = 0.0
        super().__init__("can://slcan/pty")
        rates = f"bitrate={line.bitrate}" + (f"&fd=true&data_bitrate={line.data_bitrate}" if line.fd else "")
        self.host_url, self.agent_url = (f"can://slcan{device}?{rates}&sleep_after_open=0" for device in self.devices)

    def _room(self, end: int) -> int:
        return max(MOST_FRAMES - len(self._waiting[end]), 0) * SHORTEST_LINE

    def _take(self, end: int, data: bytes, now_s: float) -> None:
        if not self._busy():
            self._free_at_s = max(self._free_at_s, now_s)
        *lines, rest = (self._text[end] + data).split(_END)
        self._text[end] = rest[-LONGEST_LINE:]
        for text in lines:
            digits = _IDENTIFIERS.get(text[:1])
            if digits is None:
                continue
            try:
                identifier = int(text[1 : 1 + digits], 16)
                length = FD_LENGTHS[int(text[1 + digits : 2 + digits], 16)]
            except ValueError:
                continue
            if len(text) == 2 + digits + 2 * length:
                rank = identifier if digits == 8 else identifier << 18
                took_s = self._line.frame_s(min(length, self._line.part_bytes))
                self._waiting[end].append(_Frame(text + _END, rank, took_s))

    def _due(self, now_s: float) -> list[tuple[int, bytes]]:
        arrived: list[tuple[int, bytes]] = []
        while True:
            if self._on_bus is None:
                ready = [end for end in (0, 1) if self._waiting[end]]
                if not ready:
                    return arrived
                end = min(ready, key=lambda end: self._waiting[end][0].identifier)
                self._on_bus = end, self._waiting[end].popleft()
                self._free_at_s += self._on_bus[1].took_s
            if now_s < self._free_at_s:
                return arrived
            end, frame = self._on_bus
            arrived.append((1 - end, frame.line))
            self._on_bus = None

    def _busy(self) -> bool:
        return self._on_bus is not None or any(self._waiting)


class MulticastBus:
    """A datagram bus of this machine at a separate port, for a URL without a port.

    Parallel runs would otherwise share one.
    """

    def __init__(self, link: str) -> None:
        mark = "&" if urlsplit(link).query else "?"
        self._ports = PortClaims()
        self.host_url = self.agent_url = f"{link}{mark}port={self._ports.free('udp')}"

    def close(self) -> None:
        """Release the port."""
        self._ports.close()


class Loopback(Protocol):
    """A line within this machine. Each end is opened by its URL."""

    host_url: str
    agent_url: str

    def close(self) -> None:
        """Remove the line. A second call does nothing."""


def open_loopback(link: str) -> Loopback | None:
    """Create the line that a link requests.

    Returns None for a link that exists already or is elsewhere. Raises UserError.
    """
    url = urlsplit(link)
    try:
        if url.scheme == "serial" and url.netloc == "pty":
            return SerialLoopback(device_and_baud(url._replace(netloc="", path="/pty"))[1])
        if url.scheme == "can" and url.netloc == "slcan" and url.path == "/pty":
            return CanLoopback(read_can_settings(url, listen=False).line)
        if url.scheme == "can" and url.netloc == "udp_multicast" and "port" not in parse_query(url, EXAMPLE):
            return MulticastBus(link)
    except BadUrlError as error:
        raise UserError(f"autopilot.link: {error}") from error
    return None
