"""MAVLink over a serial line, 8 data bits, no parity, 1 stop bit: a stream in which the `Framer` finds frames.

Nothing here waits for the other end. Bytes that the system's buffer does not accept are refused. If it accepts a part
of a chunk, the rest is sent before anything else.
"""

from __future__ import annotations

import errno
import os
import select
from contextlib import suppress
from time import monotonic, sleep
from typing import Any
from urllib.parse import SplitResult, unquote

from agent.wire.transport import (
    AddressDeniedError,
    AddressInUseError,
    AddressUnavailableError,
    BadUrlError,
    LineOccupancy,
    Transport,
    TransportClosedError,
    TransportError,
)
from agent.wire.urls import parse_query, url_text, whole_number

BITS_PER_BYTE = 10  # with start and stop bit
CHUNK_BYTES = 4096
CHUNKS = 16  # per receive(), so that a flood does not block the caller
FIRST_RETRY_S = 0.1
LAST_RETRY_S = 2.0
REST_S = 0.002  # interval of checks for room while the rest of a chunk waits
EXAMPLE = "write it like serial:///dev/ttyACM0?baud=921600"
_GONE = (errno.EIO, errno.ENXIO, errno.ENODEV, errno.EBADF)


class SerialTransport(Transport):
    """A serial port, opened exclusively.

    An unplugged port is searched again, first after `FIRST_RETRY_S`, then after twice as long each time up to
    `LAST_RETRY_S`. Until then nothing is sent.
    losses: number of times that it disappeared.
    """

    name = "serial"
    stream = True

    def __init__(self, url: SplitResult) -> None:
        super().__init__(url_text(url))
        self.losses = 0
        self._device, baud = device_and_baud(url)
        self._baud = baud
        self.capacity_bps = baud / BITS_PER_BYTE
        self._byte_s = BITS_PER_BYTE / baud
        self._line = LineOccupancy()
        self._rest = b""
        self._closed = False
        self._port: Any = _opened(self._device, baud, self.address)
        self._retry_s = FIRST_RETRY_S
        self._next_try_s = 0.0

    @classmethod
    def open(cls, url: SplitResult, listen: bool) -> SerialTransport:
        """Open either end."""
        return cls(url)

    @property
    def peer(self) -> str:
        return "" if self._port is None else self.address

    def send(self, data: bytes) -> bool:
        if self._ready() and self._flush():
            taken = self._write(data)
            if taken or not data:
                self._rest = data[taken:]
                self._line.add(len(data) * self._byte_s)
                return True
        self.unsent += 1
        return False

    def _flush(self) -> bool:
        """Send the waiting bytes. Return True when none remains."""
        if self._rest:
            taken = self._write(self._rest)  # drops the rest when the port is gone
            self._rest = self._rest[taken:]
        return not self._rest and self._port is not None

    def _write(self, data: bytes) -> int:
        try:
            return os.write(self._port.fd, data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            self._lose()
            return 0

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        chunks = self._drain()
        until_s, left_s = monotonic() + timeout_s, timeout_s
        while not chunks and left_s > 0.0:
            if self._port is None:
                sleep(min(left_s, max(self._next_try_s - monotonic(), 0.0)))
            else:
                select.select([self._port.fd], [self._port.fd] if self._rest else (), (), left_s)
            chunks = self._drain()
            left_s = until_s - monotonic()
        return chunks

    def _drain(self) -> list[bytes]:
        chunks: list[bytes] = []
        if not self._ready():
            return chunks
        self._flush()
        while len(chunks) < CHUNKS and self._port is not None:
            try:
                chunk = os.read(self._port.fd, CHUNK_BYTES)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                self._lose()
                break
            if not chunk:  # the line was hung up
                self._lose()
                break
            chunks.append(chunk)
        return chunks

    def _ready(self) -> bool:
        if self._closed:
            raise TransportClosedError(self.address)
        if self._port is None and monotonic() >= self._next_try_s:
            try:
                self._port = _opened(self._device, self._baud, self.address)
                self._retry_s = FIRST_RETRY_S
            except TransportError:
                self._next_try_s = monotonic() + self._retry_s
                self._retry_s = min(2.0 * self._retry_s, LAST_RETRY_S)
        return self._port is not None

    def _lose(self) -> None:
        self.losses += 1
        self._rest = b""
        _close(self._port)
        self._port = None
        self._next_try_s = monotonic() + self._retry_s

    def backlog_s(self) -> float:
        return self._line.backlog_s()

    def wake_s(self) -> float | None:
        if self._port is None:
            return max(self._next_try_s - monotonic(), 0.0)
        return REST_S if self._rest else None

    def counts(self) -> dict[str, int]:
        return {"losses": self.losses}

    def fileno(self) -> int | None:
        return None if self._port is None else int(self._port.fd)

    def close(self) -> None:
        self._closed = True
        if self._port is not None:
            _close(self._port)
            self._port = None


def device_and_baud(url: SplitResult) -> tuple[str, int]:
    """Return device and baud rate of a serial URL. Raises BadUrlError."""
    where = url_text(url)
    if url.netloc:
        raise BadUrlError(where, f"serial:// takes no host ({url.netloc})", EXAMPLE)
    device = unquote(url.path)
    if not device.strip("/"):
        raise BadUrlError(where, "the device is missing", EXAMPLE)
    if url.fragment:
        raise BadUrlError(where, f"serial:// takes no fragment ({url.fragment})", EXAMPLE)
    keys = parse_query(url, EXAMPLE)
    baud = whole_number(url, "baud", keys.pop("baud", None), 300, 100_000_000, EXAMPLE)
    if keys:
        raise BadUrlError(where, f"serial:// takes no {next(iter(keys))}", EXAMPLE)
    return device, baud


def _opened(device: str, baud: int, where: str) -> Any:
    try:
        import serial  # type: ignore[import-untyped]
    except ImportError:
        raise TransportError(where, "needs pyserial", "install it with pip install pyserial") from None
    import termios

    try:
        port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
    except (OSError, ValueError, termios.error) as error:  # SerialException is an OSError
        raise _explained(error, device, where) from None
    try:
        with suppress(OSError, ValueError, NotImplementedError):
            port.set_low_latency_mode(True)  # otherwise FTDI converters hold bytes for 16 ms
        attributes = termios.tcgetattr(port.fd)
        attributes[6][termios.VMIN] = 1  # an empty read then means that the line was hung up
        termios.tcsetattr(port.fd, termios.TCSANOW, attributes)
    except (OSError, termios.error) as error:
        port.close()
        raise _explained(error, device, where) from None
    return port


def _close(port: Any) -> None:
    with suppress(OSError):
        port.close()


def _explained(error: Exception, device: str, where: str) -> TransportError:
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, *_GONE):
        return AddressUnavailableError(
            where, f"this machine has no {device}", "plug the device in, or find its name with ls /dev/tty*"
        )
    if number in (errno.EBUSY, errno.EAGAIN):
        return AddressInUseError(where, "the port is in use by another program", "stop it or choose another port")
    if number in (errno.EACCES, errno.EPERM):
        return AddressDeniedError(
            where, "this user may not open it", "add the user to the group dialout and log in again"
        )
    reason = os.strerror(number) if number else str(error)
    return TransportError(where, f"cannot be opened as a serial port ({reason})", "check the device and the baud rate")
