"""Messages over a transport: counters, signatures, senders of their own."""

from __future__ import annotations

import io
import math
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages import imu
from pymavlink.dialects.v20 import common

from agent.wire import dialect
from agent.wire import dialect as mav
from agent.wire.codec import MessageRefusedError, Packer, decode
from agent.wire.link import DATAGRAM_BYTES, SENDERS, Link, SequenceMonitor
from agent.wire.memory import memory_pair
from agent.wire.transport import SenderStatus, Transport, open_transport


def links(capacity: int = 4096) -> tuple[Link, Link]:
    here, there = memory_pair(capacity=capacity)
    return Link(here, 1, 1), Link(there, 2, 1)


def test_messages_arrive_in_order_with_sender_and_sequence() -> None:
    here, there = links()
    assert here.send(imu(5), dialect.MAVLink_xitl_tick_message(5, 1))
    assert here.send(dialect.MAVLink_xitl_tick_message(6, 2))
    got = there.receive()
    assert [message.get_type() for message in got] == ["XITL_IMU", "XITL_TICK", "XITL_TICK"]
    assert [message.get_seq() for message in got] == [0, 1, 2]
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in got} == {(1, 1)}
    assert got[0].gyro == pytest.approx([0.1, -0.2, 0.3], abs=1e-7)
    assert there.receive() == []


def test_several_frames_share_datagrams_of_limited_size() -> None:
    here, there = memory_pair()
    link = Link(here, 1, 1)
    assert link.send(*[imu(index + 1) for index in range(100)])
    chunks = there.receive()
    frame_bytes = link.counters.bytes_out // 100
    assert len(chunks) == math.ceil(100 / (DATAGRAM_BYTES // frame_bytes))
    assert max(len(chunk) for chunk in chunks) <= DATAGRAM_BYTES
    other = Link(there, 2, 1)
    for chunk in chunks:
        assert here.send(chunk)
    assert [message.time_usec for message in other.receive()] == [*range(1, 101)]


def test_taps_see_every_good_frame_raw() -> None:
    here, there = memory_pair()
    seen: list[tuple[str, bytes]] = []
    link = Link(here, 1, 1, tap=lambda direction, frame: seen.append((direction, frame)))
    echo = Link(there, 2, 1, tap=lambda direction, frame: seen.append((direction, frame)))
    link.send(imu(1), imu(2))
    here.send(b"junk")
    echo.receive()
    assert [direction for direction, _ in seen] == ["tx", "tx", "rx", "rx"]
    assert seen[0][1] == seen[2][1]
    assert seen[1][1] == seen[3][1]
    assert echo.counters.dropped == echo.counters.dropped_noise == 1


def test_what_the_transport_does_not_take_is_no_gap() -> None:
    here, there = links(capacity=3)
    sent = [here.send(imu(index + 1)) for index in range(5)]
    assert sent == [True, True, True, False, False]
    assert len(there.receive()) == 3
    assert not here.send(*[imu(index + 1) for index in range(200)])  # needs more datagrams than there is room for
    there.receive()
    assert here.send(imu(1))
    there.receive()
    assert here.counters.sent == there.counters.received
    assert here.counters.sent + here.counters.unsent == 5 + 200 + 1
    assert there.counters.lost == 0


def test_a_refused_message_sends_nothing_of_its_batch() -> None:
    here, there = links()
    with pytest.raises(MessageRefusedError):
        here.send(imu(), dialect.MAVLink_xitl_tick_message(-1, 0))
    assert there.receive() == []
    here.send(imu())
    assert [message.get_seq() for message in there.receive()] == [0]


def test_counters_add_up_over_a_bad_network() -> None:
    rng = random.Random(11)
    here, wire_in = memory_pair()
    wire_out, there = memory_pair()
    sender, receiver = Link(here, 1, 1), Link(there, 2, 1)
    vanished = damaged = repeated = 0
    for index in range(3000):
        sender.send(imu(index + 1))
        for chunk in wire_in.receive():
            fate = rng.random() if index not in (0, 2999) else 1.0
            if fate < 0.02:
                vanished += 1
            elif fate < 0.04:
                damaged += 1
                wire_out.send(chunk[:30] + bytes([chunk[30] ^ 0x10]) + chunk[31:])
            elif fate < 0.06:
                repeated += 1
                wire_out.send(chunk + chunk)
            else:
                wire_out.send(chunk)
        receiver.receive()
    counters = receiver.counters
    assert sender.counters.sent == 3000
    assert counters.lost == vanished + damaged
    assert counters.dropped == counters.dropped_bad_crc == damaged
    assert counters.repeated == repeated
    assert counters.received - counters.repeated + counters.lost == 3000
    assert min(vanished, damaged, repeated) > 20


def test_reset_counters_starts_a_new_account() -> None:
    here, there = links()
    here.send(imu())
    there.receive()
    for _ in range(3):
        here.send(imu())
    there.transport.receive()  # three frames vanish
    there.reset_counters()
    here.send(imu())
    there.receive()
    assert (there.counters.received, there.counters.lost) == (1, 0)
    here.reset_counters()
    assert here.counters.sent == here.counters.bytes_out == 0


class Credits(Transport):
    """A transport that plays back chunks and notes whom the link credits."""

    learns_peer = True

    def __init__(self, chunks: list[bytes]) -> None:
        super().__init__("credits://")
        self.chunks = chunks
        self.noted: list[tuple[int, SenderStatus]] = []

    @classmethod
    def open(cls, url: Any, listen: bool) -> Credits:
        raise NotImplementedError

    def send(self, data: bytes) -> bool:
        return True

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        return self.chunks

    def fileno(self) -> None:
        return None

    def close(self) -> None:
        pass

    def accept_sender(self, index: int, standing: SenderStatus) -> bool:
        self.noted.append((index, standing))
        return True


def run_message(command: int) -> Any:
    return dialect.MAVLink_xitl_run_message(0, b"r", command, 0, 1)


def test_only_good_frames_earn_credit_and_runs_claim_the_link() -> None:
    here, there = memory_pair()
    sender = Link(here, 1, 1)
    for command in (
        dialect.XITL_RUN_COMMAND_START,
        dialect.XITL_RUN_COMMAND_HELLO,
        dialect.XITL_RUN_COMMAND_STOP,
    ):
        sender.send(imu(), run_message(command))
    sender.send(imu())
    good = there.receive()
    transport = Credits([b"garbage", *good, good[0][:-1]])
    Link(transport, 2, 1).receive()
    assert transport.noted[:4] == [
        (1, SenderStatus.STARTS),
        (2, SenderStatus.HEARD),
        (3, SenderStatus.LEAVES),
        (4, SenderStatus.HEARD),
    ]


def test_over_udp_a_second_host_changes_neither_the_run_of_the_first_nor_its_counts() -> None:
    """Both count their frames by themselves, under the same system: mixed, each would make gaps for the other."""
    listening = open_transport("udp://127.0.0.1:0", listen=True)
    first = open_transport(listening.address, listen=False)
    second = open_transport(listening.address, listen=False)
    with listening, first, second:
        agent, host, stranger = Link(listening, 1, 1), Link(first, 255, 190), Link(second, 255, 190)
        heard: list[Any] = []
        for number in range(10):
            host.send(imu())
            heard += agent.receive(5.0)
            if number % 3 == 0:
                stranger.send(run_message(dialect.XITL_RUN_COMMAND_HELLO), run_message(dialect.XITL_RUN_COMMAND_STOP))
                heard += agent.receive(5.0)
        counters = agent.counters
        assert {message.get_msgId() for message in heard} == {dialect.MAVLINK_MSG_ID_XITL_IMU}
        assert (counters.received, counters.lost, counters.late) == (10, 0, 0)
        assert (counters.strangers, counters.dropped) == (8, 8)
        assert agent.send(imu())
        assert host.receive(5.0)
        assert stranger.receive() == []


def test_over_udp_the_listener_answers_the_one_who_speaks_the_dialect() -> None:
    listening = open_transport("udp://127.0.0.1:0", listen=True)
    calling = open_transport(listening.address, listen=False)
    noisy = open_transport(listening.address, listen=False)
    with listening, calling, noisy:
        agent, host = Link(listening, 1, 1), Link(calling, 2, 1)
        noisy.send(b"\xfd garbage")
        agent.receive(5.0)
        assert listening.peer == ""
        host.send(imu())
        assert agent.receive(5.0)
        noisy.send(b"more garbage")
        agent.receive(5.0)
        assert agent.send(dialect.MAVLink_xitl_tick_message(1, 1))
        assert [message.get_type() for message in host.receive(5.0)] == ["XITL_TICK"]
        assert agent.counters.dropped == 2


def heard_from(system_id: int, component_id: int, count: int) -> list[object]:
    packer = Packer(system_id, component_id)
    return [decode(packer.pack(mav.MAVLink_heartbeat_message(11, 0, 0, 0, 4, 3))) for _ in range(count)]


def test_pymavlink_sees_each_sender_with_a_sequence_of_its_own() -> None:
    here, there = memory_pair()
    link = Link(here, 255, 190)
    link.send(mav.MAVLink_system_time_message(0, 0))
    link.pass_on(*heard_from(1, 1, 3), *heard_from(1, 191, 2))
    link.send(mav.MAVLink_system_time_message(0, 0))
    reader = common.MAVLink(io.BytesIO())
    messages = [message for chunk in there.receive() for message in reader.parse_buffer(chunk) or ()]
    seen = [(m.get_srcSystem(), m.get_srcComponent(), m.get_seq()) for m in messages]
    assert seen == [(255, 190, 0), (1, 1, 0), (1, 1, 1), (1, 1, 2), (1, 191, 0), (1, 191, 1), (255, 190, 1)]
    assert link.counters.sent == 7


def test_the_receiver_counts_no_loss_between_senders() -> None:
    here, there = memory_pair()
    link, other = Link(here, 255, 190), Link(there, 1, 191)
    for _ in range(3):
        link.send(mav.MAVLink_system_time_message(0, 0))
        link.pass_on(*heard_from(1, 1, 1))
    assert len(other.receive()) == 6
    assert other.counters.lost == 0


def heard(numbers: list[int]) -> SequenceMonitor:
    monitor = SequenceMonitor()
    for number in numbers:
        monitor.note(1, 1, number & 0xFF)
    return monitor


def counts(monitor: SequenceMonitor) -> tuple[int, int, int]:
    return monitor.lost, monitor.late, monitor.repeated


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        (list(range(1000)), (0, 0, 0)),
        ([17, 18, 19], (0, 0, 0)),  # a sender may start anywhere
        ([0, 1, 4, 5], (2, 0, 0)),
        ([254, 255, 2], (2, 0, 0)),
        ([0, 1, 1, 2], (0, 0, 1)),
        ([0, 2, 1, 3], (0, 1, 0)),
        ([0, 2, 1, 1, 3], (0, 1, 1)),
        ([255, 1, 0, 2], (0, 1, 0)),
        ([0, 128], (127, 0, 0)),
        ([0, 3, 2, 1, 0], (0, 2, 1)),
    ],
)
def test_small_cases(numbers: list[int], expected: tuple[int, int, int]) -> None:
    assert counts(heard(numbers)) == expected


@pytest.mark.parametrize(("shares_numbers", "lost"), [(True, 0), (False, 255)])
def test_a_number_that_two_threads_of_a_sender_use_is_no_loss(shares_numbers: bool, lost: int) -> None:
    """PX4 reads and increments its number before it locks the line."""
    monitor = SequenceMonitor(shares_numbers)
    for number, check in ((4, b"a"), (5, b"b"), (5, b"c"), (6, b"d"), (7, b"e")):
        monitor.note(1, 1, number, check)
    assert counts(monitor) == (lost, 0, 0)


def test_a_number_lost_long_ago_is_not_taken_back() -> None:
    numbers = [0, *range(2, 200), 1 + 256]  # 1 is lost; 257 has the same number on the wire, 57 ahead of 200
    monitor = heard(numbers)
    assert counts(monitor) == (1 + 57, 0, 0)


@pytest.mark.medium
@given(
    st.lists(st.sampled_from(["sent", "lost", "repeated"]), min_size=1, max_size=2000),
    st.integers(0, 255),
    st.integers(0, 2**32),
)
def test_frames_add_up_over_a_lossy_repeating_and_reordering_channel(kinds: list[str], first: int, seed: int) -> None:
    """At most 60 lost in a row and shifts of at most 20 places: within what numbers modulo 256 can tell."""
    rng = random.Random(seed)
    numbers: list[int] = []
    lost = repeated = in_a_row = 0
    for index, kind in enumerate(kinds):
        in_a_row = in_a_row + 1 if kind == "lost" else 0
        if kind == "lost" and in_a_row <= 60:
            lost += 1
            continue
        numbers += [first + index] * (2 if kind == "repeated" else 1)
        repeated += kind == "repeated"
    if not numbers:
        return
    lost -= numbers[0] - first  # before the first and after the last nobody can know
    lost -= first + len(kinds) - 1 - numbers[-1]
    middle = sorted(numbers[1:-1], key=lambda number: number + rng.uniform(0.0, 20.0))
    monitor = heard([numbers[0], *middle, *numbers[1:][-1:]])
    assert monitor.lost == lost
    assert monitor.repeated == repeated


@pytest.mark.parametrize("in_a_row", [1, 127, 128, 150, 200, 223, 224, 255, 256, 257, 300, 511, 512, 1000])
@pytest.mark.parametrize("twice", [False, True])
def test_nothing_is_taken_for_repeated_that_was_not(in_a_row: int, twice: bool) -> None:
    """However many were lost in a row; what did come twice is told by its check value."""
    monitor = SequenceMonitor()
    for number in [*range(300), *range(300 + in_a_row, 700 + in_a_row)]:
        for _ in range(1 + twice):
            monitor.note(1, 1, number & 0xFF, number.to_bytes(2, "little"))
    assert monitor.repeated == 700 * twice
    if in_a_row < 256:
        assert counts(monitor) == (in_a_row, 0, 700 * twice)


@pytest.mark.parametrize("in_a_row", [150, 230, 250])
def test_a_late_frame_of_many_that_were_lost_is_not_lost(in_a_row: int) -> None:
    monitor = SequenceMonitor()
    for number in [*range(300), 300 + in_a_row, 300 + in_a_row - 5, *range(301 + in_a_row, 700)]:
        monitor.note(1, 1, number & 0xFF, number.to_bytes(2, "little"))
    assert counts(monitor) == (in_a_row - 1, 1, 0)


Stretch = tuple[int, int, bool]


@pytest.mark.medium
@given(
    stretches=st.lists(st.tuples(st.integers(0, 1500), st.integers(1, 300), st.booleans()), max_size=12),
    first=st.integers(0, 100_000),
    under_way=st.integers(0, 100),
    seed=st.integers(0, 2**32),
)
def test_totals_of_the_sender_decide_how_many_rounds_were_lost(
    stretches: list[Stretch], first: int, under_way: int, seed: int
) -> None:
    """Any number lost, then some that arrive, shifted by less than 20 places and a tenth of them twice; maybe a total.

    `under_way`: the totals are by so many too low, always. A number that comes again while it is missing may be late or
    of the next round, which the numbers after it tell.
    """
    rng = random.Random(seed)
    monitor = SequenceMonitor()
    number, received, lost = first, 0, 0

    def arrive(frames: int) -> None:
        nonlocal number, received
        sent = range(number, number + frames)
        shifted = sorted(sent, key=lambda each: each + rng.uniform(0.0, 20.0))
        for each in [*sent[:1], *(each for each in shifted if each != number)]:
            for _ in range(1 + (rng.random() < 0.1)):
                monitor.note(1, 1, each & 0xFF, each.to_bytes(4, "little"))
                received += 1
        number += frames

    arrive(50)
    monitor.heard_total(number - under_way, received)
    for missing, present, tells in stretches:
        number += missing
        lost += missing
        arrive(present)
        if tells:
            monitor.heard_total(number - under_way, received)
            assert monitor.lost == lost or present < 150
    arrive(150)
    monitor.heard_total(number - under_way, received)
    assert monitor.lost == lost
    assert received - monitor.repeated == number - first - lost


def test_who_sends_nothing_loses_nothing_and_who_begins_anew_little() -> None:
    monitor = SequenceMonitor()
    received = 0

    def arrive(numbers: range) -> None:
        nonlocal received
        for number in numbers:
            monitor.note(1, 1, number & 0xFF, number.to_bytes(4, "little"))
            received += 1

    arrive(range(1000))
    for _ in range(3):
        monitor.heard_total(1000, received)
    assert monitor.lost == 0
    arrive(range(1600, 2000))
    monitor.heard_total(2000, received)
    assert monitor.lost == 600
    arrive(range(100_000, 100_500))  # its numbers and totals from anywhere
    monitor.heard_total(500, received)
    assert 600 <= monitor.lost < 600 + 256
    before = monitor.lost
    arrive(range(101_000, 101_100))
    monitor.heard_total(1100, received)
    assert monitor.lost == before + 500


def test_a_frame_from_before_the_first_is_late_and_nothing_is_lost() -> None:
    monitor = SequenceMonitor()
    for number in [7, 5, 8, 6, 9]:
        monitor.note(1, 1, number, bytes([number]))
    assert counts(monitor) == (0, 2, 0)


def test_senders_are_counted_apart_and_forgotten_by_a_reset() -> None:
    monitor = SequenceMonitor()
    for sequence in range(10):
        monitor.note(1, 1, sequence)
        monitor.note(1, 2, sequence * 2)
    assert counts(monitor) == (9, 0, 0)
    monitor.reset()
    monitor.note(1, 1, 77)
    assert counts(monitor) == (0, 0, 0)


def test_invented_senders_take_bounded_memory() -> None:
    monitor = SequenceMonitor()
    for system in range(256):
        for component in range(4):
            monitor.note(system, component, 0)
    assert len(vars(monitor)["_senders"]) == SENDERS
