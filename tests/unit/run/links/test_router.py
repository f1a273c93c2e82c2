"""Frames between vessels and stations: where each goes, that none comes round, and what a slow station costs."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from agent.wire import dialect as mav
from agent.wire.codec import Packer
from agent.wire.crc import checksum
from agent.wire.framing import Framer, as_received
from agent.wire.link import Link
from agent.wire.signing import Signing
from agent.wire.transport import Transport, open_transport
from tests.patience import PATIENCE_S
from xitl_cli.run.links import router as routing
from xitl_cli.run.links.router import Router

GCS = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
BOAT = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_SURFACE_BOAT, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)


def text(words: bytes) -> Any:
    return mav.MAVLink_statustext_message(6, words)


class Water:
    """A router, and links to it."""

    def __init__(self) -> None:
        self.router = Router(["tcp://127.0.0.1:0"])
        self._opened: list[Transport] = []

    def link(self, url: str, system_id: int, component_id: int = 1, signing: Signing | None = None) -> Link:
        self._opened.append(open_transport(url, listen=False))
        return Link(self._opened[-1], system_id, component_id, signing=signing)

    def vessel(self, system_id: int, signing: Signing | None = None) -> Link:
        link = self.link(self.router.vessels_url, system_id, signing=signing)
        link.send(BOAT)
        self.until(lambda: system_id in self.router.owners)
        return link

    def station(self, system_id: int = 255, signing: Signing | None = None) -> Link:
        before = self.router.counts.stations
        link = self.link(self.router.stations[0], system_id, 190, signing)
        while self.router.counts.stations == before:
            link.send(GCS)
            self.router.poll(0.01)
        return link

    def until(self, done: Callable[[], object]) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while not done() and time.monotonic() < until_s:
            self.router.poll(0.01)
        assert done()

    def heard(self, link: Link, kind: str, count: int = 1) -> list[Any]:
        """So many of a kind, waited for, and those beyond that are close behind."""
        found: list[Any] = []
        until_s = time.monotonic() + PATIENCE_S
        rounds = 0
        while rounds < 3 and time.monotonic() < until_s:
            rounds += len(found) >= count
            self.router.poll(0.002)
            found += [message for message in link.receive(0.002) if message.get_type() == kind]
        return found

    def counted(self, kind: str, wanted: dict[Link, int]) -> None:
        """So many have come to each."""
        assert [len(self.heard(link, kind, count)) for link, count in wanted.items()] == list(wanted.values())

    def close(self) -> None:
        for transport in self._opened:
            transport.close()
        self.router.close()


@pytest.fixture
def water() -> Iterator[Water]:
    made = Water()
    yield made
    made.close()


def test_to_one_to_all_and_between_vessels_only_what_they_may_want(water: Water) -> None:
    one, two, station, other = water.vessel(1), water.vessel(2), water.station(), water.station(250)
    station.send(mav.MAVLink_param_request_list_message(2, 1))
    water.counted("PARAM_REQUEST_LIST", {two: 1, one: 0, other: 0})
    station.send(mav.MAVLink_ping_message(1, 2, 0, 0))
    water.counted("PING", {one: 1, two: 1, other: 1, station: 0})
    one.send(text(b"hello"))
    water.counted("STATUSTEXT", {station: 1, other: 1, two: 0, one: 0})
    one.send(mav.MAVLink_command_ack_message(1, 0, 0, 0, 250, 190))
    water.counted("COMMAND_ACK", {other: 1, station: 0})
    one.send(BOAT)
    assert len(water.heard(two, "HEARTBEAT")) >= 1


def test_a_message_whose_target_field_has_the_short_name_goes_to_that_system_alone(water: Water) -> None:
    """MANUAL_CONTROL calls it `target`, other messages call it `target_system`."""
    one, two, station, other = water.vessel(1), water.vessel(2), water.station(), water.station(250)
    station.send(mav.MAVLink_manual_control_message(2, 0, 0, 0, 0, 0))
    water.counted("MANUAL_CONTROL", {two: 1, one: 0, other: 0})


def test_nothing_goes_to_a_system_that_nobody_has_heard(water: Water) -> None:
    one, station = water.vessel(1), water.station()
    station.send(mav.MAVLink_param_request_list_message(77, 1))
    water.until(lambda: water.router.counts.unroutable == 1)
    assert water.heard(one, "PARAM_REQUEST_LIST", 0) == []


def test_what_comes_round_is_dropped(water: Water) -> None:
    """A station that passes on what it hears, and one that claims to be a vessel."""
    one, station = water.vessel(1), water.station()
    looping = water.link(water.router.stations[0], 1)
    looping.send(text(b"round"))
    water.until(lambda: water.router.counts.looped == 1)
    assert water.heard(station, "STATUSTEXT", 0) == []
    one.send(text(b"still here"))
    assert [message.text for message in water.heard(station, "STATUSTEXT")] == ["still here"]


def test_a_component_shares_the_system_of_its_vessel(water: Water) -> None:
    one, two, station, other = water.vessel(1), water.vessel(2), water.station(), water.station(250)
    camera = water.link(water.router.components_url, 1, 100)
    camera.send(mav.MAVLink_heartbeat_message(30, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))
    (beat,) = [message for message in water.heard(station, "HEARTBEAT") if message.get_srcComponent() == 100]
    assert (beat.get_srcSystem(), beat.type) == (1, 30)
    station.send(mav.MAVLink_param_request_list_message(1, 100))
    water.counted("PARAM_REQUEST_LIST", {camera: 1, one: 0, two: 0})
    station.send(mav.MAVLink_param_request_list_message(1, 1))
    water.counted("PARAM_REQUEST_LIST", {one: 1, camera: 0, two: 0})
    station.send(mav.MAVLink_param_request_list_message(1, 0))
    water.counted("PARAM_REQUEST_LIST", {one: 1, camera: 1, two: 0})
    camera.send(mav.MAVLink_command_ack_message(1, 0, 0, 0, 250, 190))
    water.counted("COMMAND_ACK", {other: 1, station: 0, one: 0})


def test_what_a_component_sends_to_all_goes_to_stations_alone(water: Water) -> None:
    one, two, station = water.vessel(1), water.vessel(2), water.station()
    camera = water.link(water.router.components_url, 1, 100)
    camera.send(mav.MAVLink_heartbeat_message(30, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))
    senders = {
        link: [beat.get_srcComponent() for beat in water.heard(link, "HEARTBEAT")] for link in (station, one, two)
    }
    assert 100 in senders[station]
    assert 100 not in senders[one] + senders[two]


def test_a_component_does_not_speak_as_the_autopilot(water: Water) -> None:
    one, station = water.vessel(1), water.station()
    water.link(water.router.components_url, 1, 1).send(text(b"armed"))
    water.until(lambda: water.router.counts.looped == 1)
    assert water.heard(station, "STATUSTEXT", 0) == []
    station.send(mav.MAVLink_param_request_list_message(1, 1))
    water.counted("PARAM_REQUEST_LIST", {one: 1})


def test_a_vessel_that_was_silent_may_come_back_from_elsewhere(water: Water, monkeypatch: pytest.MonkeyPatch) -> None:
    water.vessel(1)
    station = water.station()
    monkeypatch.setattr(routing, "MOVED_S", 0.0)
    again, before = water.link(water.router.vessels_url, 1), water.router.owners[1]
    again.send(BOAT)
    water.until(lambda: water.router.owners[1] is not before)
    station.send(mav.MAVLink_param_request_list_message(1, 1))
    assert len(water.heard(again, "PARAM_REQUEST_LIST")) == 1


def test_signatures_stay_good(water: Water) -> None:
    key = bytes(range(32))
    one, station = water.vessel(1, Signing(key)), water.station(signing=Signing(key))
    one.send(text(b"signed"))
    assert [message.text for message in water.heard(station, "STATUSTEXT")] == ["signed"]
    assert station.refused_signature == 0


def test_a_station_that_reads_nothing_loses_frames_and_holds_nobody_up(water: Water) -> None:
    one, station = water.vessel(1), water.station()
    slow = socket.create_connection(("127.0.0.1", int(water.router.stations[0].rpartition(":")[2])))
    slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    slow.sendall(Packer(251, 190).pack(GCS))
    water.until(lambda: water.router.counts.stations == 2)
    got = 0
    until_s = time.monotonic() + PATIENCE_S
    while not water.router.counts.dropped and time.monotonic() < until_s:
        one.send(*[text(b"%040d" % number) for number in range(20)])
        water.router.poll(0.0)
        got += len(station.receive(0.0))
    assert water.router.counts.dropped
    assert got
    one.send(text(b"last"))
    assert water.heard(station, "STATUSTEXT")[-1].text == "last"
    slow.close()


def test_a_frame_of_mavlink_1_goes_on_as_it_came() -> None:
    body = bytes((9, 0, 33, 1, 0)) + bytes(9)
    whole = b"\xfe" + body + checksum(body + bytes([mav.MAVLink_heartbeat_message.crc_extra]))
    (found,) = Framer(stream=True, mavlink1=True).feed(whole)
    assert as_received(found) == whole
    assert as_received(Packer(1, 1).pack(BOAT)) == Packer(1, 1).pack(BOAT)
