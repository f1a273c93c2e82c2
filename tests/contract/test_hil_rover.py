"""A real Rover on our sensors over its one MAVLink link: the script brought there by MAVLink FTP, then a bridge."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.assembly import assemble
from agent.mavlink.ftp import checksum, read_checksum
from agent.node import PROTOCOL
from agent.options import BRIDGE, Options
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from sim_core.geodesy import normal_gravity_mps2
from sim_core.sensors.magnetometer import local_field_ned_gauss
from tests.ardupilot import Rover
from xitl_cli.params.values import read_file
from xitl_cli.params.vehicle import VehicleFiles, connect
from xitl_cli.plugins.params.check import check_parameters, firmware_name
from xitl_cli.plugins.params.push import push, shipped_script

pytestmark = [pytest.mark.ardupilot, pytest.mark.realtime]
LAT_DEG, LON_DEG, ALT_M = -8.8, -63.95, 60.0
IMU_HZ, READY_S = 200, 60.0
HEARD, TAKEN, SCRIPT = 1, 2, 4


class Boat:
    """At rest, heading east; a host that sends its sensors in real time and keeps what the bridge says."""

    def __init__(self, url: str, opened: ExitStack) -> None:
        here, there = memory_pair()
        self.link = Link(here, 255, 190)
        self.node = assemble(there, Options(role=BRIDGE, autopilot=url, sensors="hil"), opened)
        self.newest: dict[str, Any] = {}
        self.said: list[str] = []
        self._random = np.random.default_rng(1)
        north, east, down = local_field_ned_gauss(LAT_DEG, LON_DEG, ALT_M, 2026.0).ned_gauss
        self._field_frd = np.array([east, -north, down])
        self._order(mav.XITL_RUN_COMMAND_START)
        self._start_s = time.monotonic()
        self._sent = [0, 0, 0]

    def _order(self, command: int) -> None:
        self.link.send(mav.MAVLink_xitl_run_message(0, b"test", command, mav.XITL_CLOCK_MODE_REALTIME, PROTOCOL))
        self.node.poll()
        self._take()

    def stop(self) -> None:
        self._order(mav.XITL_RUN_COMMAND_STOP)

    def _take(self) -> None:
        for message in self.link.receive():
            self.newest[message.get_type()] = message
            if message.get_type() == "STATUSTEXT":
                self.said.append(message.text)

    def _due(self, sensor: int, rate_hz: float, now_s: float) -> bool:
        if self._sent[sensor] >= now_s * rate_hz:
            return False
        self._sent[sensor] += 1
        return True

    def step(self) -> None:
        now_s = time.monotonic() - self._start_s
        now_us = round(now_s * 1e6)
        noise = self._random.normal
        if self._due(1, 50.0, now_s):
            field = self._field_frd + noise(0, 0.002, 3)
            self.link.send(
                mav.MAVLink_xitl_magnetometer_message(now_us, field.tolist()),
                mav.MAVLink_xitl_barometer_message(now_us, 100_600.0 + float(noise(0, 2)), 25.0),
            )
        while self._due(0, IMU_HZ, now_s):
            accel = noise(0, 0.02, 3) - np.array([0.0, 0.0, float(normal_gravity_mps2(LAT_DEG, ALT_M))])
            self.link.send(mav.MAVLink_xitl_imu_message(now_us, noise(0, 0.001, 3).tolist(), accel.tolist(), 25.0))
        if self._due(2, 5.0, now_s):
            north, east = noise(0, 3, 2)
            self.link.send(
                mav.MAVLink_xitl_gnss_message(
                    now_us,
                    round(LAT_DEG * 1e7 + north),
                    round(LON_DEG * 1e7 + east),
                    round(ALT_M * 1e3),
                    noise(0, 0.02, 3).tolist(),
                    0.8,
                    1.2,
                    0.1,
                    3,
                    12,
                )
            )
        self.node.poll(0.001)
        self._take()

    def run_until(self, done: Any, most_s: float) -> None:
        until_s = time.monotonic() + most_s
        while not done():
            assert time.monotonic() < until_s, (self.said, self.newest.get("XITL_BRIDGE_STATUS"))
            self.step()

    def status(self, bits: int) -> bool:
        status = self.newest.get("XITL_BRIDGE_STATUS")
        return status is not None and status.connected & bits == bits


def test_the_script_and_the_sensors_reach_stock_firmware(tmp_path: Path) -> None:
    wanted = read_file("rover-hil").values
    with ExitStack() as opened:
        rover = opened.enter_context(Rover(tmp_path))
        # From a vehicle that knows nothing of scripts, over restarts, to one that is as it should be.
        done = push(rover.mavlink, None, wanted, shipped_script(), reboot=True)
        assert [change for change in done.changes if change.reason] == []
        assert (done.script, done.written) == ("scripts/xitl_hil.lua", True)
        assert (tmp_path / "scripts" / "xitl_hil.lua").read_bytes() == shipped_script()
        with connect(rover.mavlink) as vehicle:
            assert check_parameters(wanted, vehicle.read_all()).fine
            assert firmware_name(vehicle).startswith("ArduPilot Rover")
            assert VehicleFiles(vehicle).run(read_checksum(done.script)) == checksum(shipped_script())
            assert VehicleFiles(vehicle).run(read_checksum("scripts/none.lua")) is None
        again = push(rover.mavlink, None, wanted, shipped_script(), reboot=True)
        assert (again.changes, again.written, again.restarts) == ((), False, 0)

        boat = Boat(rover.mavlink, opened)
        boat.run_until(lambda: boat.status(HEARD | TAKEN | SCRIPT), READY_S)
        prearm = mav.MAV_SYS_STATUS_PREARM_CHECK
        boat.run_until(
            lambda: (
                boat.newest.get("SYS_STATUS") is not None
                and boat.newest["SYS_STATUS"].onboard_control_sensors_health & prearm
            ),
            READY_S,
        )
        fix = boat.newest["GPS_RAW_INT"]
        assert fix.fix_type == 3
        assert (fix.lat, fix.lon) == pytest.approx((LAT_DEG * 1e7, LON_DEG * 1e7), abs=15)
        yaw_rad = 2.0 * np.arctan2(boat.newest["ATTITUDE_QUATERNION"].q4, boat.newest["ATTITUDE_QUATERNION"].q1)
        assert np.degrees(yaw_rad) == pytest.approx(90.0, abs=3.0)
        boat.stop()
        status = boat.newest["XITL_BRIDGE_STATUS"]
        assert status.unsent == 0
        sent = status.imu_out + status.gnss_out + status.solution_out
        # The script tells once a second, and not before the first time.
        assert sent - 3 * IMU_HZ < status.script_in <= sent
        assert status.script_out == status.script_in - status.script_dropped


def test_without_the_script_the_bridge_says_what_to_do(tmp_path: Path) -> None:
    with ExitStack() as opened:
        rover = opened.enter_context(Rover(tmp_path))
        boat = Boat(rover.mavlink, opened)
        boat.run_until(lambda: any("the script on the autopilot does" in text for text in boat.said), READY_S)
        assert not boat.status(SCRIPT)
        boat.stop()
