"""A slow line under a clock of ours: who goes first, what waits, what is given up."""

from __future__ import annotations

from collections import deque
from typing import Any
from urllib.parse import SplitResult

import pytest
from messages import imu

from agent.wire import dialect
from agent.wire.codec import MessageRefusedError
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from agent.wire.priority import FULL_S, MOST_URGENT, MOST_WAITING
from agent.wire.signing import Signing
from agent.wire.transport import Transport


class SlowLine(Transport):
    """Carries 1000 bytes a second to a link of its own, and takes at most `room` sends."""

    name = "slow"
    datagram_bytes = 0
    capacity_bps = 1000.0

    def __init__(self) -> None:
        super().__init__("slow://")
        self.now_s = 0.0
        self.free_at_s = 0.0
        self.room = 10**9
        self.chunks: list[bytes] = []
        self.incoming: deque[bytes] = deque()

    @classmethod
    def open(cls, url: SplitResult, listen: bool) -> SlowLine:
        raise NotImplementedError

    def send(self, data: bytes) -> bool:
        if self.room <= 0:
            return False
        self.room -= 1
        self.free_at_s = max(self.free_at_s, self.now_s) + len(data) / 1000.0
        self.chunks.append(data)
        return True

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        self.now_s += max(timeout_s, 0.0)
        chunks = [*self.incoming]
        self.incoming.clear()
        return chunks

    def backlog_s(self) -> float:
        return max(self.free_at_s - self.now_s, 0.0)

    def fileno(self) -> None:
        return None

    def close(self) -> None:
        pass


def attitude(number: int = 0) -> Any:
    return dialect.MAVLink_attitude_message(number, 1, 2, 3, 4, 5, 6)


def actuators(number: int = 1) -> Any:
    return dialect.MAVLink_xitl_actuators_message(number, 2, 3, 4, [0.5] * 8, 2, 1)


def tick(number: int) -> Any:
    return dialect.MAVLink_xitl_tick_message(1, number)


def run(command: int) -> Any:
    return dialect.MAVLink_xitl_run_message(0, b"r", command, 1, 2)


def read(line: SlowLine) -> list[Any]:
    """What has gone out, as the other end reads it; its numbers have no gaps."""
    here, there = memory_pair()
    link = Link(there, 9, 9)
    for chunk in line.chunks:
        here.send(chunk)
    messages = link.receive()
    assert link.counters.lost == link.counters.dropped == 0
    return messages


def names(line: SlowLine) -> list[str]:
    return [message.get_type() for message in read(line)]


def drain(link: Link, line: SlowLine) -> None:
    """Let time pass until nothing waits."""
    while (wake_s := link.wake_s()) is not None:
        line.now_s += wake_s
        link.receive()


@pytest.fixture
def line() -> SlowLine:
    return SlowLine()


def test_what_cannot_wait_overtakes_and_leaves_no_gap(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    for number in range(5):
        assert link.send(attitude(number))
    assert names(line) == ["ATTITUDE"]  # 40 ms of a line that is full at 5
    assert link.send(attitude(5), actuators(), imu())
    assert names(line) == ["ATTITUDE", "XITL_ACTUATORS", "XITL_IMU"]
    drain(link, line)
    arrived = read(line)
    assert [message.time_boot_ms for message in arrived if message.get_type() == "ATTITUDE"] == [*range(6)]
    assert [message.get_seq() for message in arrived] == [*range(8)]
    assert (link.counters.sent, link.counters.unsent) == (8, 0)


def test_the_line_never_holds_more_of_what_can_wait_than_said(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    most_s = 0.0
    frame_s = 0.040
    for number in range(300):
        link.send(attitude(number))
        most_s = max(most_s, line.backlog_s())
        line.now_s += 0.003
        link.receive()
    assert most_s <= FULL_S + frame_s


def test_what_waits_is_bounded_and_the_oldest_is_given_up(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    sent = [link.send(attitude(number)) for number in range(MOST_WAITING + 50)]
    assert sent == [True] * (MOST_WAITING + 1) + [False] * 49
    assert link.counters.unsent == 49
    drain(link, line)
    kept = [message.time_boot_ms for message in read(line)]
    assert kept == [0, *range(50, MOST_WAITING + 50)]
    assert link.counters.sent + link.counters.unsent == MOST_WAITING + 50


def test_what_a_line_does_not_take_waits_and_the_urgent_goes_first(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    line.room = 0
    assert link.send(attitude(1))
    assert link.send(actuators())
    assert link.send(imu())
    assert (link.counters.sent, link.counters.unsent) == (0, 0)
    wake_s = link.wake_s()
    assert wake_s is not None
    assert wake_s > 0.0
    line.room = 10
    link.receive()
    assert names(line) == ["XITL_ACTUATORS", "XITL_IMU"]
    drain(link, line)
    assert names(line) == ["XITL_ACTUATORS", "XITL_IMU", "ATTITUDE"]
    assert [message.get_seq() for message in read(line)] == [0, 1, 2]


def test_of_the_urgent_only_the_newest_wait(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    line.room = 0
    sent = [link.send(imu(number + 1)) for number in range(100)]
    assert sent == [True] * MOST_URGENT + [False] * (100 - MOST_URGENT)
    assert link.counters.unsent == 100 - MOST_URGENT
    line.room = 100
    drain(link, line)
    assert [message.time_usec for message in read(line)] == [*range(101 - MOST_URGENT, 101)]


@pytest.mark.medium
def test_receive_sends_on_while_it_waits(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    link.send(*[attitude(number) for number in range(4)])
    before_s = line.now_s
    link.receive(0.1)  # of the clock on the wall, of which next to nothing passes here
    assert names(line) == ["ATTITUDE"] * 4
    assert line.now_s - before_s > 0.09
    assert link.wake_s() is None


def test_a_wrong_field_is_refused_at_once_and_nothing_is_sent(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    with pytest.raises(MessageRefusedError, match="ATTITUDE: a field does not fit the wire"):
        link.send(actuators(), attitude(-1))
    assert line.chunks == []
    link.send(actuators())
    assert [message.get_seq() for message in read(line)] == [0]


def test_a_message_goes_out_as_it_was_when_it_was_sent(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    message = attitude(1)
    link.send(attitude(0), message)
    message.time_boot_ms = 99
    drain(link, line)
    assert [message.time_boot_ms for message in read(line)] == [0, 1]


@pytest.mark.parametrize("how", ["sent", "received"])
def test_in_lockstep_everything_goes_in_order(line: SlowLine, how: str) -> None:
    """A tick says that all before it was sent; who has heard one answers in order, too."""
    link = Link(line, 1, 1)
    if how == "received":
        here, there = memory_pair()
        Link(here, 2, 1).send(tick(1))
        line.incoming.extend(there.receive())
        assert [message.tick for message in link.receive()] == [1]
        link.send(attitude(1), attitude(2), actuators())
        assert names(line) == ["ATTITUDE", "ATTITUDE", "XITL_ACTUATORS"]
    else:
        link.send(attitude(1), attitude(2), attitude(3), imu(), tick(1))
        assert names(line) == ["XITL_IMU", "ATTITUDE", "ATTITUDE", "ATTITUDE", "XITL_TICK"]
        link.send(attitude(4), imu(), tick(2))
        assert names(line)[5:] == ["ATTITUDE", "XITL_IMU", "XITL_TICK"]
    link.send(run(dialect.XITL_RUN_COMMAND_STOP), attitude(5), attitude(6), imu())
    assert names(line)[-2:] == ["XITL_RUN", "XITL_IMU"]


def test_an_order_that_finds_no_room_waits_for_it_in_lockstep(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    link.send(tick(1))
    line.room = 1
    assert link.send(attitude(1), imu(), tick(2))
    assert names(line) == ["XITL_TICK", "ATTITUDE"]
    line.room = 9
    link.receive(0.01)
    assert names(line) == ["XITL_TICK", "ATTITUDE", "XITL_IMU", "XITL_TICK"]


def test_what_waits_is_signed_when_it_goes(line: SlowLine) -> None:
    key = bytes(range(32))
    link = Link(line, 1, 1, signing=Signing(key, lambda: 40_000_000_000_000))
    link.send(*[attitude(number) for number in range(5)], actuators())
    drain(link, line)
    here, there = memory_pair()
    for chunk in line.chunks:
        here.send(chunk)
    other = Link(there, 9, 9, signing=Signing(key, lambda: 40_000_000_000_000))
    assert len(other.receive()) == 6
    assert other.counters.refused == 0


def test_reset_counters_counts_what_still_waits_as_of_now(line: SlowLine) -> None:
    link = Link(line, 1, 1)
    link.send(*[attitude(number) for number in range(3)])
    link.reset_counters()
    drain(link, line)
    assert (link.counters.sent, link.counters.unsent) == (2, 0)
