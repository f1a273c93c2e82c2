"""MAVLink over a CAN bus: each frame is a transfer of CAN frames, see `agent.wire.can_transfer`.

    can://INTERFACE/CHANNEL?bitrate=…&fd=true&data_bitrate=…&node=2&peer=1&…

python-can drives the bus, so all of its interfaces are supported. It gets all other keys unchanged.
"""

from __future__ import annotations

import errno
import os
import select
import socket
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Any
from urllib.parse import SplitResult, unquote

from agent.wire.can_transfer import LARGEST_CHUNK, NODES, NORMAL, URGENT, CanFrame, CanLine, Reassembler, Segmenter
from agent.wire.framing import MAGIC
from agent.wire.priority import URGENT as URGENT_MESSAGES
from agent.wire.transport import (
    AddressDeniedError,
    AddressInUseError,
    AddressUnavailableError,
    BadUrlError,
    DatagramTooLongError,
    LineOccupancy,
    Transport,
    TransportClosedError,
    TransportError,
)
from agent.wire.urls import Value, parse_query, true_or_false, url_text, whole_number

CHUNK_BYTES = 4096


class CanAdapter:
    """Additional information on a bus. By default there is none."""

    def has_room(self) -> bool:
        """Whether a frame would be accepted."""
        return True

    def has_input(self) -> bool:
        """Whether there are frames that select() does not detect."""
        return False


class SlcanPort(CanAdapter):
    """Replaces the pyserial port, with the names that python-can uses."""

    def __init__(self, port: Any) -> None:
        self.write_timeout = None
        self._port = port
        self._descriptor: int = port.fileno()
        self._unread = b""
        self._at = 0
        self._unwritten = b""
        import termios  # not on Windows, where python-can drives other adapters

        attributes = termios.tcgetattr(self._descriptor)
        attributes[6][termios.VMIN] = 1  # an empty read then means that the adapter is gone
        termios.tcsetattr(self._descriptor, termios.TCSANOW, attributes)

    def has_input(self) -> bool:
        return self._at < len(self._unread)

    def has_room(self) -> bool:
        """Whether a line would be accepted. Raises OSError when the adapter is gone."""
        if self._unwritten:
            with suppress(BlockingIOError, InterruptedError):
                self._unwritten = self._unwritten[os.write(self._descriptor, self._unwritten) :]
        return not self._unwritten

    @property
    def in_waiting(self) -> int:
        """Number of bytes for `read`. Raises OSError when the adapter is gone."""
        if self._at >= len(self._unread):
            self._at, self._unread = 0, b""
            with suppress(BlockingIOError, InterruptedError):
                self._unread = os.read(self._descriptor, CHUNK_BYTES)
                if not self._unread:
                    raise OSError(errno.EIO, os.strerror(errno.EIO))
        return len(self._unread) - self._at

    def read(self, size: int = 1) -> bytes:
        """Return bytes that `in_waiting` has read."""
        at = self._at
        self._at = at + size
        return self._unread[at : at + size]

    def write(self, line: bytes) -> int:
        """Accept the complete line. The next `has_room` sends the part that the adapter does not accept yet."""
        self._unwritten += line
        self.has_room()
        return len(line)

    def flush(self) -> None:
        """Return without waiting."""

    def reset_input_buffer(self) -> None:
        """Drop unread bytes."""
        self._at, self._unread = 0, b""
        self._port.reset_input_buffer()

    def fileno(self) -> int:
        """Descriptor of the port."""
        return self._descriptor

    def close(self) -> None:
        """Close the port."""
        self._port.close()


CALLER, LISTENER = 1, 2  # default node numbers
EXAMPLE = "write it like can://socketcan/can0?bitrate=1000000"


@dataclass(frozen=True)
class CanSettings:
    """Settings of a CAN bus."""

    interface: str
    """Interface of python-can."""
    channel: str | int
    """Channel of python-can."""
    line: CanLine
    node: int
    peer: int
    extra: Mapping[str, Value]
    """Other arguments of python-can."""

    def url(self, node: int) -> str:
        """URL of a node of this bus, for people."""
        return f"can://{self.interface}/{str(self.channel).lstrip('/')}?node={node}"


def read_can_settings(url: SplitResult, listen: bool) -> CanSettings:
    """Read the settings from a URL. Raises BadUrlError."""
    where = url_text(url)
    channel = unquote(url.path).lstrip("/")
    if not url.netloc or "@" in url.netloc or ":" in url.netloc:
        raise BadUrlError(where, "the interface is missing", EXAMPLE)
    if not channel:
        raise BadUrlError(where, "the channel is missing", EXAMPLE)
    if url.fragment:
        raise BadUrlError(where, f"can:// takes no fragment ({url.fragment})", EXAMPLE)
    keys = parse_query(url, EXAMPLE)
    fd = true_or_false(url, "fd", keys.pop("fd", False))
    bitrate = whole_number(url, "bitrate", keys.pop("bitrate", None), 5_000, 1_000_000, EXAMPLE)
    data_bitrate = whole_number(url, "data_bitrate", keys.pop("data_bitrate", bitrate), bitrate, 20_000_000, EXAMPLE)
    if not fd and data_bitrate != bitrate:
        raise BadUrlError(where, "data_bitrate needs CAN FD", "add fd=true or leave data_bitrate out")
    default = (LISTENER, CALLER) if listen else (CALLER, LISTENER)
    node = whole_number(url, "node", keys.pop("node", default[0]), 0, NODES - 1, EXAMPLE)
    peer = whole_number(url, "peer", keys.pop("peer", default[1]), 0, NODES - 1, EXAMPLE)
    if node == peer:
        raise BadUrlError(where, f"node and peer are both {node}", "give the two ends different numbers")
    if url.netloc == "udp_multicast":
        keys.setdefault("hop_limit", 0)
    is_number = channel.isascii() and channel.isdigit() and url.netloc != "virtual"
    is_device = "/" in channel
    return CanSettings(
        interface=url.netloc,
        channel=f"/{channel}" if is_device else int(channel) if is_number else channel,
        line=CanLine(bitrate, fd, data_bitrate if fd else 0),
        node=node,
        peer=peer,
        extra=keys,
    )


VIRTUAL_QUEUE = 4096
BUFFER_BYTES = 1 << 20  # half a second of a busy bus while the reader is blocked; the kernel limits it


def open_bus(settings: CanSettings, where: str) -> tuple[Any, CanAdapter]:
    """Open the python-can bus. Return it and an adapter with additional information.

    Raises a TransportError that names `where`.
    """
    try:
        import can
    except ImportError:
        raise TransportError(where, "needs python-can", "install it with pip install python-can") from None

    if settings.interface not in can.VALID_INTERFACES:
        raise BadUrlError(
            where,
            f"python-can has no interface {settings.interface}",
            "use one such as socketcan, slcan, pcan, kvaser, gs_usb, udp_multicast or virtual",
        )
    try:
        bus = can.Bus(settings.channel, settings.interface, ignore_config=True, **_arguments(settings))
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise _explained(error, settings, where) from None
    if settings.interface == "slcan":
        attributes = vars(bus)
        attributes["serialPortOrig"] = port = SlcanPort(attributes["serialPortOrig"])
        return bus, port
    if settings.interface in ("socketcan", "udp_multicast"):
        with socket.socket(fileno=os.dup(bus.fileno())) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    return bus, CanAdapter()


def _arguments(settings: CanSettings) -> dict[str, Any]:
    import can

    line = settings.line
    arguments: dict[str, Any] = {"bitrate": line.bitrate}
    if settings.interface == "virtual":
        arguments["rx_queue_size"] = VIRTUAL_QUEUE
    elif settings.interface == "slcan":
        arguments["timeout"] = 0.0
        if line.fd:
            del arguments["bitrate"]
            arguments["timing"] = can.BitTimingFd.from_sample_point(
                80_000_000, line.bitrate, 80.0, line.data_bitrate, 80.0
            )
    elif settings.interface == "udp_multicast":
        arguments["fd"] = line.fd
    elif line.fd:
        arguments.update(fd=True, data_bitrate=line.data_bitrate)
    arguments.update(settings.extra)
    return arguments


def _explained(error: BaseException, settings: CanSettings, where: str) -> TransportError:
    channel = settings.channel
    # The system's error number may be only in an error that caused this one.
    number: Any = None
    cause: BaseException | None = error
    while cause is not None and not isinstance(number, int):
        number = getattr(cause, "errno", None) or getattr(cause, "error_code", None)
        cause = cause.__cause__
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return AddressUnavailableError(
            where, f"this machine has no {channel}", "plug the adapter in and find its name with ip link"
        )
    if number == errno.EAFNOSUPPORT:
        return AddressUnavailableError(
            where, "this kernel has no SocketCAN", "load its modules (modprobe can can_raw) or use slcan"
        )
    if number in (errno.EACCES, errno.EPERM):
        return AddressDeniedError(
            where, "this user may not open it", "add the user to the group dialout and log in again"
        )
    if number in (errno.EBUSY, errno.EADDRINUSE):
        return AddressInUseError(where, "the channel is in use by another program", "stop it or choose another channel")
    reason = str(error).rstrip(".") or type(error).__name__
    return TransportError(where, f"cannot be opened ({reason})", "check interface, channel and bit rates")


BATCH = 4096  # CAN frames per receive(), so that a flood does not block the caller
FIRST_RETRY_S = 0.1
LAST_RETRY_S = 2.0
REST_S = 0.001  # interval of checks for room while the rest of a transfer waits
_SELECTABLE = ("socketcan", "slcan", "udp_multicast")  # select() detects all of their received frames
_NO_ROOM = (errno.ENOBUFS, errno.EAGAIN)


class CanTransport(Transport):
    """One node of a bus that communicates with one other, `peer`.

    A failed bus (adapter unplugged, interface gone) is reopened, first after `FIRST_RETRY_S`, then after twice as long
    each time up to `LAST_RETRY_S`.
    losses: number of failures.
    errors: frames that python-can could not read, and error frames of the controller.

    `Reassembler` defines the other `counts`.
    """

    name = "can"
    datagram_bytes = 0  # each frame is a separate transfer, so that an urgent one waits for at most one other

    def __init__(self, settings: CanSettings, where: str) -> None:
        super().__init__(settings.url(settings.node))
        self.losses = self.errors = 0
        self._settings = settings
        self._where = where
        self._peer = settings.url(settings.peer)
        self._seconds_of = settings.line.frame_s
        self.capacity_bps = settings.line.capacity_bps
        self._line = LineOccupancy()
        self._segmenter = Segmenter(settings.node, settings.peer, settings.line.fd)
        self._reassembler = Reassembler(settings.peer, settings.node)
        self._rest: deque[CanFrame] = deque()
        self._closed = False
        self._retry_s = FIRST_RETRY_S
        self._next_try_s = 0.0
        self._bus: Any = None
        self._use(*open_bus(settings, where))

    @classmethod
    def open(cls, url: SplitResult, listen: bool) -> CanTransport:
        return cls(read_can_settings(url, listen), url_text(url))

    def _use(self, bus: Any, adapter: CanAdapter) -> None:
        import can

        self._bus = bus
        self._adapter = adapter
        self._errors = (can.CanError, OSError, ValueError, TypeError, LookupError)
        self._message = can.Message
        self._selectable = self._settings.interface in _SELECTABLE
        self._send_timeout_s = None if self._settings.interface == "slcan" else 0.0

    @property
    def peer(self) -> str:
        return self._peer

    def counts(self) -> dict[str, int]:
        parts = self._reassembler
        return {
            "losses": self.losses,
            "errors": self.errors,
            "incomplete": parts.incomplete,
            "malformed": parts.malformed,
            "repeated": parts.repeated,
            "foreign": parts.foreign,
        }

    def send(self, data: bytes) -> bool:
        """See Transport. Raises DatagramTooLongError above 510 bytes."""
        if len(data) > LARGEST_CHUNK:
            raise DatagramTooLongError(
                self.address, f"{len(data)} bytes do not fit a CAN transfer", f"send at most {LARGEST_CHUNK}"
            )
        if self._ready() and self._flush():
            urgent = len(data) >= 10 and data[0] == MAGIC and data[7] | data[8] << 8 | data[9] << 16 in URGENT_MESSAGES
            frames = self._segmenter.cut(data, URGENT if urgent else NORMAL)
            if self._write(frames[0]):
                self._rest.extend(frames[1:])
                for frame in frames:
                    self._line.add(self._seconds_of(len(frame.data)))
                self._flush()
                return True
        self.unsent += 1
        return False

    def _flush(self) -> bool:
        """Send the waiting frames. Return True when none remains."""
        rest = self._rest
        while rest and self._write(rest[0]):
            rest.popleft()
        return not rest and self._bus is not None

    def _write(self, frame: CanFrame) -> bool:
        if self._bus is None:
            return False
        line = self._settings.line
        message = self._message(
            arbitration_id=frame.identifier,
            data=frame.data,
            is_fd=line.fd,
            bitrate_switch=line.fd and line.data_bitrate > line.bitrate,
        )
        try:
            if not self._adapter.has_room():
                return False
            self._bus.send(message, self._send_timeout_s)
        except self._errors as error:
            if _broken(error):
                self._lose()
            return False
        return True

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        chunks: list[bytes] = []
        self._drain(chunks, 0.0)
        until_s, left_s = monotonic() + timeout_s, timeout_s
        while not chunks and left_s > 0.0:
            wake_s = self.wake_s()
            self._drain(chunks, left_s if wake_s is None else min(left_s, wake_s))
            left_s = until_s - monotonic()
        return chunks

    def _drain(self, chunks: list[bytes], timeout_s: float) -> None:
        """Append the received chunks to `chunks`. Wait for the first CAN frame at most `timeout_s`."""
        if not self._ready():
            sleep(timeout_s)
            return
        self._flush()
        for _ in range(BATCH):
            if self._bus is None or (self._selectable and not self._readable(timeout_s)):
                return
            message = self._read(0.0 if self._selectable else timeout_s)
            timeout_s = 0.0
            if message is None:
                if self._selectable:
                    continue  # a frame that the interface skipped
                return
            if self._line.backlog_s() > 0.0:
                self._line.add(self._seconds_of(min(message.dlc, self._settings.line.part_bytes)))
            if message.is_error_frame:
                self.errors += 1
                continue
            ours = message.is_extended_id and not message.is_remote_frame
            identifier = message.arbitration_id if ours else -1
            chunk = self._reassembler.add(identifier, bytes(message.data), message.is_fd, monotonic())
            if chunk is not None:
                chunks.append(chunk)

    def _readable(self, timeout_s: float) -> bool:
        try:
            return self._adapter.has_input() or bool(select.select([self._bus], (), (), timeout_s)[0])
        except (OSError, ValueError):
            self._lose()
            return False

    def _read(self, timeout_s: float) -> Any:
        try:
            return self._bus.recv(timeout_s)
        except self._errors as error:
            self.errors += 1
            if _broken(error):
                self._lose()
            elif hasattr(self._bus, "flush"):  # slcan keeps a line that it cannot parse
                with suppress(*self._errors):
                    self._bus.flush()
            return None

    def _ready(self) -> bool:
        if self._closed:
            raise TransportClosedError(self.address)
        if self._bus is None and monotonic() >= self._next_try_s:
            try:
                self._use(*open_bus(self._settings, self._where))
                self._retry_s = FIRST_RETRY_S
            except TransportError:
                self._next_try_s = monotonic() + self._retry_s
                self._retry_s = min(2.0 * self._retry_s, LAST_RETRY_S)
        return self._bus is not None

    def _lose(self) -> None:
        self.losses += 1
        self._rest.clear()
        self._shut_down()
        self._next_try_s = monotonic() + self._retry_s

    def _shut_down(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            with suppress(*self._errors):
                bus.shutdown()
            with suppress(AttributeError, OSError):
                bus.serialPortOrig.close()  # slcan's port, which remains open after a failed shutdown

    def backlog_s(self) -> float:
        return self._line.backlog_s()

    def wake_s(self) -> float | None:
        if self._bus is None:
            return max(self._next_try_s - monotonic(), 0.0)
        return REST_S if self._rest else None

    def fileno(self) -> int | None:
        if self._bus is None or not self._selectable:
            return None
        return int(self._bus.fileno())

    def close(self) -> None:
        self._closed = True
        self._shut_down()


def _broken(error: BaseException) -> bool:
    """Whether an error is one of the device, and not of received data."""
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if number in _NO_ROOM:
        return False
    if number is not None or isinstance(error, OSError):
        return True
    return error.__cause__ is not None and _broken(error.__cause__)
