"""Faults on purpose: shares, delays and order as asked for, repeated by the seed, and nothing uncounted."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages import imu

from agent.wire import dialect
from agent.wire.impaired import MOST_DELAYED, OVERTAKEN_S, ImpairedTransport, LinkFaults
from agent.wire.link import Link
from agent.wire.memory import MemoryTransport, memory_pair
from agent.wire.transport import BadUrlError, Transport

TICK = dialect.MAVLINK_MSG_ID_XITL_TICK


class Bad:
    """A bad way from `here` to `there` under a clock of ours."""

    def __init__(self, exempt: Callable[[int], bool] = lambda number: number == TICK, capacity: int = 10**6) -> None:
        self.now_s = 0.0
        inner, self.there = memory_pair(capacity=capacity)
        self.transport = ImpairedTransport(inner, exempt, lambda: self.now_s)
        self.link = Link(self.transport, 1, 1)
        self.other = Link(self.there, 2, 1)

    def stamps(self) -> list[int]:
        """Of the messages that have arrived."""
        self.transport.receive()
        return [message.time_usec for message in self.other.receive()]


def within(count: int, share: float, trials: int) -> bool:
    """Five standard deviations of a binomial count: one test in a million fails by chance, and seeds are fixed."""
    return abs(count - share * trials) <= 5.0 * math.sqrt(trials * share * (1.0 - share))


@pytest.mark.medium
@pytest.mark.parametrize("kind", ["loss", "duplicate"])
@pytest.mark.parametrize("share", [0.01, 0.2, 0.7])
def test_shares_are_as_asked_for(kind: str, share: float) -> None:
    bad = Bad()
    bad.transport.set(LinkFaults(**{kind: share}), seed=3)
    for number in range(1, 5001):
        assert bad.link.send(imu(number))
    arrived = bad.stamps()
    counters = bad.other.counters
    assert bad.link.counters.sent == 5000
    if kind == "loss":
        assert within(bad.transport.lost, share, 5000)
        assert len(arrived) == len(set(arrived)) == 5000 - bad.transport.lost
    else:
        assert within(bad.transport.duplicated, share, 5000)
        assert len(set(arrived)) == 5000
        assert counters.repeated == bad.transport.duplicated == len(arrived) - 5000


@pytest.mark.medium
def test_reorder_swaps_neighbours_and_loses_nothing() -> None:
    bad = Bad()
    bad.transport.set(LinkFaults(reorder=0.1), seed=3)
    for number in range(1, 5001):
        bad.link.send(imu(number))
    bad.now_s += OVERTAKEN_S
    arrived = bad.stamps()
    assert sorted(arrived) == [*range(1, 5001)]
    swaps = [index for index in range(4999) if arrived[index] > arrived[index + 1]]
    assert len(swaps) == pytest.approx(bad.transport.reordered, abs=1)
    assert within(bad.transport.reordered, 0.1 / 1.1, 5000)  # none of those that overtake is overtaken
    assert all(arrived[index] == arrived[index + 1] + 1 for index in swaps)
    assert bad.other.counters.late == len(swaps)
    assert bad.other.counters.lost == 0


def test_the_last_frame_is_not_kept_for_ever() -> None:
    bad = Bad()
    bad.transport.set(LinkFaults(reorder=1.0))
    bad.link.send(imu(1))
    assert bad.stamps() == []
    assert bad.transport.wake_s() == pytest.approx(OVERTAKEN_S)
    bad.now_s = OVERTAKEN_S
    assert bad.stamps() == [1]
    assert bad.transport.wake_s() is None


@pytest.mark.medium
def test_delay_and_jitter_are_kept_to_and_keep_the_order() -> None:
    bad = Bad()
    bad.transport.set(LinkFaults(delay_s=0.050, jitter_s=0.020), seed=1)
    sent_s: dict[int, float] = {}
    delays: list[float] = []
    arrived: list[int] = []
    for number in range(1, 4001):
        if number <= 3000:
            sent_s[number] = bad.now_s
            bad.link.send(imu(number))
        for stamp in bad.stamps():
            arrived.append(stamp)
            delays.append(bad.now_s - sent_s[stamp])
        bad.now_s += 0.001
    assert arrived == [*range(1, 3001)]
    assert min(delays) >= 0.050 - 1e-9
    assert max(delays) <= 0.071 + 1e-9  # one step of the clock more than was drawn
    assert max(delays) > 0.069
    assert min(delays) < 0.068  # evenly drawn, but not before the frame ahead


def test_a_wait_ends_when_something_is_due() -> None:
    """Here the clock is the transport's own: what is due goes out from within a wait for the other end."""
    inner, there = memory_pair()
    transport = ImpairedTransport(inner)
    transport.set(LinkFaults(delay_s=0.02))
    transport.send(b"x" * 20)
    assert there.receive() == []
    assert transport.receive(0.2) == []
    assert there.receive() == [b"x" * 20]


def test_cut_loses_all_but_the_exempt() -> None:
    bad = Bad()
    bad.transport.set(LinkFaults(cut=True))
    assert bad.link.send(imu(1), dialect.MAVLink_xitl_tick_message(9, 1), imu(2))
    assert bad.stamps() == [9]
    assert bad.transport.lost == 2
    bad.transport.set(LinkFaults())
    bad.link.send(imu(3))
    assert bad.stamps() == [3]
    assert bad.other.counters.lost == 1  # the second; the first was before any that was heard


def test_the_exempt_overtake_what_is_delayed() -> None:
    bad = Bad()
    bad.transport.set(LinkFaults(delay_s=1.0))
    bad.link.send(imu(1), dialect.MAVLink_xitl_tick_message(9, 1))
    assert bad.stamps() == [9]
    bad.now_s = 1.0
    assert bad.stamps() == [1]


def test_what_was_delayed_keeps_its_time_and_what_follows_stays_behind() -> None:
    bad = Bad()
    bad.transport.set(LinkFaults(delay_s=1.0))
    bad.link.send(imu(1))
    bad.transport.set(LinkFaults())
    bad.link.send(imu(2), imu(3))
    assert bad.stamps() == []
    bad.now_s = 1.0
    assert bad.stamps() == [1, 2, 3]
    bad.link.send(imu(4), imu(5))
    assert len(bad.there.receive()) == 1  # frames share chunks again


def test_what_is_delayed_is_bounded_and_the_oldest_is_lost() -> None:
    bad = Bad()
    bad.transport.set(LinkFaults(delay_s=1.0))
    for number in range(MOST_DELAYED + 10):
        bad.link.send(imu(number + 1))
    assert bad.transport.lost == 10
    bad.now_s = 1.0
    assert bad.stamps() == [*range(11, MOST_DELAYED + 11)]


def test_what_the_line_does_not_take_after_its_delay_is_lost() -> None:
    bad = Bad(capacity=2)
    bad.transport.set(LinkFaults(delay_s=1.0))
    for number in range(5):
        bad.link.send(imu(number + 1))
    bad.now_s = 1.0
    assert bad.stamps() == [1, 2]
    assert bad.transport.lost == 3
    bad.link.send(imu(9))
    bad.transport.close()
    assert bad.transport.lost == 4


FAULTS = st.builds(
    LinkFaults,
    delay_s=st.sampled_from([0.0, 0.01, 0.3]),
    jitter_s=st.sampled_from([0.0, 0.02]),
    loss=st.sampled_from([0.0, 0.3]),
    duplicate=st.sampled_from([0.0, 0.3]),
    reorder=st.sampled_from([0.0, 0.5]),
    cut=st.booleans(),
)
STEPS = st.lists(st.one_of(FAULTS, st.integers(1, 20), st.just("time passes")), max_size=40)


def play(steps: list[Any], seed: int) -> tuple[list[int], ImpairedTransport, Link]:
    bad = Bad()
    arrived: list[int] = []
    stamp = 0
    for step in steps:
        if isinstance(step, LinkFaults):
            bad.transport.set(step, seed)
        elif isinstance(step, int):
            for _ in range(step):
                stamp += 1
                bad.link.send(imu(stamp))
        else:
            bad.now_s += 0.005
        arrived += bad.stamps()
    bad.transport.set(LinkFaults(), seed)
    for _ in range(200):
        bad.now_s += 0.005
        arrived += bad.stamps()
    return arrived, bad.transport, bad.link


@pytest.mark.medium
@given(STEPS, st.integers(0, 5))
def test_accounts_balance_and_a_seed_repeats(steps: list[Any], seed: int) -> None:
    arrived, transport, link = play(steps, seed)
    assert len(arrived) - transport.duplicated + transport.lost == link.counters.sent
    assert set(arrived) <= set(range(1, link.counters.sent + 1))
    again, repeated, _ = play(steps, seed)
    assert again == arrived
    assert (repeated.lost, repeated.duplicated, repeated.reordered) == (
        transport.lost,
        transport.duplicated,
        transport.reordered,
    )


def test_the_same_faults_again_change_nothing_and_another_seed_does() -> None:
    def lost_of(seeds: list[int]) -> list[int]:
        bad = Bad()
        arrived: list[int] = []
        for number, seed in enumerate(seeds):
            bad.transport.set(LinkFaults(loss=0.5), seed)
            bad.link.send(imu(number + 1))
            arrived += bad.stamps()
        return arrived

    assert lost_of([7] * 200) == lost_of([7] * 200)
    assert lost_of([7] * 200) != lost_of([8] * 200)
    assert lost_of([7] * 200) not in ([], [*range(1, 201)])  # set again with each frame, and yet not all alike


def test_without_faults_it_is_the_transport_below() -> None:
    inner, there = memory_pair()
    transport: Transport = ImpairedTransport(inner)
    assert transport.send(b"one") and transport.send(b"two")  # noqa: PT018
    assert there.receive() == [b"one", b"two"]
    there.send(b"back")
    assert transport.receive(1.0) == [b"back"]
    assert (transport.address, transport.peer, transport.name) == (inner.address, inner.peer, "memory")
    assert (transport.datagram_bytes, transport.capacity_bps) == (inner.datagram_bytes, None)
    assert (transport.fileno(), transport.wake_s(), transport.backlog_s()) == (None, None, 0.0)
    assert isinstance(vars(transport)["inner"], MemoryTransport)


def test_it_has_no_url() -> None:
    from urllib.parse import urlsplit

    with pytest.raises(BadUrlError, match="ImpairedTransport has no URL"):
        ImpairedTransport.open(urlsplit("bad://x"), True)
