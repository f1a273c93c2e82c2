"""`sitl-px4` from end to end with a real PX4, where there is one."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Xitl, assert_one_line_error, command, environment, summary

from tests.px4 import px4_program
from xitl_cli.logs.formats import open_log

pytestmark = [pytest.mark.px4, pytest.mark.realtime]  # before it arms, PX4 is given the time of the wall
PROFILE = ("--profile", "sitl-px4")


def sim(xitl: Xitl, *words: str) -> subprocess.CompletedProcess[str]:
    return xitl("sim", *PROFILE, "--firmware", str(px4_program()), "--out", "run", *words, timeout_s=300)


def px4s_in(directory: Path) -> list[int]:
    """Processes that work below the directory."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if str((process / "cwd").readlink()).startswith(str(directory)):
                found.append(int(process.name))
        except OSError:
            continue
    return found


def check_run(told: dict[str, Any]) -> None:
    autopilot = told["autopilot"]
    assert (autopilot["kind"], autopilot["vehicle"]) == ("px4", "ground rover")
    times = [autopilot[f"time_to_{what}_s"] for what in ("heartbeat", "origin", "ready", "arm", "motion")]
    assert times == sorted(times)
    bridge = autopilot["bridge"]
    assert bridge["imu_out"] == pytest.approx(100 * told["duration_s"], rel=0.01)
    assert bridge["outputs_in"] == pytest.approx(100 * (told["duration_s"] - autopilot["time_to_arm_s"]), rel=0.02)
    assert (bridge["unsent"], bridge["restarts"], bridge["junk"]) == (0, 0, 0)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_mission_in_gusts(xitl: Xitl, tmp_path: Path, seed: int) -> None:
    done = sim(xitl, "--seed", str(seed))
    told = summary(tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert told["mission"]["waypoints_reached"] == 6
    assert told["mission"]["cross_track_rms_m"] < 2.5
    assert told["estimation"]["position_rms_m"] < 1.5  # the receiver wanders by 0.5 m on each axis
    assert told["estimation"]["heading_rms_deg"] < 2.0
    check_run(told)
    assert (tmp_path / "run" / "autopilot.ulg").read_bytes()[:4] == b"ULog"
    assert "Disarmed by external command" in (tmp_path / "run" / "autopilot" / "console.txt").read_text()
    assert px4s_in(tmp_path) == []


@pytest.mark.parametrize(
    ("sensor", "why"), [("barometer", "Preflight Fail: barometer 0 missing"), ("gnss", "not healthy: position")]
)
def test_one_that_does_not_arm_tells_why(xitl: Xitl, sensor: str, why: str) -> None:
    fault = f"faults.blind={{from_s: 0, until_s: 100, {sensor}: {{dropout: 1}}}}"
    done = sim(xitl, "--set", fault, "--set", "autopilot.arm_timeout_s=12")
    assert_one_line_error(done, "gave up after 12 s of waiting", why)


def test_a_parameter_that_it_does_not_have_ends_the_run(xitl: Xitl) -> None:
    done = sim(xitl, "--set", "autopilot.parameters.RO_SPED_LIM=3")
    assert_one_line_error(done, "autopilot.parameters.RO_SPED_LIM", "xitl params check")


def test_two_at_once_have_instances_of_their_own(tmp_path: Path) -> None:
    words = ["sim", *PROFILE, "--firmware", str(px4_program()), "--duration", "8", "--json", "--out"]
    runs = [
        subprocess.Popen(command(*words, name), cwd=tmp_path, env=environment(), stdout=subprocess.DEVNULL)
        for name in ("a", "b")
    ]
    until_s = time.monotonic() + 120
    codes = [run.wait(timeout=until_s - time.monotonic()) for run in runs]
    assert 2 not in codes
    for name in ("a", "b"):
        assert summary(tmp_path / name)["autopilot"]["time_to_arm_s"] is not None


GUIDED = """
extends: sitl-px4
mission: {start: {north_m: 0, east_m: 0, heading_deg: 0}, waypoints_ned_m: []}
driver:
  kind: script
  script:
    - {at_s: 4, arm: true}
    - {at_s: 6, mode: GUIDED, goto_ned_m: [25, 10]}
    - {at_s: 25, mode: HOLD}
    - {at_s: 27, end: true}
environment: {current: {speed_mps: 0, deviation_mps: 0}}
"""


def test_it_goes_to_a_place_in_guided(xitl: Xitl, tmp_path: Path) -> None:
    (tmp_path / "guided.yaml").write_text(GUIDED)
    words = ("--profile", "guided.yaml", "--firmware", str(px4_program()), "--out", "run")
    done = xitl("sim", *words, timeout_s=200)
    assert done.returncode == 0, done.stderr
    assert summary(tmp_path / "run")["driver"]["completed"]
    with open_log(tmp_path / "run" / "run.mcap") as log:
        truth = log.tables["/truth/odometry"]
        north, east = (truth.values(f"pose.pose.position.{axis}") for axis in "yx")  # ENU
    assert np.hypot(north - 25.0, east - 10.0).min() < 4.0  # NAV_ACC_RAD is 3 m, its receiver wanders
