"""Totals of both ends of a link against a channel whose losses are known, however many in a row."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any
from urllib.parse import SplitResult

import pytest

from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from agent.wire.transport import Transport
from sim_core.geodesy import LocalFrame
from xitl_cli.profile import load_profile
from xitl_cli.run.links.connection import AgentConnection
from xitl_cli.run.links.inbox import AgentInbox
from xitl_cli.run.links.link_accounts import LinkAccounts, LockstepTiming
from xitl_cli.run.links.peer import AgentOptions, InProcessAgent

Fate = Callable[[], int]


class Channel(Transport):
    """One direction of a pair: `copies` says how often each chunk comes out at the other end."""

    name = "memory"
    lossless = True

    def __init__(self, inner: Transport) -> None:
        super().__init__(inner.address)
        self.inner = inner
        self.copies: Fate = lambda: 1

    @classmethod
    def open(cls, url: SplitResult, listen: bool) -> Channel:
        raise NotImplementedError

    def send(self, data: bytes) -> bool:
        for _ in range(self.copies()):
            self.inner.send(data)
        return True

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        return self.inner.receive(timeout_s)

    def fileno(self) -> int | None:
        return self.inner.fileno()

    def close(self) -> None:
        self.inner.close()


class Pair:
    """Host and agent: the agent answers XITL_RUN with its counts, and both talk one frame a chunk."""

    def __init__(self) -> None:
        ours, theirs = memory_pair(capacity=10_000)
        self.there, self.back = Channel(ours), Channel(theirs)
        self.host, self.agent = Link(self.there, 255, 190), Link(self.back, 1, 1)
        self.accounts = LinkAccounts()
        self.accounts.link = self.host
        self.status: Any = None
        self.said = 0

    def run_command(self, running: int, extra: int = 0) -> int:
        """To the agent and back: see `tell`."""
        self.host.send(dialect.MAVLink_xitl_run_message(0, b"", running, 0, 2))
        if running:
            self.host.reset_counters()
        sent = self.host.counters.sent
        self.agent.receive()
        if running:
            self.agent.reset_counters()
        self.tell(running, extra)
        return sent

    def tell(self, running: int = 1, extra: int = 0) -> None:
        """The agent's status; `extra` frames go out between its making and its sending."""
        counters = self.agent.counters
        fields = [0] * len(dialect.MAVLink_xitl_node_status_message.fieldnames)
        fields[1:7] = counters.sent, 0, counters.received, counters.lost, counters.late, counters.repeated
        fields[-2:] = running, 2
        status = dialect.MAVLink_xitl_node_status_message(*fields)
        for _ in range(extra):
            self.agent.send(dialect.MAVLink_heartbeat_message(0, 0, 0, 0, 0, 3))
        self.agent.send(status)
        self.take()

    def ask(self) -> None:
        """The host's XITL_TIMESYNC, which tells its total."""
        self.host.send(dialect.MAVLink_xitl_timesync_message(0, 0, 0, 0, self.host.counters.sent))
        for message in self.agent.receive():
            self.agent.heard_total(message.frames_sent, self.agent.counters.received)

    def talk(self, frames: int) -> None:
        for _ in range(frames):
            self.said += 1
            number = self.said
            self.host.send(dialect.MAVLink_xitl_tick_message(number, number))
            self.agent.receive()
            self.agent.send(dialect.MAVLink_xitl_timesync_message(number, 0, 0, number))
            self.take()

    def take(self) -> None:
        for message in self.host.receive():
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_XITL_NODE_STATUS:
                self.status = message
                self.accounts.status(message)
            self.accounts.heard += 1

    def start(self) -> None:
        self.run_command(1)
        self.accounts.started()

    def reports(self) -> list[Any]:
        return list(self.accounts.reports("", 0, self.status, LockstepTiming("LC")))

    def stop(self, extra: int = 0) -> list[Any]:
        self.accounts.over = True
        sent = self.run_command(0, extra)
        self.accounts.stopped(self.status, sent)
        return self.reports()


@pytest.fixture
def pair() -> Pair:
    return Pair()


def adds_up(report: Any) -> bool:
    return bool(report.sent == report.received - report.repeated + report.lost)


@pytest.mark.parametrize("in_a_row", [0, 1, 127, 128, 200, 255, 256, 300, 1000])
@pytest.mark.parametrize("before", [1, 400])
def test_frames_lost_in_a_row_are_all_counted(pair: Pair, in_a_row: int, before: int) -> None:
    pair.start()
    pair.talk(before)
    pair.there.copies = pair.back.copies = lambda: 0
    pair.talk(in_a_row)
    pair.there.copies = pair.back.copies = lambda: 1
    pair.talk(50)
    sensors, actuators = pair.stop()
    assert (sensors.lost, actuators.lost) == (in_a_row, in_a_row)
    assert adds_up(sensors)
    assert adds_up(actuators)
    assert sensors.sent == before + in_a_row + 50 + 1  # and the stop
    assert actuators.sent == before + in_a_row + 50 + 2  # and both answers
    assert sensors.repeated == actuators.repeated == 0


@pytest.mark.parametrize("in_a_row", [0, 127, 128, 250, 256, 300, 1000])
def test_frames_lost_in_a_row_are_known_while_the_run_goes_on(pair: Pair, in_a_row: int) -> None:
    pair.start()
    pair.talk(40)
    pair.ask()
    pair.tell()
    pair.there.copies = pair.back.copies = lambda: 0
    pair.talk(in_a_row)
    pair.there.copies = pair.back.copies = lambda: 1
    pair.talk(40)
    pair.ask()
    pair.tell(extra=20)
    sensors, actuators = pair.reports()
    assert (sensors.lost, sensors.gaps) == (in_a_row, in_a_row)
    assert (actuators.lost, actuators.gaps) == (in_a_row, in_a_row)
    pair.accounts.over = True
    assert [(link.lost, link.gaps) for link in pair.reports()] == [(None, in_a_row), (None, in_a_row)]


@pytest.mark.parametrize("seed", range(5))
def test_a_channel_that_loses_and_repeats(pair: Pair, seed: int) -> None:
    rng = random.Random(seed)
    lost = {"there": 0, "back": 0}
    more = {"there": 0, "back": 0}

    def fate(way: str) -> Fate:
        def copies() -> int:
            drawn = rng.choice((0, 1, 1, 1, 1, 2))
            lost[way] += drawn == 0
            more[way] += drawn == 2
            return drawn

        return copies

    pair.start()
    pair.there.copies, pair.back.copies = fate("there"), fate("back")
    pair.talk(2000)
    pair.there.copies = pair.back.copies = lambda: 1
    sensors, actuators = pair.stop()
    assert (sensors.lost, actuators.lost) == (lost["there"], lost["back"])
    assert (sensors.repeated, actuators.repeated) == (more["there"], more["back"])
    assert adds_up(sensors)
    assert adds_up(actuators)


@pytest.mark.parametrize("extra", [1, 20])
def test_what_goes_out_between_the_making_of_the_status_and_its_sending_counts(pair: Pair, extra: int) -> None:
    """As on a slow line, where messages wait for their turn."""
    pair.start()
    pair.talk(100)
    pair.back.copies = lambda: 0
    pair.talk(300)
    pair.back.copies = lambda: 1
    actuators = pair.stop(extra)[1]
    assert actuators.sent == 400 + extra + 2
    assert actuators.lost == 300


def test_the_host_tells_its_totals_and_the_agent_what_it_misses(monkeypatch: pytest.MonkeyPatch) -> None:
    inbox = AgentInbox("agent", LocalFrame(-8.8, -63.95, 70.0), 2, False, lambda stamp_ns, estimate: None)
    connection = AgentConnection("agent", load_profile("hitl-loopback").runnable(), inbox)
    peer = InProcessAgent(AgentOptions())
    connection.reach(peer)
    heartbeat = dialect.MAVLink_heartbeat_message(0, 0, 0, 0, 0, 3)
    connection.request_time()
    connection.receive()
    with monkeypatch.context() as unplugged:
        unplugged.setattr(connection.link.transport, "send", lambda data: True)
        for _ in range(700):
            connection.send(heartbeat)
    connection.request_time()
    connection.receive()
    connection.send(dialect.MAVLink_xitl_run_message(0, b"", dialect.XITL_RUN_COMMAND_HELLO, 0, 2))
    connection.receive()
    peer.close()
    assert inbox.view.status.frames_lost == 700
    assert connection.links()[0].gaps == 700


def test_without_an_answer_to_the_stop_what_arrived_stays_unknown(pair: Pair) -> None:
    pair.start()
    pair.talk(10)
    live = pair.reports()
    assert (live[0].sent, live[0].received, live[1].received) == (10, 0, 11)  # the agent told at the start alone
    pair.accounts.over = True
    sensors, actuators = pair.reports()
    assert (sensors.sent, sensors.received, sensors.lost) == (10, None, None)
    assert (actuators.sent, actuators.received) == (None, 11)


def test_a_report_has_the_latency_in_seconds_and_its_section_in_microseconds(pair: Pair) -> None:
    pair.start()
    pair.talk(10)
    assert pair.stop()[0].section()["latency_us"] == {"p50": None, "p99": None, "max": None}
    timing = LockstepTiming("LC")
    timing.sensors.add(2_000_123)
    report, _ = pair.accounts.reports("", 0, pair.status, timing)
    assert report.latency_max_s == pytest.approx(2.000123e-3)
    assert report.section()["latency_us"]["max"] == 2000.123
