"""A node of a CAN bus, at a python-can bus that the test plays."""

from __future__ import annotations

import errno
import os
import termios
import tty
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import can
import pytest

from agent.wire import can_bus, dialect
from agent.wire.can_bus import CanAdapter, CanSettings, CanTransport, SlcanPort, read_can_settings
from agent.wire.can_transfer import NORMAL, URGENT, Segmenter
from agent.wire.codec import Packer
from agent.wire.transport import (
    AddressDeniedError,
    AddressInUseError,
    AddressUnavailableError,
    DatagramTooLongError,
    LineOccupancy,
    TransportClosedError,
    TransportError,
)

URL = "can://virtual/bus?bitrate=500000"
FD_URL = "can://virtual/bus?bitrate=500000&fd=true&data_bitrate=2000000"


class Bus:
    """A bus of python-can: what was sent, and what comes."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.timeouts: list[Any] = []
        self.coming: deque[Any] = deque()
        self.fails: BaseException | None = None
        self.room = 10**6
        self.ended = 0

    def send(self, message: Any, timeout: float | None) -> None:
        if self.fails is not None:
            raise self.fails
        self.room -= 1
        self.sent.append(message)
        self.timeouts.append(timeout)

    def recv(self, timeout: float) -> Any:
        one = self.coming.popleft() if self.coming else None
        if isinstance(one, BaseException):
            raise one
        return one

    def has_room(self) -> bool:
        return self.room > 0

    def has_input(self) -> bool:
        return False

    def shutdown(self) -> None:
        self.ended += 1


class Line:
    """A transport on such a bus, and its clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, url: str = URL) -> None:
        self.now_s = 100.0
        self.buses: list[Bus] = []
        self.absent = False
        self.slept_s: list[float] = []
        monkeypatch.setattr(can_bus, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(can_bus, "sleep", self._sleep)
        monkeypatch.setattr(can_bus, "LineOccupancy", lambda: LineOccupancy(lambda: self.now_s))
        monkeypatch.setattr(can_bus, "open_bus", self._open)
        self.transport = CanTransport.open(urlsplit(url), False)

    def _open(self, settings: CanSettings, where: str) -> tuple[Bus, Any]:
        if self.absent:
            raise TransportError(where, "is gone", "plug it in")
        self.buses.append(Bus())
        return self.buses[-1], self.buses[-1]

    def _sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        self.now_s += seconds

    @property
    def bus(self) -> Bus:
        return self.buses[-1]


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Line:
    return Line(monkeypatch)


def frame(identifier: int, data: bytes, **keys: Any) -> Any:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=True, **keys)


def chunk_frames(chunk: bytes, sender: int = 2, destination: int = 1) -> list[Any]:
    return [frame(one.identifier, one.data) for one in Segmenter(sender, destination, False).cut(chunk)]


def test_a_chunk_is_the_frames_of_a_transfer(line: Line) -> None:
    chunk = bytes(range(40))
    assert line.transport.send(chunk)
    expected = Segmenter(1, 2, False).cut(chunk, NORMAL)
    assert [(one.arbitration_id, bytes(one.data)) for one in line.bus.sent] == expected
    assert all(one.is_extended_id and not one.is_fd and not one.bitrate_switch for one in line.bus.sent)
    assert set(line.bus.timeouts) == {0.0}
    assert (line.transport.unsent, line.transport.peer) == (0, "can://virtual/bus?node=2")
    assert line.transport.address == "can://virtual/bus?node=1"


@pytest.mark.parametrize(("url", "switches"), [(FD_URL, True), (FD_URL.replace("2000000", "500000"), False)])
def test_can_fd_switches_to_its_faster_rate(monkeypatch: pytest.MonkeyPatch, url: str, switches: bool) -> None:
    line = Line(monkeypatch, url)
    assert line.transport.send(bytes(100))
    assert [one.is_fd for one in line.bus.sent] == [True, True]
    assert {one.bitrate_switch for one in line.bus.sent} == {switches}


def test_urgent_messages_have_the_higher_priority(line: Line) -> None:
    packer = Packer(1, 1)
    urgent = packer.pack(dialect.MAVLink_xitl_tick_message(10, 1))
    other = packer.pack(dialect.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3))
    for data, priority in ((urgent, URGENT), (other, NORMAL), (b"\0" + urgent[1:], NORMAL), (urgent[:9], NORMAL)):
        line.bus.sent.clear()
        assert line.transport.send(data)
        assert {one.arbitration_id >> 27 for one in line.bus.sent} == {priority}


@pytest.mark.parametrize(("size", "fits"), [(510, True), (511, False)])
def test_the_longest_chunk(line: Line, size: int, fits: bool) -> None:
    if fits:
        assert line.transport.send(bytes(size))
        return
    with pytest.raises(DatagramTooLongError, match="511 bytes do not fit a CAN transfer; send at most 510"):
        line.transport.send(bytes(size))


def test_the_rest_of_a_transfer_waits_for_room_and_goes_before_the_next(line: Line) -> None:
    chunk = bytes(range(20))
    frames = Segmenter(1, 2, False).cut(chunk)
    line.bus.room = 1
    assert line.transport.wake_s() is None
    assert line.transport.send(chunk)
    assert len(line.bus.sent) == 1
    assert line.transport.wake_s() == can_bus.REST_S
    assert not line.transport.send(b"later")
    assert (line.transport.unsent, len(line.bus.sent)) == (1, 1)
    line.bus.room = 10
    line.transport.receive()
    assert [bytes(one.data) for one in line.bus.sent] == [one.data for one in frames]
    assert line.transport.wake_s() is None
    line.bus.room = 0
    assert not line.transport.send(b"no room")
    assert line.transport.unsent == 2


def test_a_slow_line_has_a_backlog_of_its_frames(line: Line) -> None:
    """An extended frame of 8 bytes has 131 bits, and up to 160 with stuffing and the pause after it."""
    frames = len(Segmenter(1, 2, False).cut(bytes(300)))
    line.transport.send(bytes(300))
    assert frames * 131 / 500_000 <= line.transport.backlog_s() <= frames * 160 / 500_000


def test_received_frames_become_chunks_and_others_are_counted(line: Line) -> None:
    first, second = b"first chunk of some frames", b"second"
    ours = chunk_frames(first)
    line.bus.coming += [
        *ours[:2],
        frame(ours[0].arbitration_id, b"\1", is_error_frame=True),
        *ours[1:],
        frame(0x123, b"of another protocol"[:8]),
        can.Message(arbitration_id=0x123, data=b"short", is_extended_id=False),
        frame(ours[0].arbitration_id, b"", is_remote_frame=True),
        *chunk_frames(second, sender=3),
        None,
        *chunk_frames(b"too late"),
    ]
    assert line.transport.receive() == [first]
    assert line.transport.counts() == {
        "losses": 0,
        "errors": 1,
        "incomplete": 0,
        "malformed": 0,
        "repeated": 1,
        "foreign": 4,
    }


def test_data_that_the_interface_cannot_read_are_counted_and_the_bus_stays(line: Line) -> None:
    line.bus.coming += [ValueError("not a frame"), can.CanError("odd"), *chunk_frames(b"good")]
    chunks: list[bytes] = []
    for _ in range(4):
        chunks += line.transport.receive()
    assert chunks == [b"good"]
    assert (line.transport.errors, line.transport.losses, line.bus.ended) == (2, 0, 0)


def caused(error: BaseException, cause: BaseException) -> BaseException:
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "broken"),
    [
        (OSError(errno.ENOBUFS, "full"), False),
        (OSError(errno.EAGAIN, "again"), False),
        (can.CanError("full", errno.ENOBUFS), False),
        (ValueError("odd"), False),
        (OSError(errno.EIO, "unplugged"), True),
        (OSError("without a number"), True),
        (can.CanError("down", errno.ENETDOWN), True),
        (caused(can.CanError("down"), OSError(errno.ENODEV, "gone")), True),
        (caused(can.CanError("full"), OSError(errno.ENOBUFS, "full")), False),
    ],
)
def test_an_error_of_the_device_loses_the_bus_and_a_full_one_does_not(
    line: Line, error: BaseException, broken: bool
) -> None:
    line.bus.fails = error
    assert not line.transport.send(b"data")
    assert (line.transport.losses, line.bus.ended) == (int(broken), int(broken))
    assert line.transport.unsent == 1


def test_a_lost_bus_is_opened_again_after_longer_and_longer_waits(line: Line) -> None:
    line.bus.fails = OSError(errno.EIO, "unplugged")
    line.absent = True
    line.transport.send(b"data")
    tries_s = []
    for _ in range(7):
        wake_s = line.transport.wake_s()
        assert wake_s is not None
        line.now_s += wake_s - 1e-6
        assert not line.transport.send(b"too early")
        assert line.transport.wake_s() == pytest.approx(1e-6, abs=1e-9)
        line.now_s += 2e-6
        assert not line.transport.send(b"data")
        tries_s.append(round(wake_s, 3))
    assert tries_s == [0.1, 0.1, 0.2, 0.4, 0.8, 1.6, 2.0]
    line.absent = False
    line.now_s += 2.1
    assert line.transport.send(b"data")
    assert (len(line.buses), line.transport.losses) == (2, 1)
    line.bus.fails = OSError(errno.EIO, "unplugged")
    line.transport.send(b"data")
    assert line.transport.wake_s() == pytest.approx(can_bus.FIRST_RETRY_S)
    assert line.transport.fileno() is None


def test_a_reader_of_a_lost_bus_sleeps_until_the_next_try(line: Line) -> None:
    line.bus.coming.append(OSError(errno.EIO, "unplugged"))
    line.absent = True
    assert line.transport.receive(0.25) == []
    assert (line.transport.losses, line.transport.errors) == (1, 1)
    assert sum(line.slept_s) == pytest.approx(0.25, abs=1e-3)


def test_a_closed_line_says_so(line: Line) -> None:
    line.transport.close()
    assert line.bus.ended == 1
    with pytest.raises(TransportClosedError):
        line.transport.send(b"data")
    with pytest.raises(TransportClosedError):
        line.transport.receive()


@pytest.mark.parametrize(
    ("error", "kind", "text"),
    [
        (OSError(errno.ENODEV, "x"), AddressUnavailableError, "this machine has no can0; plug the adapter in"),
        (OSError(errno.ENXIO, "x"), AddressUnavailableError, "this machine has no can0; plug the adapter in"),
        (OSError(errno.EAFNOSUPPORT, "x"), AddressUnavailableError, "this kernel has no SocketCAN"),
        (OSError(errno.EACCES, "x"), AddressDeniedError, "this user may not open it"),
        (OSError(errno.EPERM, "x"), AddressDeniedError, "this user may not open it"),
        (OSError(errno.EBUSY, "x"), AddressInUseError, "the channel is in use by another program"),
        (OSError(errno.EADDRINUSE, "x"), AddressInUseError, "the channel is in use by another program"),
        (can.CanError("no", errno.EBUSY), AddressInUseError, "the channel is in use by another program"),
        (caused(can.CanError("no"), OSError(errno.ENOENT, "x")), AddressUnavailableError, "has no can0"),
        (ValueError("bad timing."), TransportError, r"cannot be opened \(bad timing\); check interface, channel"),
        (NotImplementedError(), TransportError, r"cannot be opened \(NotImplementedError\)"),
    ],
)
def test_a_bus_that_does_not_open_is_explained(
    monkeypatch: pytest.MonkeyPatch, error: Exception, kind: type[TransportError], text: str
) -> None:
    def fail(*arguments: Any, **keys: Any) -> None:
        raise error

    monkeypatch.setattr(can, "Bus", fail)
    with pytest.raises(kind, match=text):
        CanTransport.open(urlsplit("can://socketcan/can0?bitrate=500000"), False)


@pytest.mark.parametrize(
    ("url", "arguments"),
    [
        (URL, {"bitrate": 500_000, "rx_queue_size": 4096}),
        ("can://kvaser/0?bitrate=500000&single_handle=true", {"bitrate": 500_000, "single_handle": True}),
        (
            "can://kvaser/0?bitrate=500000&fd=true&data_bitrate=2000000",
            {"bitrate": 500_000, "fd": True, "data_bitrate": 2_000_000},
        ),
    ],
)
def test_python_can_gets_the_keys_of_the_url(
    monkeypatch: pytest.MonkeyPatch, url: str, arguments: dict[str, Any]
) -> None:
    asked: list[Any] = []

    def make(channel: Any, interface: str, **keys: Any) -> Any:
        asked.append((channel, interface, keys))
        return SimpleNamespace()

    monkeypatch.setattr(can, "Bus", make)
    settings = read_can_settings(urlsplit(url), False)
    _, adapter = can_bus.open_bus(settings, url)
    assert asked == [(settings.channel, settings.interface, {"ignore_config": True, **arguments})]
    assert isinstance(adapter, CanAdapter)
    assert (adapter.has_room(), adapter.has_input()) == (True, False)


def test_an_slcan_adapter_with_can_fd_has_a_timing_of_its_two_rates() -> None:
    url = "can://slcan/dev/ttyACM0?bitrate=500000&fd=true&data_bitrate=2000000"
    arguments = can_bus._arguments(read_can_settings(urlsplit(url), False))
    timing = arguments.pop("timing")
    assert arguments == {"timeout": 0.0}
    assert (timing.f_clock, timing.nom_bitrate, timing.data_bitrate) == (80_000_000, 500_000, 2_000_000)
    assert (timing.nom_sample_point, timing.data_sample_point) == pytest.approx((80.0, 80.0))


class Adapter:
    """An slcan adapter on a pseudo-terminal, whose other end is the test."""

    def __init__(self) -> None:
        self.far, near = os.openpty()
        tty.setraw(near)
        os.set_blocking(near, False)
        self.descriptor = near
        self.emptied = self.closed = 0

    def fileno(self) -> int:
        return self.descriptor

    def reset_input_buffer(self) -> None:
        self.emptied += 1

    def close(self) -> None:
        self.closed += 1
        os.close(self.descriptor)
        os.close(self.far)


@pytest.fixture
def adapter() -> Iterator[Adapter]:
    made = Adapter()
    yield made
    if not made.closed:
        made.close()


def test_an_slcan_port_reads_what_came_in_pieces(adapter: Adapter) -> None:
    port = SlcanPort(adapter)
    assert (port.fileno(), port.write_timeout) == (adapter.descriptor, None)
    assert (port.in_waiting, port.has_input()) == (0, False)
    os.write(adapter.far, b"t1231A\rz")
    assert port.in_waiting == 8
    assert (port.read(), port.read(4), port.has_input()) == (b"t", b"1231", True)
    os.write(adapter.far, b"next")
    assert port.in_waiting == 3, "the first piece is read to its end"
    assert (port.read(3), port.has_input()) == (b"A\rz", False)
    assert port.in_waiting == 4
    port.reset_input_buffer()
    assert (port.has_input(), port.in_waiting, adapter.emptied) == (False, 0, 1)
    attributes = termios.tcgetattr(adapter.descriptor)
    assert attributes[6][termios.VMIN] in (1, b"\x01")
    port.close()
    assert adapter.closed == 1


def test_an_slcan_port_keeps_what_the_adapter_does_not_take(adapter: Adapter) -> None:
    port = SlcanPort(adapter)
    line, written = bytes(range(97, 123)) * 4000, 0
    assert port.has_room()
    assert port.write(line) == len(line)
    assert not port.has_room()
    read = b""
    while not port.has_room():
        read += os.read(adapter.far, 65536)
        written += 1
    os.set_blocking(adapter.far, False)
    with suppress(BlockingIOError):
        while True:
            read += os.read(adapter.far, 65536)
    assert read == line
    assert written > 1
    port.flush()


def test_an_slcan_adapter_that_is_gone_is_an_error(adapter: Adapter) -> None:
    port = SlcanPort(adapter)
    os.close(adapter.far)
    with pytest.raises(OSError, match=r"Input/output error|\[Errno"):
        _ = port.in_waiting
    os.close(adapter.descriptor)
    adapter.closed = 1
