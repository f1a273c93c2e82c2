"""Vessels heard by AIS: what the host says of them reaches every ground station, and how much is kept."""

from __future__ import annotations

from typing import Any

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.mavlink.traffic import AGAIN_NS, EVERY_NS, MOST_VESSELS, TIMEOUT_NS
from agent.fcu.vehicle.autopilot import Autopilot
from agent.wire import dialect as mav

S = 1_000_000_000


def vessel(mmsi: int, lat: int = 10, tslc: int = 0) -> Any:
    flags = mav.AIS_FLAGS_VALID_COG | mav.AIS_FLAGS_VALID_NAME
    return mav.MAVLink_ais_vessel_message(
        mmsi, lat, 20, 9000, 8900, 300, 0, 0, 70, 30, 30, 6, 6, b"CALL", b"BARGE", tslc, flags
    )


class Stations:
    """A host and two ground stations of one autopilot."""

    def __init__(self) -> None:
        self.host = MavlinkChannel(Autopilot())
        self.grounds = [MavlinkChannel(self.host.autopilot, hub=self.host.hub, ground=True) for _ in range(2)]

    def heard(self, ground: int, start_ns: int, seconds: float) -> list[Any]:
        """The AIS_VESSEL that a station is sent in that time, polled at 50 Hz."""
        steps = range(start_ns, start_ns + round(seconds * S), S // 50)
        polled = [message for now_ns in steps for message in self.grounds[ground].poll(now_ns)]
        return [one for one in polled if one.get_msgId() == mav.MAVLINK_MSG_ID_AIS_VESSEL]


def test_a_vessel_reaches_every_station_once_and_the_host_never() -> None:
    stations = Stations()
    stations.host.handle(vessel(200000002), S)
    for ground in (0, 1):
        (message,) = stations.heard(ground, S, 2.0)
        assert (message.MMSI, message.lat, message.dimension_bow, message.name) == (200000002, 10, 30, "BARGE")
    assert mav.MAVLINK_MSG_ID_AIS_VESSEL not in {one.get_msgId() for one in stations.host.poll(2 * S)}


def test_news_are_sent_at_once_and_what_is_old_again_with_its_age() -> None:
    stations = Stations()
    stations.host.handle(vessel(1, lat=10), 0)
    stations.heard(0, 0, 1.0)
    stations.host.handle(vessel(1, lat=11), S)
    assert [message.lat for message in stations.heard(0, S, 1.0)] == [11]
    (again,) = stations.heard(0, 2 * S, AGAIN_NS / S)
    assert (again.lat, again.tslc) == (11, AGAIN_NS // S)


def test_many_vessels_do_not_come_all_at_once() -> None:
    stations = Stations()
    for mmsi in range(1, 31):
        stations.host.handle(vessel(mmsi), 0)
    assert len(stations.heard(0, 0, 10 * EVERY_NS / S)) <= 10
    assert {message.MMSI for message in stations.heard(0, S, 31 * EVERY_NS / S)} <= set(range(1, 31))
    assert len(stations.heard(0, 3 * S, 5.0)) == 0


def test_a_vessel_that_is_silent_is_forgotten() -> None:
    stations = Stations()
    stations.host.handle(vessel(1), 0)
    assert stations.heard(0, TIMEOUT_NS + S, 1.0) == []
    assert len(stations.host.hub.traffic) == 0


def test_the_table_is_bounded_and_counts_whom_it_leaves_out() -> None:
    stations = Stations()
    for mmsi in range(1, MOST_VESSELS + 3):
        stations.host.handle(vessel(mmsi), mmsi)
    stations.host.handle(vessel(3), MOST_VESSELS + 3)
    table = stations.host.hub.traffic
    assert (len(table), table.dropped) == (MOST_VESSELS, 2)
    assert [one.message.MMSI for one in table][:1] + [one.message.MMSI for one in table][-1:] == [4, 3]


def test_what_is_no_vessel_is_refused_and_counted() -> None:
    stations = Stations()
    for message in (vessel(0), vessel(1, lat=910_000_000)):
        stations.host.handle(message, 0)
    assert (len(stations.host.hub.traffic), stations.host.refused) == (0, 2)


def test_a_ground_station_does_not_tell_of_vessels() -> None:
    stations = Stations()
    stations.grounds[0].handle(vessel(1), 0)
    assert len(stations.host.hub.traffic) == 0


def test_a_restart_begins_with_an_empty_table() -> None:
    stations = Stations()
    stations.host.handle(vessel(1), 0)
    stations.host.hub.reboot()
    assert stations.heard(0, S, 1.0) == []
