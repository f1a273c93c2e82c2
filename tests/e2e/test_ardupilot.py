"""Real ArduPilot Rover from the command line: every way of attaching it, and what is said when it cannot be."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from conftest import Xitl, assert_one_line_error, command, environment, summary

from tests.ardupilot import find_ardurover
from tests.patience import wait_until

pytestmark = [pytest.mark.realtime, pytest.mark.ardupilot]

SITL = ["--profile", "sitl-ardupilot"]


def sim(xitl: Xitl, *arguments: str, build: str = "sitl", timeout_s: float = 300.0) -> Any:
    return xitl("sim", "--firmware", str(find_ardurover(build)), "--out", "run", *arguments, timeout_s=timeout_s)


def ardurovers_of(folder: Path) -> list[str]:
    """Processes whose working directory is in the folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                if folder in (entry / "cwd").readlink().parents and "ardurover" in (entry / "exe").readlink().name:
                    found.append(entry.name)
            except OSError:
                continue
    return found


def check_times(autopilot: dict[str, Any]) -> None:
    times = [autopilot[f"time_to_{name}_s"] for name in ("heartbeat", "origin", "ready", "arm", "motion")]
    assert times == sorted(times)
    assert 5.0 < times[2] < 120.0  # its estimator takes some 40 s to align


def check_no_stall(run: Path) -> None:
    """It repeats a request that nobody answers for a second, and says so."""
    assert "resending servos" not in (run / "autopilot" / "console.txt").read_text()


def test_fewer_frames_and_exchanges_sail_the_mission_too(xitl: Xitl, tmp_path: Path) -> None:
    told = json.loads(sim(xitl, "--profile", "sitl-ardupilot-fast", "--json").stdout)
    assert told["mission"]["completed"]
    assert told["mission"]["cross_track_rms_m"] < 1.0
    assert told["estimation"]["position_rms_m"] < 0.5
    bridge = told["autopilot"]["bridge"]
    assert bridge["world_rate"] == 400
    assert bridge["world_in"] < 500 * told["duration_s"]  # it requests 1200 a second during its first seconds
    assert bridge["world_lost"] == bridge["world_resent"] == 0
    assert told["autopilot"]["scheduler"]["long_loops"] == 0
    check_no_stall(tmp_path / "run")


@pytest.mark.parametrize(("profile", "off_m"), [("sitl-ardupilot", 0.5), ("sitl-ardupilot-ahrs", 1.5)])
def test_the_mission_closes_in_lockstep(xitl: Xitl, tmp_path: Path, profile: str, off_m: float) -> None:
    result = sim(xitl, "--profile", profile, "--json")
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    assert told["mission"]["completed"]
    assert told["mission"]["cross_track_rms_m"] < 1.0
    assert told["estimation"]["position_rms_m"] < off_m
    check_times(told["autopilot"])
    bridge = told["autopilot"]["bridge"]
    # Every frame of the 1200 a second that it asked for was answered, once.
    assert bridge["world_rate"] == 1200
    assert bridge["world_in"] == pytest.approx(1200 * told["duration_s"], abs=1200)
    assert bridge["world_lost"] == bridge["world_resent"] == bridge["restarts"] == 0
    check_no_stall(tmp_path / "run")
    if profile.endswith("ahrs"):
        assert bridge["imu_out"] == pytest.approx(200 * told["duration_s"], rel=0.05)
        assert bridge["gnss_out"] == pytest.approx(5 * told["duration_s"], rel=0.05)
    assert told["driver"]["moored_s"] == pytest.approx(told["autopilot"]["time_to_arm_s"], abs=0.1)
    assert told["autopilot"]["scheduler"]["rows"] > 10
    assert told["autopilot"]["clock"] == "simulated"
    assert told["graph"]["missing"] == told["graph"]["unclaimed"] == []
    assert (tmp_path / "run" / "autopilot.bin").stat().st_size > 1_000_000
    assert ardurovers_of(tmp_path) == []


@pytest.mark.parametrize(
    ("profile", "build", "clock"),
    [
        ("hitl-ardupilot-ahrs-loopback", "sitl", "simulated"),
        ("hitl-ardupilot-usb-loopback", "sitl", "simulated"),
        ("hitl-ardupilot-linux-loopback", "linux", "real"),
    ],
)
def test_it_arms_and_sails_on_our_sensors_in_real_time(
    xitl: Xitl, tmp_path: Path, free_port: int, profile: str, build: str, clock: str
) -> None:
    away = ["--set", f"autopilot.link=udp://127.0.0.1:{free_port}"] if build == "linux" else []
    result = sim(xitl, "--profile", profile, "--duration", "80", *away, build=build)  # some 45 until it arms
    assert result.returncode == 0, result.stderr
    told = summary(tmp_path / "run")
    assert told["error"] is None, result.stderr
    assert told["ended"] == "duration reached"
    assert told["mission"]["waypoints_reached"] >= 1
    assert told["estimation"]["position_rms_m"] < 2.0
    check_times(told["autopilot"])
    bridge = told["autopilot"]["bridge"]
    frames = bridge["script_out"] if "usb" in profile else bridge["imu_out"]
    assert frames > 100 * told["duration_s"]
    assert told["autopilot"]["clock"] == clock
    assert told["autopilot"]["scheduler"]["rows"] > 3
    clocks = {entry["node"]: entry for entry in told["clocks"]}
    assert clocks["autopilot"]["steps"] == 0
    assert clocks["autopilot"]["offset_us"] is not None
    assert clocks["autopilot"]["samples"] > 5  # since it last seemed to step, as that of a SITL build does
    assert ardurovers_of(tmp_path) == []


def test_one_that_never_arms_tells_its_reasons(xitl: Xitl) -> None:
    asked = ["--set", "autopilot.parameters.RC1_TRIM=1900", "--set", "autopilot.arm_timeout_s=70"]
    refused = ["--set", "autopilot.parameters.ARMING_CHECK=1", "--set", "autopilot.parameters.GPS1_TYPE=0"]
    result = sim(xitl, *SITL, *asked, *refused)
    assert_one_line_error(result, "gave up after 70 s of waiting for the autopilot", "it said: ", "PreArm: ")


def test_a_parameter_that_it_does_not_have_ends_the_run(xitl: Xitl) -> None:
    result = sim(xitl, *SITL, "--set", "autopilot.parameters.WP_SPED=3")
    assert_one_line_error(result, "autopilot.parameters.WP_SPED", "xitl params check")


def test_an_external_one_that_is_not_there_is_missed_with_its_address(xitl: Xitl, free_port: int) -> None:
    there = [f"autopilot.bridge.mavlink=tcp://127.0.0.1:{free_port}", "autopilot.firmware=external"]
    world = f"autopilot.bridge.world=udp://127.0.0.1:{free_port}"
    patience = ("autopilot.connect_timeout_s=2", "autopilot.silent_s=2")
    overrides = [word for text in (*there, world, *patience) for word in ("--set", text)]
    result = xitl("sim", *SITL, *overrides, "--out", "run")
    assert_one_line_error(result, f"udp://127.0.0.1:{free_port}", "no autopilot connected within 2 s")


def recorded_bytes(run: Path) -> int:
    recording = run / "run.mcap"
    return recording.stat().st_size if recording.exists() else 0


def test_one_that_is_killed_under_way_ends_the_run_and_keeps_the_recording(tmp_path: Path) -> None:
    program = str(find_ardurover())
    words = ["sim", *SITL, "--firmware", program, "--out", "run"]
    with subprocess.Popen(
        command(*words), cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        wait_until(lambda: ardurovers_of(tmp_path))
        wait_until(lambda: recorded_bytes(tmp_path / "run") > 10_000)
        for pid in ardurovers_of(tmp_path):
            os.kill(int(pid), signal.SIGKILL)
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "ended by itself (signal 9 ended it)" in stderr
    assert (tmp_path / "run" / "run.mcap").stat().st_size > 10_000
    assert summary(tmp_path / "run")["ended"] == "failed"


def test_it_ends_with_an_xitl_that_is_killed(tmp_path: Path) -> None:
    words = ["sim", *SITL, "--firmware", str(find_ardurover()), "--out", "run"]
    with subprocess.Popen(command(*words), cwd=tmp_path, env=environment(), stdout=subprocess.DEVNULL) as process:
        wait_until(lambda: ardurovers_of(tmp_path))
        process.kill()
        process.wait()
    wait_until(lambda: not ardurovers_of(tmp_path))


def test_two_runs_at_once_do_not_meet(tmp_path: Path) -> None:
    words = ["sim", *SITL, "--firmware", str(find_ardurover()), "--duration", "5", "--json", "--out"]
    runs = [
        subprocess.Popen(command(*words, name), cwd=tmp_path, env=environment(), stdout=subprocess.DEVNULL)
        for name in ("a", "b")
    ]
    assert [run.wait(timeout=300) for run in runs] == [0, 0]
    for name in ("a", "b"):
        told = summary(tmp_path / name)
        assert told["ended"] == "duration reached"
        assert told["autopilot"]["bridge"]["world_lost"] == 0
