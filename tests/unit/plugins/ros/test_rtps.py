"""The wire of DDS: what is written is read again, and bytes from outside raise nothing."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros2 import own_domain

from tests.memory_size import size_bytes
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.plugins.ros import rtps, rtps_services
from xitl_cli.plugins.ros.rtps_services import MOST_AHEAD, MOST_ENDPOINTS, MOST_PARTICIPANTS, Received, RtpsServices

PREFIX, OTHER = bytes(range(12)), bytes(range(12, 24))
READER, WRITER = b"\0\0\1\4", b"\0\0\1\3"


def only_part(packet: bytes) -> tuple[bytes, rtps.Submessage]:
    found = rtps.read_packet(packet)
    assert found is not None
    assert found.prefix == PREFIX
    (part,) = found.parts
    return part


def test_data_is_read_as_written() -> None:
    payload, related = b"\0\1\0\0\1", (rtps.PID_RELATED, bytes(24))
    written = rtps.data(READER, WRITER, 2**33 + 5, payload, [related])
    destination, part = only_part(rtps.packet(PREFIX, [written], OTHER))
    assert destination == OTHER
    assert (part.reader, part.writer, part.first) == (READER, WRITER, 2**33 + 5)
    assert part.inline == dict([related])
    assert part.payload == payload + b"\0\0\0"


def test_what_is_missing_is_the_bits_of_an_acknack() -> None:
    _, part = only_part(rtps.packet(PREFIX, [rtps.acknack(READER, WRITER, 7, [7, 9, 40], 1)]))
    assert (part.first, part.numbers, part.final) == (7, (7, 9, 40), False)
    _, part = only_part(rtps.packet(PREFIX, [rtps.acknack(READER, WRITER, 7, [], 2)]))
    assert (part.first, part.numbers, part.final) == (7, (), True)


def test_an_acknack_is_laid_out_as_the_standard_has_it() -> None:
    """DDSI-RTPS 2.3, 9.4.2.6: the example 1234/12:00110 is base 1234, 12 bits, 1236 and 1237 missing."""
    body = rtps.acknack(READER, WRITER, 1234, [1236, 1237], 3)
    assert body[:4] == struct.pack("<BBH", rtps.ACKNACK, 1, 28)
    assert struct.unpack("<iIII", body[12:28]) == (0, 1234, 4, 0b0011 << 28)


def test_a_heartbeat_is_read_as_written() -> None:
    _, part = only_part(rtps.packet(PREFIX, [rtps.heartbeat(READER, WRITER, 1, 5, 9)]))
    assert (part.kind, part.first, part.last, part.final) == (rtps.HEARTBEAT, 1, 5, False)


def test_parameters_are_read_in_either_byte_order() -> None:
    little = rtps.PARAMETERS_LE + rtps.parameters([(rtps.PID_TOPIC, rtps.text("rq/armRequest"))])
    assert rtps.read_text(rtps.read_parameters(little)[rtps.PID_TOPIC][0]) == "rq/armRequest"
    big = b"\0\2\0\0" + struct.pack(">HHI4s", rtps.PID_TOPIC, 8, 4, b"abc\0") + struct.pack(">HH", 1, 0)
    assert rtps.read_text(rtps.read_parameters(big)[rtps.PID_TOPIC][0], rtps.number_order(big)) == "abc"


def test_a_locator_is_of_udp_over_ipv4() -> None:
    assert rtps.read_locator(rtps.locator("192.0.2.7", 7410)) == ("192.0.2.7", 7410)
    shared_memory = struct.pack("<iI16x", 16, 7410)
    assert rtps.read_locator(shared_memory) is None


@pytest.mark.parametrize("kind", [rtps.PAD, rtps.INFO_TIMESTAMP])
def test_a_submessage_without_a_body_is_not_the_last(kind: int) -> None:
    """DDSI-RTPS 2.3, 9.4.5.1.3: length 0 is to the end of the message, but for these two."""
    empty = struct.pack("<BBH", kind, 3, 0)
    _, part = only_part(rtps.packet(PREFIX, [empty, rtps.heartbeat(READER, WRITER, 1, 5, 9)]))
    assert (part.first, part.last) == (1, 5)


@pytest.mark.medium
@given(st.binary(max_size=200))
def test_bytes_from_outside_raise_nothing(noise: bytes) -> None:
    rtps.read_packet(noise)
    rtps.read_packet(b"RTPS\2\3\1\x0f" + PREFIX + noise)
    for kind in (rtps.DATA, rtps.HEARTBEAT, rtps.ACKNACK, rtps.GAP):
        rtps.read_packet(b"RTPS\2\3\1\x0f" + PREFIX + struct.pack("<BBH", kind, 7, len(noise)) + noise)


@pytest.mark.parametrize("order", [(1, 2, 3, 4), (4, 3, 2, 1), (2, 2, 1, 4)])
def test_samples_are_had_once_and_missing_ones_are_known(order: tuple[int, ...]) -> None:
    received = Received()
    assert [received.add(number) for number in order].count(True) == len(set(order))
    base, missing = received.missing(5)
    assert missing == sorted({1, 2, 3, 4, 5} - set(order))
    assert base == missing[0]
    received.skip_to(5)
    assert received.missing(5) == (5, [5])


def test_a_gap_is_not_asked_for_and_a_wide_one_takes_no_room() -> None:
    received = Received()
    received.skip(1, 2**62)
    assert received.missing(2**62) == (2**62, [2**62])
    received = Received()
    for start in range(10, 10**6, 100):
        received.skip(start, 2**62)
    assert received.missing(12) == (1, list(range(1, 10)))
    assert size_bytes(received) < 16 * rtps.MOST_BITS


def test_a_sample_far_ahead_is_had_once_and_those_far_behind_are_given_up() -> None:
    received = Received()
    assert received.add(10 * MOST_AHEAD)
    assert not received.add(10 * MOST_AHEAD)
    assert received.add(9 * MOST_AHEAD + 1)
    assert not received.add(9 * MOST_AHEAD)
    for number in range(10**6, 10**6 + 5 * MOST_AHEAD, 2):
        assert received.add(number)
    assert size_bytes(received) < 16 * MOST_AHEAD


ANNOUNCED = rtps.data(
    rtps.NO_ENTITY,
    rtps.SPDP_WRITER,
    1,
    rtps.PARAMETERS_LE + rtps.parameters([(rtps.PID_META_UNICAST, rtps.locator("127.0.0.1", 9))] * 100),
)


class Peer:
    """Another participant, by hand: `say` sends submessages as that of this prefix."""

    def __init__(self, services: RtpsServices) -> None:
        self._to = ("127.0.0.1", services.port)
        self._end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def say(self, *parts: bytes, prefix: bytes = PREFIX) -> None:
        with suppress(OSError):
            self._end.sendto(rtps.packet(prefix, parts), self._to)

    def close(self) -> None:
        self._end.close()


@pytest.fixture
def services() -> Iterator[RtpsServices]:
    made = RtpsServices(own_domain(), lambda request: None, local=True)
    yield made
    made.close()


@pytest.fixture
def peer(services: RtpsServices) -> Iterator[Peer]:
    made = Peer(services)
    yield made
    made.close()


def remote_of(services: RtpsServices) -> Any:
    wait_until(lambda: PREFIX in services.remotes)
    return services.remotes[PREFIX]


def test_who_has_more_endpoints_than_may_be_is_refused_and_counted(services: RtpsServices, peer: Peer) -> None:
    service = services.serve("/arm", "std_srvs/srv/SetBool")
    peer.say(ANNOUNCED)
    remote = remote_of(services)
    assert len(remote.meta) < 100
    for number in range(MOST_ENDPOINTS + 10):
        peer.say(rtps.data(service.reader, struct.pack(">I", number), 1, b"\0\1\0\0"))
        wait_until(lambda number=number: len(remote.received) + services.refused == number + 1)  # type: ignore[misc]
    assert len(remote.received) == MOST_ENDPOINTS


@pytest.mark.medium
def test_of_too_many_participants_who_was_not_heard_for_longest_is_forgotten(
    services: RtpsServices, peer: Peer
) -> None:
    for number in range(MOST_PARTICIPANTS + 5):
        prefix = struct.pack(">III", 1, 2, number)
        peer.say(ANNOUNCED, prefix=prefix)
        wait_until(lambda prefix=prefix: prefix in services.remotes)  # type: ignore[misc]
    assert len(services.remotes) == MOST_PARTICIPANTS
    assert services.refused == 5
    assert struct.pack(">III", 1, 2, 0) not in services.remotes


def test_an_acknack_from_before_the_first_sample_asks_for_no_more_than_there_is(
    services: RtpsServices, peer: Peer
) -> None:
    services.serve("/arm", "std_srvs/srv/SetBool")
    peer.say(ANNOUNCED)
    remote = remote_of(services)
    peer.say(rtps.acknack(rtps.PUBLICATIONS_READER, rtps.PUBLICATIONS_WRITER, -(2**62), [], 1))
    wait_until(lambda: rtps.PUBLICATIONS_WRITER in remote.acked)
    services.serve("/finish", "std_srvs/srv/Trigger")
    assert remote.acked[rtps.PUBLICATIONS_WRITER] == 0


def test_what_a_participant_asked_by_is_forgotten_with_it(services: RtpsServices, peer: Peer) -> None:
    service = services.serve("/arm", "std_srvs/srv/SetBool")
    peer.say(ANNOUNCED)
    remote = remote_of(services)
    values = [(rtps.PID_TOPIC, rtps.text(service.request_topic)), (rtps.PID_ENDPOINT_GUID, PREFIX + WRITER)]
    described = rtps.PARAMETERS_LE + rtps.parameters(values)
    peer.say(rtps.data(rtps.PUBLICATIONS_READER, rtps.PUBLICATIONS_WRITER, 1, described))
    wait_until(lambda: remote.requesters == {PREFIX + WRITER: service})
    gone = [(rtps.PID_STATUS, b"\0\0\0\3")]
    peer.say(rtps.data(rtps.NO_ENTITY, rtps.SPDP_WRITER, 2, b"", gone))
    wait_until(lambda: not services.remotes)


def test_a_known_participant_is_told_again_before_its_lease_ends(
    services: RtpsServices, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that hears no multicast, as nodes of ROS 2 that stay on this machine."""
    monkeypatch.setattr(rtps_services, "ANNOUNCED_S", (0.02, 0.02))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        end.settimeout(PATIENCE_S)
        place = rtps.locator("127.0.0.1", end.getsockname()[1])
        announced = rtps.PARAMETERS_LE + rtps.parameters([(rtps.PID_META_UNICAST, place)])
        peer.say(rtps.data(rtps.NO_ENTITY, rtps.SPDP_WRITER, 1, announced))
        heard = 0
        while heard < 5:
            packet = rtps.read_packet(end.recv(65536))
            assert packet is not None
            heard += sum(part.writer == rtps.SPDP_WRITER for _, part in packet.parts)


def test_on_this_machine_alone_only_multicast_comes_in_at_the_group_s_port(services: RtpsServices, peer: Peer) -> None:
    """That port is the same for all and takes packets of every interface."""
    other = b"\7" * rtps.PREFIX_BYTES
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.sendto(rtps.packet(other, [ANNOUNCED]), ("127.0.0.1", 7400 + 250 * own_domain()))
    peer.say(ANNOUNCED)
    remote_of(services)
    wait_until(lambda: services.announced > 3)
    assert other not in services.remotes
