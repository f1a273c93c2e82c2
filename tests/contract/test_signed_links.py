"""Signing of the host's link on every transport, both ways: who has no key is not heard, and is counted."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
from transport_ends import PAIRS, Ends, opened

from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.signing import MINUTE, Signing
from tests.patience import PATIENCE_S

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))
NOW = 40_000_000_000_000  # in 2027, in units of 10 microseconds
HOST, AGENT = (255, 190), (1, 1)


def signing(key: bytes = KEY, now: int = NOW) -> Signing:
    return Signing(key, lambda: now)


@pytest.fixture(params=PAIRS)
def ends(request: pytest.FixtureRequest) -> Iterator[Ends]:
    with opened:
        listening, calling = PAIRS[request.param]()
        with listening, calling:
            yield listening, calling


def tick(number: int) -> Any:
    return dialect.MAVLink_xitl_tick_message(1, number)


def heard(link: Link, until: Any, sender: Link) -> list[int]:
    """The ticks that arrive until `until()`; a slow line is served meanwhile."""
    ticks: list[int] = []
    until_s = time.monotonic() + PATIENCE_S
    while not until() and time.monotonic() < until_s:
        ticks += [message.tick for message in link.receive(0.01)]
        sender.receive()
    return ticks


def test_both_directions_with_the_key(ends: Ends) -> None:
    agent, host = Link(ends[0], *AGENT, signing=signing()), Link(ends[1], *HOST, signing=signing())
    for sender, receiver in ((host, agent), (agent, host)):
        for number in range(20):
            sender.send(tick(number))
        got = heard(receiver, lambda: receiver.counters.received == 20, sender)  # noqa: B023
        assert got == [*range(20)]
        assert receiver.counters.refused == receiver.counters.lost == receiver.counters.dropped == 0


@pytest.mark.parametrize("theirs", [None, signing(OTHER_KEY), signing(KEY, NOW - 2 * MINUTE)])
def test_without_the_key_or_with_an_old_frame_nobody_is_heard(ends: Ends, theirs: Signing | None) -> None:
    """The last one holds the key, but what it sends was signed two minutes ago: a recording, played back."""
    agent, intruder = Link(ends[0], *AGENT, signing=signing()), Link(ends[1], *HOST, signing=theirs)
    for number in range(5):
        intruder.send(tick(number))
    assert heard(agent, lambda: agent.counters.refused == 5, intruder) == []
    assert (agent.counters.received, agent.counters.refused, agent.counters.dropped) == (0, 5, 0)
    if ends[0].learns_peer:
        assert ends[0].peer == ""
        assert not agent.send(tick(1))


def test_a_frame_that_is_played_back_is_not_heard_again(ends: Ends) -> None:
    recorded: list[bytes] = []
    agent = Link(ends[0], *AGENT, signing=signing())
    host = Link(ends[1], *HOST, signing=signing(), tap=lambda way, frame: recorded.append(frame))
    host.send(tick(1))
    host.send(tick(2))
    assert heard(agent, lambda: agent.counters.received == 2, host) == [1, 2]
    for frame in [*recorded]:
        assert ends[1].send(frame)
    assert heard(agent, lambda: agent.counters.refused == 2, host) == []
    host.send(tick(3))
    assert heard(agent, lambda: agent.counters.received == 3, host) == [3]
    assert agent.counters.refused == 2


def test_a_board_whose_clock_is_in_1970_learns_the_time_from_the_host(ends: Ends) -> None:
    agent = Link(ends[0], *AGENT, signing=signing(now=0))
    host = Link(ends[1], *HOST, signing=signing())
    host.send(tick(1))
    assert heard(agent, lambda: agent.counters.received == 1, host) == [1]
    agent.send(tick(2))
    assert heard(host, lambda: host.counters.received == 1, agent) == [2]
    assert agent.counters.refused == host.counters.refused == 0
