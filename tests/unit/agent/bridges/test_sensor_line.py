"""The line of a simulated sensor: order, bundles, bounds, and both ways of calling."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from time import monotonic, sleep

import pytest

from agent.bridges.ahrs import DATAGRAM_NS, WAITING_FRAMES, SensorLine, open_line
from agent.wire.transport import BadUrlError, Transport, open_transport


class Slow(Transport):
    """Takes what `room` says, one send after the other."""

    name = "slow"
    stream = True

    def __init__(self) -> None:
        super().__init__("slow://here")
        self.room = 0
        self.sent: list[bytes] = []
        self.there = True

    @classmethod
    def open(cls, url: object, listen: bool) -> Slow:
        return cls()

    @property
    def peer(self) -> str:
        return "slow://there" if self.there else ""

    def send(self, data: bytes) -> bool:
        if self.room == 0:
            return False
        self.room -= 1
        self.sent.append(data)
        return True

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        return []

    def fileno(self) -> int | None:
        return None

    def close(self) -> None:
        pass


class Datagrams(Slow):
    stream = False


def frame(number: int) -> bytes:
    return number.to_bytes(4, "big")


def test_frames_wait_for_room_in_their_order() -> None:
    transport = Slow()
    line = SensorLine(transport)
    for number in range(5):
        line.send(frame(number))
        line.flush(0)
    transport.room = 99
    line.flush(0)
    assert transport.sent == [frame(number) for number in range(5)]
    assert line.unsent == 0


def test_the_oldest_are_dropped_and_counted() -> None:
    transport = Slow()
    line = SensorLine(transport)
    for number in range(WAITING_FRAMES + 7):
        line.send(frame(number))
        line.flush(0)
    transport.room = 999
    line.flush(0)
    assert transport.sent == [frame(number) for number in range(7, WAITING_FRAMES + 7)]
    assert line.unsent == 7


def test_frames_are_not_kept_for_somebody_who_is_not_there() -> None:
    transport = Slow()
    transport.there = False
    line = SensorLine(transport)
    line.send(frame(1))
    line.flush(0)
    assert line.unsent == 1
    assert not line.connected
    transport.there, transport.room = True, 9
    line.flush(0)
    assert transport.sent == []


def test_a_line_that_is_busy_is_given_no_more() -> None:
    """Frames wait where they can still be dropped, not in a buffer of the system."""
    transport = Slow()
    transport.room = 9
    transport.backlog_s = lambda: 0.05  # type: ignore[method-assign]
    line = SensorLine(transport)
    line.send(frame(1))
    line.flush(0)
    assert transport.sent == []


def test_datagrams_are_bundled() -> None:
    """The reader takes one datagram in 10 ms: frames at 200 Hz, one in a datagram, would pile up in front of it."""
    transport = Datagrams()
    transport.room = 999
    line = SensorLine(transport)
    for number in range(40):
        line.send(frame(number))
        line.flush(number * 5_000_000)
    assert b"".join(transport.sent) == b"".join(frame(number) for number in range(len(b"".join(transport.sent)) // 4))
    assert len(transport.sent) == 40 * 5_000_000 // DATAGRAM_NS + 1


def test_no_bundle_is_longer_than_a_datagram() -> None:
    transport = Datagrams()
    transport.room = 999
    line = SensorLine(transport)
    for _ in range(20):
        line.send(bytes(100))
    line.flush(0)
    line.flush(DATAGRAM_NS)
    assert [len(sent) for sent in transport.sent] == [1400, 600]


def eventually(condition: Callable[[], bool]) -> None:
    until_s = monotonic() + 5.0
    while not condition():
        assert monotonic() < until_s, "gave up after 5 s"
        sleep(0.001)


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.mark.parametrize("scheme", ["tcp", "udp"])
@pytest.mark.parametrize("calls", [True, False])
def test_both_ways_of_calling(scheme: str, calls: bool, opened: ExitStack) -> None:
    if calls:
        other = opened.enter_context(open_transport(f"{scheme}://127.0.0.1:0", listen=True))
        line = open_line(other.address)
    else:
        line = open_line(f"{scheme}://127.0.0.1:0?listen")
        other = opened.enter_context(open_transport(line.address, listen=False))
    opened.callback(line.close)
    if not calls:
        got: list[bytes] = []

        def arrived() -> bool:
            other.send(b"$hello")
            got.extend(line.receive())
            return bool(got)

        eventually(arrived)
        line.accept_sender(0)
        assert got[0].startswith(b"$hello")
    eventually(lambda: line.receive() is not None and line.connected and (calls or bool(line.descriptors())))
    received: list[bytes] = []

    def answered() -> bool:
        line.send(b"frame")
        line.flush(monotonic_ns())
        received.extend(other.receive(0.01))
        return bool(received)

    eventually(answered)
    assert received[0].startswith(b"frame")


def monotonic_ns() -> int:
    return round(monotonic() * 1e9)


@pytest.mark.parametrize("url", ["", "5765", "http://127.0.0.1:5765", "tcp://127.0.0.1", "serial://?baud=1"])
def test_urls_that_cannot_be(url: str) -> None:
    with pytest.raises(BadUrlError):
        open_line(url)
