"""pymavlink's own clients: mavutil, mavparm, mavwp and signing; several at once, on a boat that no host drives."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from live_boat import Boat, boat
from pymavlink import mavparm, mavutil, mavwp

from agent.fcu.parameters import TABLE
from tests.patience import PATIENCE_S

pytestmark = pytest.mark.slow


@contextmanager
def client(url: str, system: int = 255) -> Iterator[Any]:
    link = mavutil.mavlink_connection(url, source_system=system, dialect="ardupilotmega")
    try:
        assert link.wait_heartbeat(timeout=PATIENCE_S) is not None
        yield link
    finally:
        link.close()


@pytest.fixture(scope="module")
def idle() -> Iterator[Boat]:
    with boat(host=False) as found:
        yield found


def test_an_idle_boat_beats_and_says_what_it_is(idle: Boat) -> None:
    with client(idle.tcp) as link:
        beat = link.messages["HEARTBEAT"]
        assert (beat.type, beat.autopilot) == (mavutil.mavlink.MAV_TYPE_SURFACE_BOAT, 3)
        assert link.flightmode == "HOLD"
        link.mav.command_long_send(1, 1, mavutil.mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
        version = link.recv_match(type="AUTOPILOT_VERSION", blocking=True, timeout=PATIENCE_S)
        assert version.capabilities & mavutil.mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        assert version.flight_sw_version >> 24 == 4


def test_mavparm_sets_and_reads(idle: Boat, tmp_path: Path) -> None:
    with client(idle.tcp) as link:
        link.param_fetch_all()
        values: dict[str, float] = {}
        until_s = time.monotonic() + PATIENCE_S
        while len(values) < len(TABLE) and time.monotonic() < until_s:
            message = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=1.0)
            if message is not None:
                values[message.param_id] = message.param_value
                assert message.param_count == len(TABLE)
        assert set(values) == {row.name for row in TABLE}
        table = mavparm.MAVParmDict()
        table.update(values)
        assert table.mavset(link, "WP_RADIUS", 4.0, retries=3)
        table.save(str(tmp_path / "boat.parm"))
        again = mavparm.MAVParmDict()
        assert again.load(str(tmp_path / "boat.parm"), use_excludes=False)
        assert len(again) == len(TABLE)


def test_mavwp_goes_up_and_comes_down(idle: Boat, tmp_path: Path) -> None:
    plan = tmp_path / "plan.txt"
    plan.write_text(
        "QGC WPL 110\n"
        "0\t1\t0\t16\t0\t0\t0\t0\t-8.8\t-63.95\t70\t1\n"
        "1\t0\t3\t16\t0\t0\t0\t0\t-8.799\t-63.95\t0\t1\n"
        "2\t0\t3\t19\t5\t0\t0\t0\t-8.798\t-63.951\t0\t1\n"
    )
    with client(idle.tcp) as link:
        loader = mavwp.MAVWPLoader(target_system=1, target_component=1)
        assert loader.load(str(plan)) == 3
        link.waypoint_count_send(loader.count())
        for _ in range(loader.count()):
            asked = ["MISSION_REQUEST", "MISSION_REQUEST_INT"]
            request = link.recv_match(type=asked, blocking=True, timeout=PATIENCE_S)
            link.mav.send(loader.wp(request.seq))  # the float form
        assert link.recv_match(type="MISSION_ACK", blocking=True, timeout=PATIENCE_S).type == 0

        link.waypoint_request_list_send()
        count = link.recv_match(type="MISSION_COUNT", blocking=True, timeout=PATIENCE_S).count
        back = mavwp.MAVWPLoader()
        for seq in range(count):
            link.mav.mission_request_send(1, 1, seq)
            back.add(link.recv_match(type="MISSION_ITEM", blocking=True, timeout=PATIENCE_S))
        back.save(str(tmp_path / "back.txt"))
        assert [back.wp(seq).command for seq in range(count)] == [16, 16, 19]
        assert back.wp(2).param1 == 5.0
        assert back.wp(1).x == pytest.approx(-8.799, abs=1e-6)


def test_the_fence_goes_up_and_comes_down(idle: Boat) -> None:
    with client(idle.tcp) as link:
        corners = [(-8.79, -63.96), (-8.79, -63.94), (-8.81, -63.94), (-8.81, -63.96)]
        link.mav.mission_count_send(1, 1, len(corners), 1)
        for _ in corners:
            request = link.recv_match(type="MISSION_REQUEST_INT", blocking=True, timeout=PATIENCE_S)
            lat, lon = corners[request.seq]
            link.mav.mission_item_int_send(
                1, 1, request.seq, 0, 5001, 0, 1, len(corners), 0, 0, 0, round(lat * 1e7), round(lon * 1e7), 0, 1
            )
        ack = link.recv_match(type="MISSION_ACK", blocking=True, timeout=PATIENCE_S)
        assert (ack.type, ack.mission_type) == (0, 1)
        link.mav.mission_request_list_send(1, 1, 1)
        assert link.recv_match(type="MISSION_COUNT", blocking=True, timeout=PATIENCE_S).count == 4
        link.mav.mission_request_int_send(1, 1, 2, 1)
        item = link.recv_match(type="MISSION_ITEM_INT", blocking=True, timeout=PATIENCE_S)
        assert (item.command, item.param1, item.x) == (5001, 4.0, -88100000)


def test_several_stations_at_once_are_told_of_each_others_changes(idle: Boat) -> None:
    with (
        client(idle.tcp, 255) as first,
        client(idle.tcp, 254) as second,
        client(f"udpin:127.0.0.1:{idle.udp_ports[0]}", 253) as third,
    ):
        first.mav.param_set_send(1, 1, b"WP_SPEED", 1.25, 9)
        for link in (first, second, third):
            value = link.recv_match(
                type="PARAM_VALUE", condition="PARAM_VALUE.param_id=='WP_SPEED'", blocking=True, timeout=PATIENCE_S
            )
            assert value.param_value == 1.25
        for rate_hz, link in ((10, first), (25, second), (50, third)):
            interval_us = 1e6 / rate_hz
            link.mav.command_long_send(1, 1, 511, 0, 30, interval_us, 0, 0, 0, 0, 0)
            assert link.recv_match(type="COMMAND_ACK", blocking=True, timeout=PATIENCE_S).result == 0
        for link in (first, second, third):
            for _ in range(5):
                assert link.recv_match(type="ATTITUDE", blocking=True, timeout=PATIENCE_S) is not None


def test_signed_stations_are_served_and_others_not(tmp_path: Path) -> None:
    key_file = tmp_path / "key.txt"
    key_file.write_text("a boat of our own\n")
    key_file.chmod(0o600)
    key = hashlib.sha256(b"a boat of our own").digest()
    with boat(host=False, agent_options=("--signing-key", str(key_file))) as found:
        with client(found.tcp) as stranger:
            assert stranger.messages["HEARTBEAT"].get_header().incompat_flags & mavutil.mavlink.MAVLINK_IFLAG_SIGNED
            stranger.mav.param_set_send(1, 1, b"WP_SPEED", 1.0, 9)
            said = stranger.recv_match(type="STATUSTEXT", blocking=True, timeout=PATIENCE_S)
            assert "not signed with our key" in said.text or "refused" in said.text
            assert stranger.recv_match(type="PARAM_VALUE", blocking=True, timeout=1.0) is None
        link = mavutil.mavlink_connection(found.tcp, source_system=255, dialect="ardupilotmega")
        try:
            link.setup_signing(key, sign_outgoing=True)
            assert link.wait_heartbeat(timeout=PATIENCE_S) is not None
            link.mav.param_set_send(1, 1, b"WP_SPEED", 2.0, 9)
            value = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=PATIENCE_S)
            assert (value.param_id, value.param_value) == ("WP_SPEED", 2.0)
            assert value.get_signed()
        finally:
            link.close()


def test_storage_outlives_a_restart(tmp_path: Path) -> None:
    options = ("--storage", str(tmp_path / "kept.json"))
    with boat(host=False, agent_options=options) as found, client(found.tcp) as link:
        link.mav.param_set_send(1, 1, b"WP_SPEED", 1.75, 9)
        assert link.recv_match(type="PARAM_VALUE", blocking=True, timeout=PATIENCE_S).param_value == 1.75
    with boat(host=False, agent_options=options) as found, client(found.tcp) as link:
        link.mav.param_request_read_send(1, 1, b"WP_SPEED", -1)
        assert link.recv_match(type="PARAM_VALUE", blocking=True, timeout=PATIENCE_S).param_value == 1.75
