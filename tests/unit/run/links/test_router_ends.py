"""The ends of the router: datagrams, stations that it sends to, limits, calls, and its program."""

from __future__ import annotations

import io
import json
import os
import socket
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from agent.wire import dialect as mav
from agent.wire.codec import Packer
from agent.wire.tcp import TcpTransport
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.run.links import router as routing
from xitl_cli.run.links.router import DatagramEndpoint, Router, TransportEndpoint, _datagrams

BOAT = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_SURFACE_BOAT, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
GCS = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


def frame(system: int, message: Any = BOAT, component: int = 1) -> bytes:
    return Packer(system, component).pack(message)


@pytest.fixture
def router() -> Iterator[Router]:
    made = Router(["tcp://127.0.0.1:0"])
    yield made
    made.close()


def port_of(url: str) -> tuple[str, int]:
    return "127.0.0.1", int(url.rpartition(":")[2].rstrip("/"))


def udp() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(PATIENCE_S)
    return made


def until(router: Router, done: Any) -> None:
    wait_until(lambda: (router.poll(0.01), done())[1])


def test_frames_share_datagrams_up_to_their_size() -> None:
    frames = [bytes(600), bytes(800), bytes(1), bytes(1400), bytes(1399), bytes(1), bytes(1)]
    packed = _datagrams(frames)
    assert [(len(datagram), count) for datagram, count in packed] == [(1400, 2), (1, 1), (1400, 1), (1400, 2), (1, 1)]
    assert b"".join(datagram for datagram, _ in packed) == b"".join(frames)
    assert _datagrams([]) == []


class Line:
    """Stands in for the socket of a vessel. outcomes: of each datagram."""

    def __init__(self, *outcomes: Exception | None) -> None:
        self._outcomes = list(outcomes)

    def sendto(self, data: bytes, address: Any) -> None:
        outcome = self._outcomes.pop(0)
        if outcome is not None:
            raise outcome


def test_frames_that_a_line_has_no_room_for_are_counted_and_those_to_a_vessel_that_left_are_not() -> None:
    line = Line(None, OSError("full"), ConnectionRefusedError())
    vessel = DatagramEndpoint(cast(Any, line), ("127.0.0.1", 9), component=False)
    assert vessel.send([bytes(1000), bytes(700), bytes(600), bytes(1000)]) == 2
    assert vessel.name == "udp://127.0.0.1:9"


@pytest.mark.parametrize(("sends", "refuses", "dropped"), [(True, False, 0), (False, False, 3), (False, True, 0)])
def test_a_station_that_is_sent_to_counts_what_it_did_not_get(sends: bool, refuses: bool, dropped: int) -> None:
    transport: Any = SimpleNamespace(stream=False, refused=0)

    def send(datagram: bytes) -> bool:
        transport.refused += refuses
        return sends

    transport.send = send
    station = TransportEndpoint(transport, "udp://x", vessel=False)
    assert station.send([bytes(10), bytes(1395), bytes(20)]) == dropped


def test_a_station_that_is_gone_loses_nothing_and_a_full_one_everything() -> None:
    class Stream(TcpTransport):
        def __init__(self, connected: bool) -> None:
            self._is_connected = connected

        @property
        def connected(self) -> bool:
            return self._is_connected

        def send(self, data: bytes) -> bool:
            return False

    assert TransportEndpoint(Stream(False), "x", vessel=False).send([b"a", b"b"]) == 0
    assert TransportEndpoint(Stream(True), "x", vessel=False).send([b"a", b"b"]) == 2


def test_stations_that_it_sends_to_hear_vessels_and_are_listed() -> None:
    with udp() as station, udp() as vessel:
        url = f"udp://127.0.0.1:{station.getsockname()[1]}"
        made = Router(["tcp://127.0.0.1:0", url])
        try:
            listening, sent_to = made.stations
            assert listening.startswith("tcp://127.0.0.1:")
            assert sent_to == url
            vessel.sendto(frame(3), port_of(made.vessels_url))
            until(made, lambda: 3 in made.owners)
            assert station.recv(2048) == frame(3)
            report = made.report()
            assert (report["frames_in"], report["frames_out"]) == (1, 1)
            assert report["systems"] == {"3": f"udp://127.0.0.1:{vessel.getsockname()[1]}"}
            with socket.create_connection(port_of(listening)) as caller:
                caller.sendall(frame(255, GCS, 190))
                until(made, lambda: made.counts.stations == 1)
                assert made.stations == (listening, url), "neither vessels nor those that call"
        finally:
            made.close()


def test_more_stations_than_there_may_be_are_turned_away(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routing, "MOST_STATIONS", 1)
    address = port_of(router.stations[0])
    with socket.create_connection(address) as first, socket.create_connection(address) as second:
        until(router, lambda: router.counts.turned_away == 1)
        second.settimeout(PATIENCE_S)
        assert second.recv(10) == b""
        first.sendall(frame(255, GCS, 190))
        until(router, lambda: router.counts.stations == 1)


def test_more_endpoints_of_vessels_than_there_may_be_are_turned_away(
    router: Router, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routing, "MOST_VESSELS", 1)
    with udp() as one, udp() as two:
        one.sendto(frame(1), port_of(router.vessels_url))
        until(router, lambda: 1 in router.owners)
        two.sendto(frame(2), port_of(router.vessels_url))
        until(router, lambda: router.counts.turned_away == 1)
        assert 2 not in router.owners


def test_a_vessel_is_called_until_it_answers(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routing, "LOOK_S", 0.0)
    monkeypatch.setattr(routing, "AGAIN_S", 0.01)
    with udp() as vessel:
        router.call(f"udp://127.0.0.1:{vessel.getsockname()[1]}")
        vessel.setblocking(False)
        calls: list[bytes] = []

        def called() -> int:
            try:
                data, router_address = vessel.recvfrom(100)
            except BlockingIOError:
                return len(calls)
            calls.append(data)
            called.address = router_address  # type: ignore[attr-defined]
            return len(calls)

        until(router, lambda: called() >= 2)
        assert set(calls) == {b""}
        vessel.sendto(frame(4), called.address)  # type: ignore[attr-defined]
        until(router, lambda: 4 in router.owners)
        while called() != called():
            pass
        before = len(calls)
        for _ in range(5):
            router.poll(0.02)
        assert called() == before


def test_a_vessel_at_tcp_is_called_again_after_it_closed(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routing, "LOOK_S", 0.0)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        accepted: list[socket.socket] = []

        def accept() -> None:
            for _ in range(2):
                accepted.append(server.accept()[0])

        waiting = threading.Thread(target=accept)
        waiting.start()
        router.call(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        until(router, lambda: accepted)
        accepted[0].sendall(frame(5))
        until(router, lambda: 5 in router.owners)
        accepted[0].close()
        until(router, lambda: len(accepted) == 2)
        waiting.join()
        accepted[1].sendall(frame(5))
        until(router, lambda: router.counts.frames_in == 2)
        assert router.counts.looped == 0
        accepted[1].close()


def test_a_station_that_reads_nothing_is_dropped_after_a_while(router: Router) -> None:
    with socket.create_connection(port_of(router.stations[0])) as station:
        station.sendall(frame(255, GCS, 190))
        until(router, lambda: router.counts.stations == 1)
        (endpoint,) = [each for each in router._endpoints if isinstance(each, TransportEndpoint)]
        stuck = [True]
        endpoint.transport = cast(Any, Stuck(endpoint.transport, stuck))
        for now_s, is_stuck, there in ((0.0, True, True), (10.0, True, True), (10.5, False, True), (11.0, True, True)):
            stuck[0] = is_stuck
            router._check_endpoints(now_s)
            assert (endpoint in router._endpoints) is there
        router._check_endpoints(21.0)
        assert endpoint in router._endpoints
        router._check_endpoints(21.1)
        assert endpoint not in router._endpoints
        assert router.counts.stuck == 1


class Stuck(TcpTransport):
    """A connection whose other end reads nothing while `stuck` is set."""

    def __init__(self, of: Any, stuck: list[bool]) -> None:
        self._of, self._stuck = of, stuck

    @property
    def connected(self) -> bool:
        return True

    @property
    def stuck(self) -> bool:
        return self._stuck[0]

    def fileno(self) -> int | None:
        descriptor: int | None = self._of.fileno()
        return descriptor

    @property
    def losses(self) -> int:  # type: ignore[override]
        return 0

    def close(self) -> None:
        self._of.close()


def test_damaged_bytes_of_a_station_that_left_stay_counted(router: Router) -> None:
    with socket.create_connection(port_of(router.stations[0])) as station:
        broken = bytearray(frame(255, GCS, 190))
        broken[-1] ^= 0xFF
        station.sendall(bytes(broken) + frame(255, GCS, 190))
        until(router, lambda: router.counts.stations == 1)
        assert router.report()["damaged"] == 1
    until(router, lambda: not router._endpoints)
    assert router.report()["damaged"] == 1


# -- the program


def test_the_program_says_its_addresses_calls_vessels_and_reports_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    read_end, write_end = os.pipe()
    monkeypatch.setattr(routing.sys, "stdin", SimpleNamespace(fileno=lambda: read_end))
    written = io.StringIO()
    monkeypatch.setattr(routing.sys, "stdout", written)
    codes: list[int] = []
    with udp() as vessel:
        running = threading.Thread(target=lambda: codes.append(routing.main(["tcp://127.0.0.1:0"])))
        running.start()
        wait_until(lambda: "\n" in written.getvalue())
        first = json.loads(written.getvalue())
        assert set(first) == {"vessels", "components", "stations"}
        line = f"udp://127.0.0.1:{vessel.getsockname()[1]}\n".encode()
        os.write(write_end, line[:7])
        os.write(write_end, line[7:])
        _, router_address = vessel.recvfrom(100)
        assert router_address == port_of(first["vessels"])
        vessel.sendto(frame(6), router_address)
        os.close(write_end)
        running.join()
        os.close(read_end)
    assert codes == [0]
    report = json.loads(written.getvalue().splitlines()[1])
    assert report["turned_away"] == 0


def test_a_port_that_is_taken_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    said = io.StringIO()
    monkeypatch.setattr(routing.sys, "stderr", said)
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert routing.main([f"tcp://127.0.0.1:{port}"]) == 2
    assert str(port) in said.getvalue()
    assert said.getvalue().count("\n") == 1
