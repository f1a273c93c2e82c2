"""`sitl-px4` from end to end with a stand-in for PX4 that follows its documentation."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import Xitl, environment, summary

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.realtime


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def px4(simulator_port: int, mavlink_port: int) -> Iterator[subprocess.Popen[str]]:
    words = [sys.executable, "-m", "tests.doubles.px4_rover", str(simulator_port), str(mavlink_port)]
    process = subprocess.Popen(words, cwd=ROOT, env=environment(), stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def sail(xitl: Xitl) -> Callable[..., subprocess.CompletedProcess[str]]:
    """A run in still water to two near waypoints."""

    def run(simulator_port: int, mavlink_port: int, *more: str) -> subprocess.CompletedProcess[str]:
        settings = [
            f"autopilot.bridge.sensor_link=tcp://127.0.0.1:{simulator_port}",
            f"autopilot.bridge.mavlink=udp://127.0.0.1:{mavlink_port}",
            "mission.start={north_m: 0, east_m: 0, heading_deg: 0}",
            "mission.waypoints_ned_m=[[15, 5], [30, 20]]",
            "environment.current.speed_mps=0",
            "environment.current.deviation_mps=0",
            "environment.waves.spectrum=none",
            "environment.wind.mean_mps=0",
            "environment.wind.gust.spectrum=none",
            "environment.wind.discrete_gusts=[]",
            *more,
        ]
        words = [word for setting in settings for word in ("--set", setting)]
        return xitl("sim", "--profile", "sitl-px4", "--out", "run", "--duration", "90", *words)

    return run


def test_a_mission_over_px4_s_simulator_interface(
    sail: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    simulator_port, mavlink_port = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
    with px4(simulator_port, mavlink_port):
        done = sail(simulator_port, mavlink_port, "autopilot.parameters={RD_TEST: 7, RO_SPEED_LIM: 2.5}")
    assert done.returncode == 0, done.stderr + done.stdout
    result = summary(tmp_path / "run")
    assert result["mission"]["completed"]
    assert result["mission"]["waypoints_reached"] == 2
    autopilot = result["autopilot"]
    assert autopilot["kind"] == "px4"
    assert autopilot["time_to_ready_s"] <= autopilot["time_to_arm_s"] <= autopilot["time_to_motion_s"]
    bridge = autopilot["bridge"]
    rate_hz = bridge["imu_out"] / result["duration_s"]
    assert rate_hz == pytest.approx(200, rel=0.02)
    assert bridge["gnss_out"] / result["duration_s"] == pytest.approx(5, rel=0.1)
    assert (bridge["unsent"], bridge["restarts"], bridge["junk"]) == (0, 0, 0)
    assert "has not yet been run against PX4" in done.stdout + done.stderr


def test_a_px4_that_dies_under_way_ends_the_run(
    sail: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    simulator_port, mavlink_port = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
    with px4(simulator_port, mavlink_port) as process:
        threading.Timer(6.0, process.kill).start()
        done = sail(simulator_port, mavlink_port, "mission.waypoints_ned_m=[[3000, 0]]", "autopilot.silent_s=2")
    assert done.returncode == 2
    assert summary(tmp_path / "run")["error"]
