"""A run held for a ground station, and parameters of the agent, over the addresses that a person would use."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Xitl, command, environment, payloads, summary
from pymavlink.dialects.v20 import ardupilotmega as mav

from sim_core.geodesy import LocalFrame
from tests.patience import PATIENCE_S, let_pass, wait_until
from xitl_cli.plugins.view.recording import open_scene

FRAME = LocalFrame(-8.80, -63.95, 70.0)
MANUAL, AUTO = 0, 10


class Station:
    """A ground station on pymavlink's codec."""

    def __init__(self, port: int) -> None:
        self._socket = _connect(port)
        self._codec = mav.MAVLink(self, 255, 190)
        self._codec.robust_parsing = True
        self._beat_s = 0.0

    def write(self, data: bytes) -> None:
        self._socket.sendall(bytes(data))

    def close(self) -> None:
        self._socket.close()

    def wait(self, wanted: Callable[[Any], bool]) -> Any:
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            if time.monotonic() - self._beat_s > 0.5:
                self._beat_s = time.monotonic()
                self._codec.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4)
            try:
                data = self._socket.recv(65536)
            except TimeoutError:
                continue
            for message in self._codec.parse_buffer(bytearray(data)) or []:
                if wanted(message):
                    return message
        raise AssertionError("the vehicle did not say what was waited for")

    def order(self, number: int, *parameters: float) -> None:
        """Sent until accepted."""

        def accepted(message: Any) -> bool:
            if message.get_type() != "COMMAND_ACK" or message.command != number:
                return False
            if message.result != mav.MAV_RESULT_ACCEPTED:
                let_pass(0.3)
                send()
            return bool(message.result == mav.MAV_RESULT_ACCEPTED)

        def send() -> None:
            values = [*parameters, *[0.0] * (7 - len(parameters))]
            self._codec.command_long_send(1, 1, number, 0, *values)

        send()
        self.wait(accepted)

    def upload(self, places: list[tuple[float, float]]) -> None:
        lat, lon, _ = FRAME.geodetic(np.array([[north, east, 0.0] for north, east in [(0.0, 0.0), *places]]))
        self._codec.mission_count_send(1, 1, len(lat))

        def answered(message: Any) -> bool:
            if message.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                seq = message.seq
                item = (16, 0, 1, 0, 0, 0, 0, round(lat[seq] * 1e7), round(lon[seq] * 1e7), 0.0)
                self._codec.mission_item_int_send(1, 1, seq, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, *item)
            return bool(message.get_type() == "MISSION_ACK")

        assert self.wait(answered).type == mav.MAV_MISSION_ACCEPTED


def _connect(port: int) -> socket.socket:
    def connected() -> socket.socket | None:
        try:
            return socket.create_connection(("127.0.0.1", port), timeout=0.2)
        except OSError:
            return None

    return wait_until(connected, f"nothing listens at TCP port {port}")


@pytest.fixture
def held(tmp_path: Path, free_port: int) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a run that waits for a ground station; whatever is left of it is ended."""
    started = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        address = f"autopilot.ground_stations=[tcp://127.0.0.1:{free_port}]"
        profile = ("sim", "--profile", "ground-station", "--set", address, "--out", "run")
        process = subprocess.Popen(
            command(*profile, *arguments),
            cwd=tmp_path,
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.mark.slow
def test_a_ground_station_draws_flies_and_the_run_ends_with_its_mission(
    held: Callable[..., subprocess.Popen[str]], tmp_path: Path, free_port: int
) -> None:
    """Two waypoints 12 m apart in still water; the profile's own mission of six is replaced by them."""
    (tmp_path / "calm.yaml").write_text("extends: [ground-station, environments/calm]\n")
    process = held("--profile", "calm.yaml")
    assert process.stdout is not None
    first = process.stdout.readline()
    assert "waits for a ground station to arm the vessel" in first
    assert f"listens at TCP 127.0.0.1:{free_port}" in first
    station = Station(free_port)
    try:
        station.upload([(12.0, 9.0), (20.0, 15.0)])
        station.order(mav.MAV_CMD_DO_SET_MODE, 1, MANUAL)
        station.order(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        station.order(mav.MAV_CMD_DO_SET_MODE, 1, AUTO)
        process.wait(PATIENCE_S)
    finally:
        station.close()
    assert process.returncode == 0, process.stderr and process.stderr.read()
    told = summary(tmp_path / "run")
    assert told["ended"] == "finished"
    assert told["driver"]["kind"] == "ground-station"
    assert told["driver"]["completed"]
    assert told["driver"]["moored_s"] > 0.0
    assert told["mission"]["waypoints_total"] == told["mission"]["waypoints_reached"] == 2
    assert max(told["mission"]["closest_m"]) < 3.0 + 1.5  # radius and the estimate's error
    assert (tmp_path / "run/autopilot.bin").stat().st_size > 0
    with open_scene([tmp_path / "run/run.mcap"]) as recording:  # what is drawn is the mission under way
        begin, end = (recording.instant(at_s).vessels[""] for at_s in recording.span_s)
    assert begin.mission_enu_m is not None
    assert end.mission_enu_m is not None
    assert (begin.waypoints_reached, begin.waypoints_total, len(begin.mission_enu_m)) == (0, 6, 7)
    assert (end.waypoints_reached, end.waypoints_total) == (2, 2)
    assert end.mission_enu_m[1:] == pytest.approx(np.array([[9.0, 12.0, 0.1], [15.0, 20.0, 0.1]]), abs=0.02)
    sent = {int.from_bytes(data[23:26], "little") for _, data in payloads(tmp_path / "run/run.mcap")["/link/agent/tx"]}
    assert mav.MAVLINK_MSG_ID_COMMAND_LONG not in sent  # the host gave no order


@pytest.mark.slow
def test_an_interrupt_ends_a_run_that_waits(
    held: Callable[..., subprocess.Popen[str]], tmp_path: Path, free_port: int
) -> None:
    process = held("--duration", "60")
    assert process.stdout is not None
    assert "waits for" in process.stdout.readline()
    let_pass(1.0)  # for which it waits
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, stderr) == (130, "")
    told = summary(tmp_path / "run")
    assert told["driver"]["moored_s"] == pytest.approx(told["duration_s"], abs=1e-9)
    assert told["duration_s"] > 0.5
    assert not told["driver"]["completed"]


@pytest.mark.slow
def test_the_duration_counts_the_time_for_which_the_vessel_is_frozen(
    held: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    process = held("--duration", "1")
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert "ended: duration reached, no mission, the vessel was never armed and stayed frozen" in " ".join(said.split())
    told = summary(tmp_path / "run")
    assert told["duration_s"] == told["driver"]["moored_s"] == pytest.approx(1.0)


@pytest.mark.slow
def test_parameters_of_the_embedded_autopilot_are_pushed_and_pulled(xitl: Xitl, tmp_path: Path, free_port: int) -> None:
    agent = subprocess.Popen(
        command("agent", "--link", f"udp://127.0.0.1:{free_port}", "--gcs", f"tcp://127.0.0.1:{free_port}"),
        env=environment(),
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert agent.stdout is not None
        agent.stdout.readline()
        url = f"tcp://127.0.0.1:{free_port}"
        assert xitl("params", "diff", url, "defaults").returncode == 0
        (tmp_path / "boat.parm").write_text("WP_SPEED 2.5\nWP_RADIUS 2000\nLOS_LOOKAHEAD 7.3\n")
        result = xitl("params", "push", "boat.parm", url, "--json")
        assert result.returncode == 2
        told = json.loads(result.stdout)
        assert {change["name"] for change in told["set"]} == {"WP_SPEED", "LOS_LOOKAHEAD"}
        assert "WP_RADIUS = 2000 is out of range" in told["refused"][0]["reason"]
        assert "WP_RADIUS" in result.stderr
        assert xitl("params", "set", url, "LOS_LOOKAHEAD=8").returncode == 0
        assert xitl("params", "pull", url, "all.parm").returncode == 0
        lines = (tmp_path / "all.parm").read_text().splitlines()
        assert next(line for line in lines if line.startswith("LOS_LOOKAHEAD")).split()[1] == "8"
        result = xitl("params", "diff", "all.parm", "defaults", "--json")
        assert {one["name"] for one in json.loads(result.stdout)["differences"]} == {"WP_SPEED", "LOS_LOOKAHEAD"}
        shown = json.loads(xitl("params", "show", url, "--filter", "WP_SPEED", "--json").stdout)["parameters"]
        assert (shown[0]["value"], shown[0]["unit"]) == (2.5, "m/s")
    finally:
        agent.terminate()
        agent.communicate(timeout=PATIENCE_S)
