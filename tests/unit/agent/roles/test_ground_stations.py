"""Ground stations on one vehicle: who may call, who is dropped, and that nobody holds up the others."""

from __future__ import annotations

import errno
import os
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from python39 import strict_zip

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.mavlink.hub import MavlinkHub
from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle_state import INFO
from agent.mavlink.logs import MOST_PARTS
from agent.roles import ground_stations as client_module
from agent.roles.ground_stations import MOST_CLIENTS, GroundStations
from agent.wire import dialect as mav
from agent.wire.codec import Packer
from agent.wire.link import Link
from agent.wire.signing import Signing
from agent.wire.transport import AddressInUseError, BadUrlError, Transport, open_transport
from tests.patience import PATIENCE_S, wait_until

TICK = 20_000_000
KEY = bytes(range(32))


class World:
    """An idle vehicle with a listening port."""

    def __init__(self, *urls: str, signing: Signing | None = None) -> None:
        self.stations = GroundStations(urls or ("tcp://127.0.0.1:0",), 1, 1, signing)
        self.vehicle = MavlinkHub(Autopilot())
        self.host = MavlinkChannel(self.vehicle.autopilot, hub=self.vehicle)
        self.stations.attach(self.vehicle)
        self.now_ns = 0
        self.callers: list[Transport] = []

    def call(self, system: int = 255, signing: Signing | None = None) -> Link:
        transport = open_transport(self.stations.addresses[0], listen=False)
        self.callers.append(transport)
        link = Link(transport, system, 190, signing=signing)
        assert transport.send(b"\0")
        self.run(3)
        return link

    def run(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.now_ns += TICK
            self.stations.receive(lambda: self.now_ns)
            self.stations.telemetry(self.now_ns)

    def until(self, link: Link, wanted: Callable[[Any], bool], cycles: int = 200) -> Any:
        for _ in range(cycles):
            self.run()
            for message in link.receive(0.002):
                if wanted(message):
                    return message
        raise AssertionError("it did not come")


@pytest.fixture
def world() -> Iterator[World]:
    made = World()
    yield made
    for caller in made.callers:
        caller.close()
    made.stations.close()


def of(name: str) -> Callable[[Any], bool]:
    return lambda message: bool(message.get_type() == name)


def test_each_has_its_own_rates_and_requests(world: World) -> None:
    first, second = world.call(255), world.call(254)
    first.send(mav.MAVLink_command_long_message(1, 1, 511, 0, 30.0, 20000.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    world.until(first, of("COMMAND_ACK"))
    counts = {first: 0, second: 0}
    for _ in range(50):
        world.run()
        for link in counts:
            counts[link] += sum(message.get_type() == "ATTITUDE" for message in link.receive(0.001))
    assert counts[first] >= 45
    assert counts[second] <= 2
    second.send(mav.MAVLink_param_request_read_message(1, 1, b"WP_SPEED", -1))
    assert world.until(second, of("PARAM_VALUE")).param_value == 3.0
    assert not [message for message in first.receive(0.01) if message.get_type() == "PARAM_VALUE"]


def test_events_reach_everybody_once_the_host_too(world: World) -> None:
    links = [world.call(255), world.call(254)]
    world.vehicle.autopilot.events.add(INFO, "hear, hear")
    for link in links:
        assert world.until(link, of("STATUSTEXT")).text == "hear, hear"
    texts = [m.text for m in world.host.poll(world.now_ns) if m.get_type() == "STATUSTEXT"]
    assert texts == ["hear, hear"]
    world.run(5)
    assert not [m for link in links for m in link.receive(0.01) if m.get_type() == "STATUSTEXT"]


def test_a_change_is_told_to_the_others_and_not_to_the_host(world: World) -> None:
    first, second = world.call(255), world.call(254)
    first.send(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 2.0, 9))
    assert world.until(second, of("PARAM_VALUE")).param_value == 2.0
    assert not [m for m in world.host.poll(world.now_ns) if m.get_type() == "PARAM_VALUE"]


def test_rates_outlive_a_new_run(world: World) -> None:
    link = world.call()
    link.send(mav.MAVLink_command_long_message(1, 1, 511, 0, 30.0, 20000.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    world.until(link, of("COMMAND_ACK"))
    world.stations.attach(MavlinkHub(Autopilot()))
    world.run(2)
    link.receive(0.05)
    seen = 0
    for _ in range(20):
        world.run()
        seen += sum(message.get_type() == "ATTITUDE" for message in link.receive(0.002))
    assert seen >= 18


@pytest.mark.medium
def test_one_that_reads_nothing_costs_nothing_and_is_dropped(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    lively, dead = world.call(255), world.call(254)
    for link in (lively, dead):
        link.send(mav.MAVLink_request_data_stream_message(1, 1, 0, 50, 1))
    cycles = 0
    while world.stations.counters.skipped == 0:  # until the system's buffers are full
        world.run()
        lively.receive()
        cycles += 1
        assert cycles < 20_000
    assert world.until(lively, of("ATTITUDE"))
    assert world.stations.counters.connected == 2
    monkeypatch.setattr(client_module, "STUCK_NS", 0)
    wait_until(lambda: world.run() or world.stations.counters.connected == 1)
    assert world.stations.counters.dropped == 1
    assert world.until(lively, of("HEARTBEAT"))


def test_one_that_leaves_is_let_go(world: World) -> None:
    world.call()
    assert world.stations.counters.connected == 1
    world.callers[0].close()
    world.run(3)
    assert world.stations.counters.connected == 0
    assert world.stations.counters.dropped == 0
    assert world.stations.counters.sent > 0


def test_no_more_than_so_many(world: World) -> None:
    for number in range(MOST_CLIENTS + 3):
        world.call(number + 1)
    assert world.stations.counters.connected == MOST_CLIENTS
    assert world.stations.counters.dropped == 3


def port_of(link: Link) -> int:
    descriptor = link.transport.fileno()
    assert descriptor is not None
    with socket.socket(fileno=os.dup(descriptor)) as same:
        port: int = same.getsockname()[1]
    return port


BEAT = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def test_silent_ones_lock_nobody_out_and_the_one_that_speaks_stays(world: World) -> None:
    speaks = world.call(1)
    speaks.send(BEAT)
    world.run(3)
    silent = [world.call(2 + number) for number in range(MOST_CLIENTS - 1)]
    newest = world.call(99)
    oldest = f"tcp://127.0.0.1:{port_of(silent[0])}"  # of those that never spoke
    assert f"Idle station {oldest} dropped" in world.until(speaks, of("STATUSTEXT")).text
    assert world.until(newest, of("HEARTBEAT"))
    counters = world.stations.counters
    assert (counters.connected, counters.dropped) == (MOST_CLIENTS, 1)


def test_while_all_are_heard_of_late_the_next_waits_and_then_gets_in(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(MOST_CLIENTS):
        world.call(1 + number).send(BEAT)
    world.run(3)
    newest = world.call(99)
    world.run(3)
    assert newest.receive(0.01) == []
    assert len(world.stations.descriptors()) == MOST_CLIENTS  # without the port, which wakes nobody for now
    monkeypatch.setattr(client_module, "QUIET_NS", 0)  # they fall silent
    wait_until(lambda: len(world.stations.descriptors()) > MOST_CLIENTS)
    assert world.until(newest, of("HEARTBEAT"))
    assert world.stations.counters.dropped == 1


def test_without_a_descriptor_nobody_is_woken_for_those_who_call(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    listens = world.call(1)
    port = set(world.stations.descriptors())

    def exhausted(listener: socket.socket) -> Any:
        raise OSError(errno.EMFILE, "Too many open files")

    with monkeypatch.context() as patched:
        patched.setattr(socket.socket, "accept", exhausted)
        newest = world.call(2)
        assert len(world.stations.descriptors()) == len(port) - 1
        assert "No file descriptor left" in world.until(listens, of("STATUSTEXT")).text
    wait_until(lambda: set(world.stations.descriptors()) == port)
    assert world.until(newest, of("HEARTBEAT"))


def bytes_read(stations: GroundStations) -> list[int]:
    """Bytes from each station."""
    return [client.link.counters.bytes_in for client in stations._clients]


def test_many_share_what_one_cycle_can_bear(world: World) -> None:
    links = [world.call(1 + number) for number in range(MOST_CLIENTS)]
    for link in links:
        assert link.transport.send(b"\xfd" * 4000)
    read = bytes_read(world.stations)
    world.run()
    taken = [after - before for after, before in strict_zip(bytes_read(world.stations), read)]
    assert 0 < sum(taken) <= client_module.BYTES_A_CYCLE
    assert min(taken) == max(taken)


def test_a_datagram_that_no_station_sends_is_dropped_unread_and_counted() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(PATIENCE_S)
        made = World(f"udp://127.0.0.1:{sock.getsockname()[1]}")
        made.run()
        _, peer = sock.recvfrom(2000)
        sock.sendto(b"\xfd" * 60_000, peer)
        sock.sendto(b"\xfd" * 1000, peer)
        wait_until(lambda: made.run() or bytes_read(made.stations) == [1000])
        assert made.stations.counters.refused == 1
    made.stations.close()


def test_a_flood_is_taken_in_small_bites(world: World) -> None:
    link = world.call()
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    for _ in range(100):
        link.send(*[beat] * 60)
    (before,) = bytes_read(world.stations)
    world.run()
    (after,) = bytes_read(world.stations)
    assert 0 < after - before < 100 * len(Packer(255, 190).pack(beat))


def test_requests_beyond_those_that_wait_are_counted_by_whom_and_after_they_left(world: World) -> None:
    """Parts of a log that a station asks for faster than they can go out."""
    link = world.call()
    for number in range(MOST_PARTS + 3):
        link.send(mav.MAVLink_log_request_data_message(1, 1, 1, 90 * number, 90))
        world.stations.receive(lambda: world.now_ns)  # nothing goes out in between
    wait_until(lambda: world.stations.receive(lambda: world.now_ns) or world.stations.counters.refused == 3)
    link.transport.close()
    wait_until(lambda: world.run() or world.stations.counters.connected == 0)
    assert world.stations.counters.refused == 3


def test_an_unsigned_station_is_said_once_and_not_served() -> None:
    made = World(signing=Signing(KEY))
    stranger, holder = made.call(255), made.call(254, Signing(KEY))
    for _ in range(3):
        stranger.send(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 1.0, 9))
        made.run(2)
    text = made.until(holder, of("STATUSTEXT")).text
    assert text.startswith("Frames from tcp://127.0.0.1:")
    assert made.vehicle.autopilot.parameters["WP_SPEED"] == 3.0
    assert made.stations.counters.refused == 3
    holder.send(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 1.0, 9))
    assert made.until(holder, of("PARAM_VALUE")).param_value == 1.0
    assert not [m for m in holder.receive(0.01) if m.get_type() == "STATUSTEXT" and "Frames from" in m.text]
    for caller in made.callers:
        caller.close()
    made.stations.close()


def test_udp_is_sent_to_and_nobody_there_is_no_matter() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(PATIENCE_S)
        url = f"udp://127.0.0.1:{sock.getsockname()[1]}"
        made = World(url)
        made.run()
        data, peer = sock.recvfrom(2000)
        assert data[0] == 0xFD
        other = Link(open_transport("udp://127.0.0.1:0", listen=True), 255, 190)
        sock.sendto(Packer(255, 190).pack(mav.MAVLink_param_request_read_message(1, 1, b"WP_SPEED", -1)), peer)
        other.transport.close()
        until_s = time.monotonic() + PATIENCE_S
        while b"WP_SPEED" not in data and time.monotonic() < until_s:
            made.run()
            data = sock.recvfrom(2000)[0]
        assert b"WP_SPEED" in data
    made.run(100)
    made.stations.close()


def test_what_cannot_be_opened_is_said_and_closes_the_rest() -> None:
    first = GroundStations(["tcp://127.0.0.1:0"], 1, 1)
    with pytest.raises(AddressInUseError):
        GroundStations(["tcp://127.0.0.1:0", first.addresses[0]], 1, 1)
    with pytest.raises(BadUrlError):
        GroundStations(["tcp://[::1:5"], 1, 1)
    with pytest.raises(BadUrlError):
        GroundStations(["smoke://hill"], 1, 1)
    first.close()
