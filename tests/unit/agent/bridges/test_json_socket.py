"""The socket of the JSON interface: requests, answers, losses and restarts of an autopilot."""

from __future__ import annotations

import select
import socket
import struct
from collections.abc import Iterator
from time import monotonic
from typing import Any

import pytest

from agent.bridges import json_line
from agent.bridges.json_line import JsonLine
from agent.wire.transport import AddressInUseError, BadUrlError
from tests.patience import PATIENCE_S


def packet(magic: int, channels: int, rate_hz: int = 1200, frame: int = 7) -> bytes:
    return struct.pack(f"<HHI{channels}H", magic, rate_hz, frame, *range(1000, 1000 + channels))


class Autopilot:
    """An autopilot that requests frames of its world."""

    def __init__(self, line: JsonLine) -> None:
        self.line = line
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(PATIENCE_S)
        host, _, port = line.address[len("udp://") :].rpartition(":")
        self.where = host, int(port)

    @property
    def address(self) -> str:
        return f"udp://127.0.0.1:{self.socket.getsockname()[1]}"

    def ask(self, *frames: int, rate_hz: int = 1200) -> None:
        for frame in frames:
            self.send(packet(18458, 16, rate_hz, frame))

    def send(self, data: bytes) -> None:
        before = self.line.counts.world_in + self.line.counts.junk
        self.socket.sendto(data, self.where)
        select.select([self.line.fileno()], [], [], PATIENCE_S)
        self.line.hear(-1)
        assert before <= self.line.counts.world_in + self.line.counts.junk

    def received(self, count: int) -> list[bytes]:
        return [self.socket.recv(4096) for _ in range(count)]

    @property
    def has_more(self) -> bool:
        return bool(select.select([self.socket], [], [], 0.0)[0])


class Served:
    """A line, its starts, and an autopilot."""

    def __init__(self) -> None:
        self.starts: list[tuple[str, bool]] = []
        self.line = JsonLine("udp://127.0.0.1:0", lambda sender, anew: self.starts.append((sender, anew)))
        self.autopilots: list[Autopilot] = []

    def autopilot(self) -> Autopilot:
        self.autopilots.append(Autopilot(self.line))
        return self.autopilots[-1]

    def close(self) -> None:
        self.line.close()
        for autopilot in self.autopilots:
            autopilot.socket.close()


@pytest.fixture
def served() -> Iterator[Served]:
    made = Served()
    yield made
    made.close()


def test_each_answer_brings_the_next_request(served: Served) -> None:
    line, autopilot = served.line, served.autopilot()
    assert (line.asked, line.peer, line.behind, line.rate_hz) == (None, "", 0, 0)
    autopilot.ask(5, rate_hz=800)
    assert (line.asked, line.served, line.behind) == (5, 5, 0)
    assert (line.peer, line.rate_hz, line.counts.world_rate) == (autopilot.address, 800, 800)
    assert line.new_pulses() == tuple(range(1000, 1016))
    assert line.new_pulses() is None
    line.answer([b"answer of 6"])
    assert (line.asked, line.served, line.behind) == (5, 6, 1)
    assert autopilot.received(1) == [b"answer of 6"]
    autopilot.ask(6, 7, rate_hz=800)
    assert (line.asked, line.served, line.behind, line.counts.world_in) == (7, 7, 0, 3)
    assert line.new_pulses() is not None
    assert (line.counts.world_lost, line.counts.junk, line.counts.unsent, served.starts) == (0, 0, 0, [])


def test_frames_that_are_skipped_are_counted_and_late_ones_ignored(served: Served) -> None:
    line, autopilot = served.line, served.autopilot()
    autopilot.ask(1, 2, 6, 4, 5, 7)
    assert (line.asked, line.served, line.counts.world_in, line.counts.world_lost) == (7, 7, 4, 3)


def test_a_packet_of_another_length_is_read_too(served: Served) -> None:
    line, autopilot = served.line, served.autopilot()
    autopilot.ask(1)
    autopilot.send(packet(29569, 32, frame=2))
    pulses = line.new_pulses()
    assert pulses is not None
    assert len(pulses) == 32
    autopilot.send(packet(18458, 16, frame=3)[:-1])
    assert (line.asked, line.counts.junk) == (2, 39)


def test_the_newest_answer_is_sent_again_when_it_was_missed(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [10.0]
    monkeypatch.setattr(json_line, "monotonic", lambda: now_s[0])
    line, autopilot = served.line, served.autopilot()
    autopilot.ask(3)
    now_s[0] += 100.0
    autopilot.ask(3)
    assert not autopilot.has_more, "there is no answer yet"
    line.answer([b"four", b"five"])
    assert autopilot.received(2) == [b"four", b"five"]
    now_s[0] += json_line.ASKED_AGAIN_S
    autopilot.ask(3)
    assert not autopilot.has_more, "the answer may be on its way"
    now_s[0] += 0.001
    autopilot.ask(3)
    assert autopilot.received(2) == [b"five", b"five"]
    assert (line.counts.world_resent, line.counts.world_in, line.asked) == (1, 1, 3)


def test_another_sender_and_a_restart_begin_anew(served: Served) -> None:
    line, first, second = served.line, served.autopilot(), served.autopilot()
    first.ask(0)
    first.ask(1, 2)
    assert served.starts == []
    first.ask(0)
    assert served.starts == [(first.address, True)]
    assert (line.asked, line.served) == (0, 0)
    second.ask(9)
    assert served.starts[1:] == [(second.address, False)]
    assert (line.peer, line.asked, line.served) == (second.address, 9, 9)
    assert (line.counts.world_in, line.counts.world_lost) == (5, 0)


@pytest.mark.parametrize(
    "answers", [[b"one"], [b"four", b"five"], [b"short", b"longer"], [b"%03d" % n for n in range(200)]]
)
@pytest.mark.parametrize("error", [None, OSError("no such option"), BlockingIOError()])
def test_each_answer_is_a_datagram(
    served: Served, monkeypatch: pytest.MonkeyPatch, answers: list[bytes], error: OSError | None
) -> None:
    """With and without the call that sends many at once."""
    line, autopilot = served.line, served.autopilot()
    autopilot.ask(0)
    if error is not None:
        line._socket = Failing(line._socket, error)  # type: ignore[assignment]
    line.answer(answers)
    assert autopilot.received(len(answers)) == answers
    assert not autopilot.has_more
    assert (line.served, line.counts.unsent) == (len(answers), 0)


class Failing:
    """A socket that cannot send many at once."""

    def __init__(self, real: socket.socket, error: OSError) -> None:
        self._real, self._error = real, error

    def sendmsg(self, *arguments: object) -> None:
        raise self._error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)


def test_waiting_ends_with_the_request_or_the_time(served: Served) -> None:
    line, autopilot = served.line, served.autopilot()
    assert not line.wait(0, monotonic() + 0.01)
    autopilot.socket.sendto(packet(18458, 16, frame=4), autopilot.where)
    assert line.wait(0, monotonic() + PATIENCE_S)
    line.answer([b"five", b"six"])
    assert line.wait(2, monotonic())
    assert not line.wait(1, monotonic() + 0.01)
    autopilot.socket.sendto(packet(18458, 16, frame=5), autopilot.where)
    assert line.wait(1, monotonic() + PATIENCE_S)
    assert (line.asked, line.served) == (5, 6)


@pytest.mark.parametrize("url", ["tcp://127.0.0.1:9002", "127.0.0.1:9002"])
def test_the_interface_is_served_over_udp(url: str) -> None:
    with pytest.raises(
        BadUrlError, match=r"the JSON interface is served over UDP; write it like udp://127\.0\.0\.1:9002"
    ):
        JsonLine(url, lambda sender, anew: None)


def test_an_address_in_use_is_told(served: Served) -> None:
    with pytest.raises(AddressInUseError):
        JsonLine(served.line.address, lambda sender, anew: None)
