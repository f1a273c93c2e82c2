"""Clients that nobody here wrote at the one port of a fleet: three vessels in real time, told apart by system id."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from agent.fcu.parameters import TABLE
from tests.free_ports import free_port
from tests.patience import PATIENCE_S, wait_until

pytestmark = pytest.mark.slow
FLEET = """
extends: ground-station
driver: {stay: true}
clock: {exchange_rate_hz: 50, physics_rate_hz: 200}
autopilot: {ground_stations: [%s, %s]}
vessels:
  ahead: {mission: {start: {north_m: 40}, waypoints_ned_m: [[60, 0], [90, 0], [120, 0]]}}
  middle: {autopilot: {system_id: 7, runs: process, link: 'udp://127.0.0.1:0'}}
  astern: {mission: {start: {north_m: -40}}}
"""
SYSTEMS = {1, 2, 7}


@dataclass(frozen=True)
class Fleet:
    tcp_port: int
    udp_port: int
    folder: Path

    @property
    def tcp(self) -> str:
        return f"tcp://127.0.0.1:{self.tcp_port}"


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    folder = tmp_path_factory.mktemp("fleet")
    found = Fleet(free_port(31), free_port(), folder)
    (folder / "fleet.yaml").write_text(FLEET % (found.tcp, f"udp://127.0.0.1:{found.udp_port}"))
    words = ["sim", "--profile", str(folder / "fleet.yaml"), "--duration", "600", "--out", str(folder / "run")]
    with (folder / "said.txt").open("w") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "xitl_cli.main", *words], stdout=said, stderr=said, start_new_session=True
        )
        try:

            def waits() -> bool:
                assert process.poll() is None, (folder / "said.txt").read_text()
                return "waits for a ground station" in (folder / "said.txt").read_text()

            wait_until(waits, "the run does not begin")
            yield found
        finally:
            process.terminate()
            try:
                process.wait(PATIENCE_S)
            finally:
                process.kill()


def heard_at(url: str, count: int) -> tuple[Any, set[int]]:
    """A pymavlink connection, and the systems whose heartbeats came until there were so many."""
    client = mavutil.mavlink_connection(url, source_system=255, dialect="ardupilotmega")
    systems: set[int] = set()
    until_s = time.monotonic() + PATIENCE_S
    while len(systems) < count and time.monotonic() < until_s:
        beat = client.recv_match(type="HEARTBEAT", blocking=True, timeout=1.0)
        if beat is not None and beat.type != mavutil.mavlink.MAV_TYPE_GCS:
            systems.add(beat.get_srcSystem())
    return client, systems


def test_all_at_one_port_and_each_at_its_own(fleet: Fleet) -> None:
    client, systems = heard_at(f"tcp:127.0.0.1:{fleet.tcp_port}", 3)
    client.close()
    assert systems == SYSTEMS
    for number, system_id in enumerate((1, 7, 2), start=1):
        alone, systems = heard_at(f"tcp:127.0.0.1:{fleet.tcp_port + 10 * number}", 1)
        late = [alone.recv_match(blocking=True, timeout=1.0) for _ in range(50)]
        alone.close()
        assert systems | {m.get_srcSystem() for m in late if m is not None} <= {1, 2, 7}
        assert {m.get_srcSystem() for m in late if m is not None and m.get_type() == "ATTITUDE"} <= {system_id}
        assert system_id in systems


def test_parameters_and_mission_of_one_while_others_talk(fleet: Fleet) -> None:
    client, systems = heard_at(f"tcp:127.0.0.1:{fleet.tcp_port}", 3)
    assert systems == SYSTEMS
    client.mav.param_request_list_send(7, 1)
    values: dict[int, Any] = {}
    others = 0
    until_s = time.monotonic() + PATIENCE_S
    while (len(values) < len(TABLE) or not others) and time.monotonic() < until_s:
        message = client.recv_match(blocking=True, timeout=1.0)
        if message is not None and message.get_type() == "PARAM_VALUE":
            assert message.get_srcSystem() == 7
            values[message.param_index] = message
        elif message is not None:
            others += message.get_srcSystem() != 7
    assert len(values) == len(TABLE)
    assert {m.param_id: m.param_value for m in values.values()}["SYSID_THISMAV"] == 7.0
    assert others > 0
    for system_id, places in ((1, 4), (7, None)):
        client.mav.mission_request_list_send(system_id, 1)
        count = client.recv_match(type="MISSION_COUNT", blocking=True, timeout=PATIENCE_S)
        assert count.get_srcSystem() == system_id
        assert places is None or count.count == places
        for seq in range(count.count):
            client.mav.mission_request_int_send(system_id, 1, seq)
            item = client.recv_match(type="MISSION_ITEM_INT", blocking=True, timeout=PATIENCE_S)
            assert (item.get_srcSystem(), item.seq) == (system_id, seq)
    client.close()


def test_a_broadcast_reaches_all_and_a_command_one(fleet: Fleet) -> None:
    client, _ = heard_at(f"tcp:127.0.0.1:{fleet.tcp_port}", 3)
    modes: dict[int, int] = {}

    def see(wanted: dict[int, int]) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while modes != wanted and time.monotonic() < until_s:
            beat = client.recv_match(type="HEARTBEAT", blocking=True, timeout=1.0)
            if beat is not None and beat.type != mavutil.mavlink.MAV_TYPE_GCS:
                modes[beat.get_srcSystem()] = beat.custom_mode
        assert modes == wanted

    do_mode, manual, hold = mavutil.mavlink.MAV_CMD_DO_SET_MODE, 0, 4
    client.mav.command_long_send(7, 1, do_mode, 0, 1, manual, 0, 0, 0, 0, 0)
    see({1: hold, 2: hold, 7: manual})
    client.mav.command_long_send(0, 0, do_mode, 0, 1, manual, 0, 0, 0, 0, 0)
    see({1: manual, 2: manual, 7: manual})
    client.mav.command_long_send(0, 0, do_mode, 0, 1, hold, 0, 0, 0, 0, 0)
    see({1: hold, 2: hold, 7: hold})
    client.close()


@pytest.mark.skipif(importlib.util.find_spec("mavsdk") is None, reason="MAVSDK is not installed: pip install mavsdk")
def test_mavsdk_finds_several_systems_on_one_connection(fleet: Fleet) -> None:
    from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
    from mavsdk.asyncio.plugins.param import ParamAsync

    async def look() -> dict[int, float]:
        async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as sdk:
            await sdk.add_any_connection(f"udpin://127.0.0.1:{fleet.udp_port}")
            found: dict[int, Any] = {}
            until_s = time.monotonic() + PATIENCE_S
            while set(found) != SYSTEMS and time.monotonic() < until_s:
                systems = await sdk.get_systems()
                found = {await system.get_system_id(): system for system in systems}
                await asyncio.sleep(0.2)
            read = {}
            for system_id, system in found.items():
                parameters = ParamAsync(system)
                read[system_id] = await parameters.get_param_int("SYSID_THISMAV")
            return read

    assert asyncio.run(look()) == {system_id: system_id for system_id in SYSTEMS}


@pytest.mark.skipif(
    importlib.util.find_spec("MAVProxy") is None, reason="MAVProxy is not installed: pip install MAVProxy"
)
def test_mavproxy_sees_all_and_talks_to_the_one_that_is_chosen(fleet: Fleet, tmp_path: Path) -> None:
    """`param show` of the vehicle that is in use; MAVProxy has each vehicle's parameters for itself."""
    program = Path(sys.executable).with_name("mavproxy.py")
    with subprocess.Popen(
        [sys.executable, str(program), f"--master=tcp:127.0.0.1:{fleet.tcp_port}", "--target-system=7"],
        cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        said = ""
        try:
            while f"{len(TABLE)}/{len(TABLE)}" not in said and f"Received {len(TABLE)} parameters" not in said:
                line = process.stdout.readline()
                assert line, said
                said += line
            process.stdin.write("param show SYSID_THISMAV\n")
            process.stdin.flush()
            while "SYSID_THISMAV    7" not in said:
                line = process.stdout.readline()
                assert line, said
                said += line
        finally:
            process.kill()
    assert "Detected vehicle 1:1" in said
    assert "Detected vehicle 7:1" in said


def test_our_own_tools_ask_which(fleet: Fleet) -> None:
    def show(url: str) -> subprocess.CompletedProcess[str]:
        words = ["params", "show", url, "--filter", "SYSID_THISMAV", "--json"]
        return subprocess.run(
            [sys.executable, "-m", "xitl_cli.main", *words], capture_output=True, text=True, check=False
        )

    refused = show(fleet.tcp)
    assert refused.returncode == 2, refused.stdout
    assert "send there; select one of them with ?system=" in refused.stderr
    (row,) = json.loads(show(f"{fleet.tcp}?system=7").stdout)["parameters"]
    assert (row["name"], row["value"]) == ("SYSID_THISMAV", 7.0)


SPY = """
from MAVProxy.modules.lib import mp_module
class Spy(mp_module.MPModule):
    def idle_task(self):
        for key, vessel in self.module("ais").threat_vehicles.items():
            print("SEEN", key, vessel.state.lat, vessel.state.lon, flush=True)
def init(mpstate):
    return Spy(mpstate, "spy")
"""


@pytest.mark.skipif(
    importlib.util.find_spec("MAVProxy") is None, reason="MAVProxy is not installed: pip install MAVProxy"
)
def test_mavproxys_ais_has_the_other_vessels(fleet: Fleet, tmp_path: Path) -> None:
    """At the port of the first vessel; a module of ours tells what MAVProxy's own would draw. News come in 30 s."""
    (tmp_path / "spy.py").write_text(SPY)
    program = Path(sys.executable).with_name("mavproxy.py")
    words = [sys.executable, str(program), f"--master=tcp:127.0.0.1:{fleet.tcp_port + 10}", "--default-modules=ais,spy"]
    seen: dict[str, tuple[float, float]] = {}
    with subprocess.Popen(
        words, cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), *sys.path)), "PYTHONWARNINGS": "ignore"},
    ) as process:  # fmt: skip
        assert process.stdout is not None
        until_s = time.monotonic() + 2 * PATIENCE_S
        for line in process.stdout:
            assert "Traceback" not in line
            if line.startswith("SEEN"):
                _, key, lat, lon = line.split()
                seen[key] = float(lat) * 1e-7, float(lon) * 1e-7
            if len(seen) == 2 or time.monotonic() > until_s:
                break
        process.kill()
    assert set(seen) == {"AIS-200000002", "AIS-200000007"}
    assert all(place == pytest.approx((-8.8, -63.95), abs=5e-3) for place in seen.values())
    assert seen["AIS-200000002"][0] < seen["AIS-200000007"][0] - 20.0 / 110_600.0  # it lies south of it
