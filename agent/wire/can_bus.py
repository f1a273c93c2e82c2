"""MAVLink over a CAN bus: each frame is a transfer of CAN frames, see `agent.wire.can_transfer`.

The bus is python-can's, so that every interface it knows can be used.
"""

from __future__ import annotations

import errno
import select
from collections import deque
from contextlib import suppress
from time import monotonic, sleep
from typing import Any
from urllib.parse import SplitResult

from agent.wire.can_open import opened
from agent.wire.can_transfer import LARGEST_CHUNK, NORMAL, URGENT, CanFrame, Reassembler, Segmenter
from agent.wire.can_url import CanSettings, can_settings
from agent.wire.framing import MAGIC
from agent.wire.line import Line
from agent.wire.priority import URGENT as URGENT_MESSAGES
from agent.wire.query import text_of
from agent.wire.slcan_port import Adapter
from agent.wire.transport import (
    DatagramTooLongError,
    Transport,
    TransportClosedError,
    TransportError,
)

BATCH = 4096  # CAN frames of one receive(): a flood may not hold the caller
FIRST_RETRY_S = 0.1
LAST_RETRY_S = 2.0
REST_S = 0.001  # how often room is looked for while the rest of a transfer waits
_SELECTABLE = ("socketcan", "slcan", "udp_multicast")  # nothing is held back inside them that select() does not see
_NO_ROOM = (errno.ENOBUFS, errno.EAGAIN)


class CanTransport(Transport):
    """One node of a bus that talks to one other, `peer`.

    A bus that breaks (adapter unplugged, interface gone) is opened again, first after `FIRST_RETRY_S`, then twice as
    long each time up to `LAST_RETRY_S`. losses: how often it broke. errors: frames that python-can could not read, and
    error frames of the controller. The other `counts` are those of `Reassembler`.
    """

    name = "can"
    datagram_bytes = 0  # each frame is a transfer of its own, so that what is urgent waits for one at most

    def __init__(self, settings: CanSettings, where: str) -> None:
        super().__init__(settings.url(settings.node))
        self.losses = self.errors = 0
        self._settings = settings
        self._where = where
        self._peer = settings.url(settings.peer)
        self._seconds_of = settings.line.frame_s
        self.capacity_bps = settings.line.capacity_bps
        self._line = Line()
        self._segmenter = Segmenter(settings.node, settings.peer, settings.line.fd)
        self._reassembler = Reassembler(settings.peer, settings.node)
        self._rest: deque[CanFrame] = deque()
        self._closed = False
        self._retry_s = FIRST_RETRY_S
        self._next_try_s = 0.0
        self._bus: Any = None
        self._use(*opened(settings, where))

    @classmethod
    def open(cls, url: SplitResult, listen: bool) -> CanTransport:
        return cls(can_settings(url, listen), text_of(url))

    def _use(self, bus: Any, adapter: Adapter) -> None:
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
                    self._line.took(self._seconds_of(len(frame.data)))
                self._flush()
                return True
        self.unsent += 1
        return False

    def _flush(self) -> bool:
        """True when nothing waits any more."""
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
        chunks = self._drain()
        until_s, left_s = monotonic() + timeout_s, timeout_s
        while not chunks and left_s > 0.0:
            wake_s = self.wake_s()
            self._drain_into(chunks, left_s if wake_s is None else min(left_s, wake_s))
            left_s = until_s - monotonic()
        return chunks

    def _drain(self) -> list[bytes]:
        chunks: list[bytes] = []
        self._drain_into(chunks, 0.0)
        return chunks

    def _drain_into(self, chunks: list[bytes], timeout_s: float) -> None:
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
                    continue  # one that the interface passes over
                return
            if self._line.backlog_s() > 0.0:
                self._line.took(self._seconds_of(min(message.dlc, self._settings.line.part_bytes)))
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
            elif hasattr(self._bus, "flush"):  # slcan keeps a line that it cannot read
                with suppress(*self._errors):
                    self._bus.flush()
            return None

    def _ready(self) -> bool:
        if self._closed:
            raise TransportClosedError(self.address)
        if self._bus is None and monotonic() >= self._next_try_s:
            try:
                self._use(*opened(self._settings, self._where))
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
                bus.serialPortOrig.close()  # slcan's, which a failed goodbye leaves open

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
    """Whether an error of the bus is one of the device below it, and not of what came over it."""
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if number in _NO_ROOM:
        return False
    if number is not None or isinstance(error, OSError):
        return True
    return error.__cause__ is not None and _broken(error.__cause__)
