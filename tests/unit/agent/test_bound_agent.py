"""A run is its host's alone: what others send changes nothing, is counted and said, until the host has left."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from node_host import HELLO, LOCKSTEP, REALTIME, START, STOP, of, texts

from agent.assembly import assemble
from agent.node import AgentNode
from agent.options import Options
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.transport import RUN_SILENCE_S, open_transport

OURS, THEIRS = 47, 81


class Bench:
    """An agent that listens at `url`, and the hosts that call it."""

    def __init__(self, url: str) -> None:
        self.opened = ExitStack()
        self.said: list[str] = []
        self.now_s = 100.0
        self.listening = self.opened.enter_context(open_transport(url, listen=True))
        self.listening._clock_s = lambda: self.now_s  # type: ignore[attr-defined]
        self.node: AgentNode = assemble(self.listening, Options(), self.opened, self.said.append)
        self.host = self.call()

    def call(self) -> Link:
        return Link(self.opened.enter_context(open_transport(self.listening.address, listen=False)), 255, 190)

    def send(self, link: Link, *messages: Any, until: Callable[[list[Any]], object] = bool) -> list[Any]:
        """What comes back until that is enough, or for as long as an answer takes."""
        link.send(*messages)
        heard: list[Any] = []
        until_s = time.monotonic() + (2.0 if link is self.host else 0.02)
        while time.monotonic() < until_s:
            self.now_s += 0.2 if link is not self.host else 0.0
            self.node.poll(0.002)
            heard += link.receive(0.002)
            if until(heard):
                break
        return heard

    def run(self, link: Link, command: int, token: int = OURS, mode: int = REALTIME) -> list[Any]:
        message = mav.MAVLink_xitl_run_message(0, b"r", command, mode, 2, token)
        return self.send(link, message, until=lambda heard: of("XITL_NODE_STATUS", heard))

    def status(self) -> Any:
        return of("XITL_NODE_STATUS", self.run(self.host, HELLO))[-1]


@pytest.fixture(params=["udp", "tcp"])
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    made = Bench(f"{request.param}://127.0.0.1:0")
    with made.opened:
        yield made


def parameter_of(bench: Bench) -> float:
    return bench.node.role.channel.autopilot.parameters["WP_SPEED"]  # type: ignore[attr-defined]


@pytest.mark.parametrize("mode", [REALTIME, LOCKSTEP])
def test_others_cannot_start_stop_or_set_anything_in_a_run(bench: Bench, mode: int) -> None:
    status = of("XITL_NODE_STATUS", bench.run(bench.host, START, mode=mode))[-1]
    assert (status.running, status.frames_refused) == (OURS, 0)
    autopilot = bench.node.role.channel.autopilot  # type: ignore[attr-defined]
    intruder = bench.call()
    for message in (
        mav.MAVLink_xitl_run_message(0, b"r", START, mode, 2, THEIRS),
        mav.MAVLink_xitl_run_message(0, b"r", STOP, mode, 2, THEIRS),
        mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 1.25, 9),
        mav.MAVLink_xitl_faults_message(0, 0, 0.0, 1, 0, 0, 1.0, 0.0, 0.0, 0.0, 1),
        mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, 2989.0, 0, 0, 0, 0, 0),
    ):
        assert bench.send(intruder, message) == []
        bench.now_s = 100.0
    assert bench.node.role.channel.autopilot is autopilot  # type: ignore[attr-defined]
    assert parameter_of(bench) == 3.0
    assert not autopilot.state.armed
    status = bench.status()
    assert status.running == OURS
    assert status.frames_refused >= (5 if bench.listening.name == "udp" else 1)
    assert status.frames_dropped == status.frames_refused
    (sentence,) = bench.said
    assert "refused" in sentence
    assert bench.listening.stranger in sentence


def test_the_host_and_the_station_are_told_once_and_not_for_each(bench: Bench) -> None:
    bench.run(bench.host, START)
    intruder = bench.call()
    for _ in range(3):
        bench.send(intruder, mav.MAVLink_xitl_run_message(0, b"r", START, REALTIME, 2, THEIRS))
        bench.now_s = 100.0
        bench.node.poll(0.03)
    said = [text for text in texts(bench.send(bench.host, until=lambda heard: texts(heard))) if "Refused" in text]
    assert said == [f"Refused {bench.listening.stranger}: not this run's host"]
    assert len(bench.said) == 1


@pytest.mark.parametrize("how", ["ended", "silent"])
def test_when_the_host_has_left_the_next_gets_in(bench: Bench, how: str) -> None:
    bench.run(bench.host, START)
    if how == "ended":
        bench.run(bench.host, STOP)
        bench.host.transport.close()
    else:
        bench.now_s += RUN_SILENCE_S + 0.1
    second = bench.host = bench.call()
    status = of("XITL_NODE_STATUS", bench.run(second, START, THEIRS))[-1]
    assert status.running == THEIRS


def test_one_that_says_nothing_does_not_keep_the_host_away(bench: Bench) -> None:
    first = bench.host
    bench.node.poll(0.01)
    second = bench.host = bench.call()
    bench.node.poll(0.01)
    bench.now_s += 2.0  # a port that is scanned
    assert bench.run(second, HELLO)
    assert first.receive() == []


def test_one_that_only_asked_gives_way_to_one_that_starts() -> None:
    made = Bench("udp://127.0.0.1:0")
    with made.opened:
        made.run(made.host, HELLO)
        made.host = made.call()
        status = of("XITL_NODE_STATUS", made.run(made.host, START, THEIRS))[-1]
        assert status.running == THEIRS


def test_a_flood_of_others_is_taken_in_bites_and_unread(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Bench("udp://127.0.0.1:0")
    with made.opened:
        made.run(made.host, START)
        intruder = made.call().transport
        for _ in range(200):
            intruder.send(b"\xfd" * 1400)
        framer = made.node._link._framer
        feed = framer.feed
        read: list[int] = []
        monkeypatch.setattr(framer, "feed", lambda chunk: read.append(len(chunk)) or feed(chunk))
        made.node.poll(0.05)
        made.node.poll(0.05)
        assert read == []
        assert made.status().frames_refused == 200
