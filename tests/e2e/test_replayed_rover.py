"""`sitl-ardupilot` from end to end with a stand-in that sends again, frame by frame, what a real ArduRover sent."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest
from conftest import command, environment, summary

from tests.golden import Golden
from tests.patience import PATIENCE_S, wait_until

TESTS = Path(__file__).parents[1]
DOUBLE = TESTS / "doubles" / "replayed_rover.py"
CAPTURE = TESTS / "data" / "captures" / "sitl-ardupilot.xz"
FIRST_WAYPOINT_CLOSEST_M = 1.58
DEATH = 60_000  # of 1200 frames a second: under way


def run(folder: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command("sim", "--profile", "sitl-ardupilot", "--firmware", str(DOUBLE), "--out", "run", *arguments),
        cwd=folder,
        env={**environment(), "XITL_CAPTURE": str(CAPTURE), "PYTHONPATH": os.pathsep.join(_paths()), **variables},
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )


def _paths() -> list[str]:
    return [path for path in (str(TESTS.parent), os.environ.get("PYTHONPATH", "")) if path]


@pytest.mark.realtime
def test_the_mission_that_was_captured_is_sailed_again(tmp_path: Path) -> None:
    done = run(tmp_path)
    assert done.returncode == 0, done.stderr
    result = summary(tmp_path / "run")
    assert result["mission"]["completed"]
    assert result["mission"]["waypoints_reached"] == 6
    # The boat is released some ticks of 10 ms before or after the capture's release. Each moves it by 2 cm where it
    # passes the first waypoint, 10 s later. Over a minute, waves carry such courses apart (docs/seas.md): behind this
    # waypoint, the way is not compared. tests/e2e/test_ardupilot.py compares it with the real program.
    assert result["mission"]["closest_m"][0] == pytest.approx(FIRST_WAYPOINT_CLOSEST_M, abs=0.12)
    autopilot = result["autopilot"]
    assert autopilot["vehicle"] == "surface boat"
    assert autopilot["firmware"].startswith("4.7")
    assert 0 < autopilot["time_to_heartbeat_s"] < autopilot["time_to_origin_s"] < autopilot["time_to_ready_s"]
    assert autopilot["time_to_ready_s"] <= autopilot["time_to_arm_s"] < autopilot["time_to_motion_s"]
    bridge = autopilot["bridge"]
    assert bridge["world_rate"] == 1200
    assert bridge["world_lost"] == bridge["world_resent"] == bridge["restarts"] == 0
    assert bridge["world_in"] == pytest.approx(1200 * result["duration_s"], abs=1200)
    assert bridge["mavlink_lost"] == 0
    assert (tmp_path / "run" / "autopilot" / "console.txt").read_text().endswith("Exitting\n")  # it ended in order
    events = [(event["event"], event["mode"], event["reason"]) for event in result["autopilot_events"]]
    assert events == [("mode", "MANUAL", ""), ("armed", "AUTO", ""), ("mode", "AUTO", "")]


@pytest.mark.realtime
def test_an_autopilot_that_dies_under_way_ends_the_run_with_its_last_words(tmp_path: Path, golden: Golden) -> None:
    done = run(tmp_path, XITL_REPLAY_DIES=str(DEATH))
    assert done.returncode == 2
    golden("stderr", done.stderr)
    result = summary(tmp_path / "run")
    assert result["ended"] == "failed"
    assert result["duration_s"] == pytest.approx(DEATH / 1200, abs=1.0)


@pytest.mark.realtime
def test_an_interrupted_run_lets_the_autopilot_end_in_order(tmp_path: Path) -> None:
    console, recording = tmp_path / "run" / "autopilot" / "console.txt", tmp_path / "run" / "run.mcap"
    words = command("sim", "--profile", "sitl-ardupilot", "--firmware", str(DOUBLE), "--out", "run")
    variables = {**environment(), "XITL_CAPTURE": str(CAPTURE), "PYTHONPATH": os.pathsep.join(_paths())}
    with subprocess.Popen(words, cwd=tmp_path, env=variables, stdout=subprocess.DEVNULL) as process:
        wait_until(lambda: recording.is_file() and recording.stat().st_size > 50_000)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130
    assert summary(tmp_path / "run")["ended"] == "interrupted"
    assert console.read_text().endswith("Exitting\n")
