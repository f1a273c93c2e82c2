"""One contract for every transport. A new transport is a row in `PAIRS` of transport_ends.py."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest
from transport_ends import LISTENING, PAIRS, Ends, largest, opened, send, take, take_bytes, tcp_pair, udp_pair

from agent.wire import dialect
from agent.wire.impaired import ImpairedTransport
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from agent.wire.tcp import TcpAccepted, TcpListener
from agent.wire.transport import (
    DATAGRAM_BYTES,
    AddressInUseError,
    AddressUnavailableError,
    BadUrlError,
    DatagramTooLongError,
    SenderStatus,
    TransportClosedError,
    UnknownHostError,
    open_transport,
)
from tests.golden import Golden
from tests.patience import PATIENCE_S, wait_until


@pytest.fixture(params=PAIRS)
def pair(request: pytest.FixtureRequest) -> Iterator[Ends]:
    """A listening end that knows its peer, and that peer."""
    with opened:
        listening, calling = PAIRS[request.param]()
        with listening, calling:
            assert calling.send(b"hello")
            assert take_bytes(listening, 5) == b"hello"
            yield listening, calling


def status(text: bytes) -> dialect.MAVLink_statustext_message:
    return dialect.MAVLink_statustext_message(dialect.MAV_SEVERITY_INFO, text, 0, 0)


def test_back_to_back_in_both_directions(pair: Ends) -> None:
    for there, here in (pair, pair[::-1]):
        for payload in (b"\x00", b"\xfd" * 20, bytes(range(256))):
            assert here.send(payload)
            if here.stream:
                assert take_bytes(there, len(payload)) == payload
            else:
                assert take(there, 1, sender=here) == [payload]


def test_order_is_kept(pair: Ends) -> None:
    listening, calling = pair
    sent = [index.to_bytes(2, "big") for index in range(200)]
    for chunk in sent:
        send(calling, chunk)
    assert take_bytes(listening, 400, calling) == b"".join(sent)


def test_nothing_there_returns_at_once_or_after_the_timeout(pair: Ends) -> None:
    for end in pair:
        assert end.receive() == []
        assert end.receive(-1.0) == []
        assert end.receive(0.01) == []
        for wait_s in (1e-9, 1e-7, 1e-6, 1e-5) * 200:  # shorter than it takes to look at the clock
            assert end.receive(wait_s) == []


def test_a_waiting_receive_is_woken_by_bytes(pair: Ends) -> None:
    listening, calling = pair
    timer = threading.Timer(0.05, calling.send, (b"l",))
    before_s = time.monotonic()
    timer.start()
    assert listening.receive(PATIENCE_S) == [b"l"]
    assert time.monotonic() - before_s < PATIENCE_S  # not by the timeout
    timer.join()


def test_a_full_datagram_arrives_whole(pair: Ends) -> None:
    listening, calling = pair
    payload = (bytes(range(256)) * 250)[: largest(calling)]
    assert calling.send(payload)
    assert take_bytes(listening, len(payload), calling) == payload


@pytest.mark.slow
def test_queues_are_bounded_and_losses_do_not_raise(pair: Ends) -> None:
    listening, calling = pair
    payload = bytes(min(4000, largest(calling)))
    taken = sum(calling.send(payload) for _ in range(5000))
    arrived = listening.receive(PATIENCE_S)
    while chunks := listening.receive(0.05):
        arrived += chunks
    assert 0 < len(arrived) < 5000
    assert calling.unsent > 0 or "udp" in calling.address
    data = b"".join(arrived)
    until_s = time.monotonic() + PATIENCE_S
    while not data.endswith(b"again"):  # who did not read has lost bytes of a line, and its frames with them
        assert time.monotonic() < until_s
        calling.send(b"again")
        for _ in range(20):
            calling.receive()
            data += b"".join(listening.receive(0.001))
    assert calling.lossless == (calling.name in {"memory", "pair", "tcp"})
    if calling.lossless:
        assert len(data) - data.count(b"again") * 5 == taken * len(payload)


def test_close_is_final_and_can_be_repeated(pair: Ends) -> None:
    for end in pair:
        end.close()
        end.close()
        assert end.fileno() is None
        with pytest.raises(TransportClosedError, match="the transport is closed; open it again"):
            end.send(b"x")
        with pytest.raises(TransportClosedError):
            end.receive()


def test_ends_have_names_for_people(pair: Ends) -> None:
    for end in pair:
        assert end.address.startswith(f"{end.name}://")
        assert end.peer.startswith(f"{end.name}://")


def test_the_descriptor_if_any_is_readable_with_bytes(pair: Ends) -> None:
    listening, calling = pair
    descriptor = listening.fileno()
    if descriptor is None:
        return
    assert select.select([descriptor], [], [], 0.0)[0] == []
    calling.send(b"x")
    assert select.select([descriptor], [], [], PATIENCE_S)[0] == [descriptor]


@pytest.mark.parametrize("scheme", LISTENING)
def test_an_address_in_use_is_said_in_one_sentence(scheme: str, golden: Golden) -> None:
    with open_transport(LISTENING[scheme], listen=True) as first:
        with pytest.raises(AddressInUseError) as caught:
            open_transport(first.address, listen=True)
        golden("error", caught.value, address=first.address)
    open_transport(first.address, listen=True).close()


@pytest.mark.medium
@pytest.mark.parametrize("scheme", LISTENING)
def test_a_restarted_listener_is_reached_again(scheme: str) -> None:
    listening = open_transport(LISTENING[scheme], listen=True)
    with open_transport(listening.address, listen=False) as calling:
        listening.close()
        for _ in range(4):  # refusals come back as errors of a later call; none may surface
            calling.send(b"nobody")
            assert calling.receive(0.01) == []
        with open_transport(listening.address, listen=True) as again:
            while not calling.send(b"here"):
                pass
            assert take(again, 1)[-1] == b"here"
            assert again.send(b"welcome back")
            assert calling.receive(PATIENCE_S) == [b"welcome back"]


@pytest.mark.parametrize("scheme", LISTENING)
def test_without_a_peer_nothing_is_sent_and_that_is_counted(scheme: str) -> None:
    with open_transport(LISTENING[scheme], listen=True) as listening:
        assert listening.peer == ""
        assert not listening.send(b"to whom?")
        assert listening.unsent == 1


def test_a_full_memory_queue_refuses_and_counts() -> None:
    here, there = memory_pair(capacity=2)
    assert [here.send(b"1"), here.send(b"2"), here.send(b"3")] == [True, True, False]
    assert here.unsent == 1
    assert there.receive() == [b"1", b"2"]
    with pytest.raises(ValueError, match="capacity = 0"):
        memory_pair(capacity=0)


class Strangers:
    """A listener under a clock of ours, its peer, and somebody else."""

    def __init__(self) -> None:
        from agent.wire.udp import UdpTransport

        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setblocking(False)
        sock.bind(("127.0.0.1", 0))
        self.now_s = 100.0
        self.url = f"udp://127.0.0.1:{sock.getsockname()[1]}"
        self.listening = UdpTransport(sock, self.url, listen=True, clock_s=lambda: self.now_s)
        self.host = open_transport(self.url, listen=False)
        self.stranger = open_transport(self.url, listen=False)
        self.host.send(b"good")
        take(self.listening, 1)

    def answered(self) -> list[bool]:
        """Whether host and stranger get an answer. One of them does."""
        self.listening.send(b"answer")
        heard = [False, False]

        def came() -> bool:
            heard[:] = [bool(self.host.receive()), bool(self.stranger.receive())]
            return any(heard)

        wait_until(came)
        return heard


@pytest.fixture
def strangers() -> Iterator[Strangers]:
    made = Strangers()
    with made.listening, made.host, made.stranger:
        yield made


def test_udp_garbage_never_moves_the_peer(strangers: Strangers) -> None:
    strangers.now_s += 3600.0
    strangers.stranger.send(b"garbage")
    assert strangers.listening.receive(PATIENCE_S) == [b"garbage"]  # a link credits no datagram without a good frame
    assert strangers.answered() == [True, False]


def test_udp_a_second_sender_does_not_take_the_answers_away(strangers: Strangers) -> None:
    strangers.stranger.send(b"heartbeat")
    assert take(strangers.listening, 1) == [b"heartbeat"]
    assert strangers.answered() == [True, False]
    assert strangers.listening.peer_changes == 0


@pytest.mark.parametrize("how", ["starts a run", "peer left", "peer silent"])
def test_udp_the_peer_gives_way(strangers: Strangers, how: str) -> None:
    if how == "peer left":
        strangers.host.send(b"stop")
        take(strangers.listening, 1, SenderStatus.LEAVES)
        assert strangers.answered() == [True, False]  # the last words still go to the one who left
    if how == "peer silent":
        strangers.now_s += 1.1
    strangers.stranger.send(b"mine now")
    take(strangers.listening, 1, SenderStatus.STARTS if how == "starts a run" else SenderStatus.HEARD)
    assert strangers.answered() == [False, True]
    assert strangers.listening.peer_changes == 1


def test_udp_counts_refusals() -> None:
    with open_transport("udp://127.0.0.1:0", listen=True) as listening:
        url = listening.address
    with open_transport(url, listen=False) as calling:
        calling.send(b"anyone?")
        assert calling.receive(0.05) == []
        assert calling.counts()["refused"] >= 1


def test_udp_takes_no_more_than_a_datagram_holds() -> None:
    listening, calling = udp_pair()
    with listening, calling:
        assert calling.send(bytes(65507))
        assert [len(chunk) for chunk in take(listening, 1)] == [65507]
        with pytest.raises(DatagramTooLongError, match="65508 bytes do not fit a datagram; send at most 65507"):
            calling.send(bytes(65508))


def test_tcp_serves_the_next_when_the_peer_has_left() -> None:
    listening, first = tcp_pair()
    with listening:
        assert first.send(b"first")
        assert take(listening, 1) == [b"first"]
        with open_transport(listening.address, listen=False) as second:
            assert second.send(b"second")
            assert listening.receive(0.05) == []
            first.close()
            assert take_bytes(listening, 6) == b"second"
            assert listening.send(b"hello")
            assert take(second, 1) == [b"hello"]
        assert listening.counts()["losses"] == 1


def test_tcp_many_call_one_listener() -> None:
    listener = TcpListener(urlsplit("tcp://127.0.0.1:0"))
    callers = [open_transport(listener.address, listen=False) for _ in range(5)]
    served = []
    for caller in callers:
        assert caller.send(b"hello")
    while called := listener.accept():
        served.append(TcpAccepted(called[0], listener.address, called[1]))
    assert len(served) == 5
    assert len({end.peer for end in served}) == 5
    for end in served:
        assert take(end, 1) == [b"hello"]
    callers[2].close()
    assert all(end.receive(0.02) == [] for end in served)
    assert [end.connected for end in served] == [True, True, False, True, True]
    for end in (*callers, *served):
        end.close()
    listener.close()


@pytest.mark.medium
@pytest.mark.parametrize("patient", [False, True])
def test_tcp_a_link_that_waits_for_room_loses_nothing_to_a_reader_that_is_busy(patient: bool) -> None:
    listening, calling = tcp_pair()
    with listening, calling:
        sender, reader = Link(ImpairedTransport(calling), 1, 1), Link(listening, 2, 1)
        if patient:
            sender.wait_for_room = lambda: sender.transport.wait_for_room(PATIENCE_S)
        assert sender.send(status(b"hello"))
        assert len(reader.receive(PATIENCE_S)) == 1
        sent = threading.Thread(target=lambda: [sender.send(status(b"x" * 50)) for _ in range(80_000)])
        sent.start()
        if patient:
            sent.join(0.3)
        else:  # what the system keeps is full: it is less than these 6 MB
            wait_until(lambda: sender.counters.unsent)
        heard = 0
        while heard < 80_000 and ((messages := reader.receive(0.5)) or sent.is_alive()):
            heard += len(messages)
        sent.join()
        calling.receive()  # the rest of a chunk that was taken in part goes
        heard += len(reader.receive(0.5))
        assert sender.counters.unsent == 80_000 - heard
        assert (heard == 80_000) == patient


def test_tcp_the_frames_of_a_cloud_share_system_calls() -> None:
    listening, calling = tcp_pair()
    with listening, calling:
        sender, reader = Link(calling, 1, 1), Link(listening, 2, 1)
        assert sender.send(status(b"hello"))
        assert len(reader.receive(PATIENCE_S)) == 1
        sizes: list[int] = []
        send = calling.send

        def counted(data: bytes) -> bool:
            sizes.append(len(data))
            return send(data)

        calling.send = counted  # type: ignore[method-assign]
        assert sender.send(*[status(b"x" * 50) for _ in range(500)])
        assert len(sizes) <= 3 < sum(sizes) // DATAGRAM_BYTES
        heard = 0
        while heard < 500 and (messages := reader.receive(PATIENCE_S)):
            heard += len(messages)
        assert heard == 500


def test_tcp_waiting_for_room_has_an_end_and_needs_a_peer() -> None:
    listening, calling = tcp_pair()
    with listening, calling:
        assert calling.send(b"hello")
        assert take(listening, 1) == [b"hello"]
        assert calling.wait_for_room(0.0)
        while calling.send(bytes(65536)):
            pass
        assert not calling.wait_for_room(0.02)
        listening.close()
        while calling.wait_for_room(0.02) and calling.connected:
            calling.send(b"?")  # nobody is there any more, which sending finds out
        assert calling.wait_for_room(PATIENCE_S)


@pytest.mark.skipif(not socket.has_ipv6, reason="no IPv6 here")
def test_udp_over_ipv6() -> None:
    try:
        listening = open_transport("udp://[::1]:0", listen=True)
    except AddressUnavailableError:
        pytest.skip("no IPv6 loopback here")
    with listening, open_transport(listening.address, listen=False) as calling:
        assert listening.address.startswith("udp://[::1]:")
        calling.send(b"six")
        assert take(listening, 1) == [b"six"]


@pytest.mark.parametrize(
    ("url", "listen"),
    [
        ("", True),
        ("192.168.7.2:14660", True),
        ("smoke://hill", True),
        ("udp://:14660", True),
        ("udp://h", True),
        ("udp://h:70000", True),
        ("udp://h:x", True),
        ("udp://h:0", False),
        ("udp://h:1/x", True),
        ("udp://h:1?baud=9", True),
        ("udp://me@h:1", True),
        ("tcp://h", True),
        ("tcp://h:1/x", False),
        ("udp://[::1:5", True),
    ],
)
def test_a_bad_url_is_said_in_one_sentence(url: str, listen: bool, golden: Golden) -> None:
    with pytest.raises(BadUrlError) as caught:
        open_transport(url, listen)
    golden("error", caught.value)


def test_an_address_that_is_not_ours(golden: Golden) -> None:
    with pytest.raises(AddressUnavailableError) as refused:
        open_transport("udp://192.0.2.7:14660", listen=True)  # TEST-NET-1, RFC 5737
    golden("error", refused.value)


def test_a_host_name_that_nobody_knows(golden: Golden) -> None:
    with pytest.raises(UnknownHostError) as refused:
        open_transport("udp://board.invalid:14660", listen=False)  # RFC 2606
    golden("error", refused.value)
