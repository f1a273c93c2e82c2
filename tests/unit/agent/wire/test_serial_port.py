"""A serial port that the test plays: what waits, what is lost, when it is opened again, and why it is not."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest

from agent.wire import serial_line
from agent.wire.serial_line import SerialTransport
from agent.wire.transport import (
    AddressDeniedError,
    AddressInUseError,
    AddressUnavailableError,
    TransportClosedError,
    TransportError,
)

URL = "serial:///dev/ttyUSB7?baud=9600"


class Port:
    """An open port, whose other end is `far`."""

    def __init__(self) -> None:
        self.far, self._near = socket.socketpair()
        self._near.setblocking(False)
        self.far.settimeout(10.0)
        self.fd = self._near.fileno()
        self.closed = 0

    def close(self) -> None:
        self.closed += 1
        self._near.close()

    def end(self) -> None:
        self.far.close()
        self._near.close()


class Line:
    """A transport on such ports, and its clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 50.0
        self.ports: list[Port] = []
        self.absent = False
        self.slept_s: list[float] = []
        monkeypatch.setattr(serial_line, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(serial_line, "sleep", self._sleep)
        monkeypatch.setattr(serial_line, "_opened", self._opened)
        self.transport = SerialTransport.open(urlsplit(URL), False)

    def _opened(self, device: str, baud: int, where: str) -> Port:
        assert (device, baud, where) == ("/dev/ttyUSB7", 9600, URL)
        if self.absent:
            raise AddressUnavailableError(where, "is gone", "plug it in")
        self.ports.append(Port())
        return self.ports[-1]

    def _sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        self.now_s += seconds

    @property
    def port(self) -> Port:
        return self.ports[-1]


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Iterator[Line]:
    made = Line(monkeypatch)
    yield made
    for port in made.ports:
        port.end()


def test_bytes_go_both_ways(line: Line) -> None:
    transport = line.transport
    assert (transport.address, transport.peer, transport.capacity_bps) == (URL, URL, 960.0)
    assert transport.fileno() == line.port.fd
    assert transport.send(b"there")
    assert transport.send(b"")
    assert line.port.far.recv(100) == b"there"
    assert transport.receive() == []
    line.port.far.sendall(b"back")
    assert transport.receive(1.0) == [b"back"]
    assert (transport.unsent, transport.counts()) == (0, {"losses": 0})


def test_a_flood_is_read_in_part(line: Line) -> None:
    line.port.far.setblocking(False)
    line.port.far.sendall(bytes(17 * 4096))
    assert [len(chunk) for chunk in line.transport.receive()] == [4096] * 16
    assert [len(chunk) for chunk in line.transport.receive()] == [4096]


def test_the_rest_of_a_chunk_goes_before_the_next(line: Line) -> None:
    transport, chunk = line.transport, bytes(range(256)) * 8192
    assert transport.wake_s() is None
    assert transport.send(chunk)
    assert transport.wake_s() == serial_line.REST_S
    assert not transport.send(b"next")
    assert transport.unsent == 1
    received = b""
    while len(received) < len(chunk):
        received += line.port.far.recv(1 << 20)
        transport.receive()
    assert received == chunk
    assert transport.wake_s() is None
    assert transport.send(b"next")
    assert line.port.far.recv(100) == b"next"


def test_a_lost_port_is_opened_again_after_longer_and_longer_waits(line: Line) -> None:
    transport = line.transport
    line.port.far.close()
    line.absent = True
    assert transport.receive() == []
    assert (transport.losses, transport.peer, transport.fileno(), line.port.closed) == (1, "", None, 1)
    waits_s = []
    for _ in range(7):
        wake_s = transport.wake_s()
        assert wake_s is not None
        line.now_s += wake_s - 1e-6
        assert not transport.send(b"too early")
        line.now_s += 2e-6
        assert not transport.send(b"data")
        waits_s.append(round(wake_s, 3))
    assert waits_s == [0.1, 0.1, 0.2, 0.4, 0.8, 1.6, 2.0]
    assert transport.unsent == 14
    line.absent = False
    line.now_s += 2.1
    assert transport.send(b"again")
    assert line.port.far.recv(100) == b"again"
    line.port.far.close()
    transport.receive()
    assert transport.wake_s() == pytest.approx(serial_line.FIRST_RETRY_S)


def test_a_reader_of_a_lost_port_sleeps_until_the_next_try(line: Line) -> None:
    line.port.far.close()
    line.absent = True
    assert line.transport.receive(0.25) == []
    assert sum(line.slept_s) == pytest.approx(0.25)
    assert line.slept_s[0] == pytest.approx(0.1)


def test_a_port_that_refuses_bytes_is_lost(line: Line) -> None:
    line.port.end()
    line.absent = True
    assert not line.transport.send(b"data")
    assert (line.transport.losses, line.transport.unsent) == (1, 1)


def test_a_closed_port_says_so(line: Line) -> None:
    line.transport.close()
    line.transport.close()
    assert line.port.closed == 1
    with pytest.raises(TransportClosedError):
        line.transport.send(b"data")
    with pytest.raises(TransportClosedError):
        line.transport.receive()


@pytest.mark.parametrize(
    ("number", "kind", "text"),
    [
        (errno.ENOENT, AddressUnavailableError, "this machine has no /dev/ttyUSB7"),
        (errno.EIO, AddressUnavailableError, "this machine has no /dev/ttyUSB7"),
        (errno.ENXIO, AddressUnavailableError, "this machine has no /dev/ttyUSB7"),
        (errno.ENODEV, AddressUnavailableError, "this machine has no /dev/ttyUSB7"),
        (errno.EBADF, AddressUnavailableError, "this machine has no /dev/ttyUSB7"),
        (errno.EBUSY, AddressInUseError, "the port is in use by another program"),
        (errno.EAGAIN, AddressInUseError, "the port is in use by another program"),
        (errno.EACCES, AddressDeniedError, "this user may not open it"),
        (errno.EPERM, AddressDeniedError, "this user may not open it"),
        (errno.EINVAL, TransportError, r"cannot be opened as a serial port \(Invalid argument\)"),
        (None, TransportError, r"cannot be opened as a serial port \(a bad rate\)"),
    ],
)
def test_a_port_that_does_not_open_is_explained(
    monkeypatch: pytest.MonkeyPatch, number: int | None, kind: type[TransportError], text: str
) -> None:
    serial = pytest.importorskip("serial")

    def fail(*arguments: Any, **keys: Any) -> None:
        raise ValueError("a bad rate") if number is None else OSError(number, "refused")

    monkeypatch.setattr(serial, "Serial", fail)
    with pytest.raises(kind, match=text):
        SerialTransport.open(urlsplit(URL), False)
