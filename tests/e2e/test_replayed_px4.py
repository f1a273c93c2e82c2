"""`sitl-px4` from end to end with a stand-in that sends again what a real PX4 sent."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import summary

from agent.bridges import px4

TESTS = Path(__file__).parents[1]
DATA = TESTS / "data" / "px4"
CAPTURED = {"cross_track_rms_m": 0.33, "closest_m": 3.0}
DEATH = 900  # of 100 samples a second: under way
pytestmark = pytest.mark.slow

Sim = Callable[..., tuple[int, str, dict[str, Any]]]


@pytest.fixture
def sim(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Sim:
    """A run of what was captured, in this process, where the stand-in needs no time before it arms."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "etc" / "init.d-posix").mkdir(parents=True)
    (tmp_path / "etc" / "init.d-posix" / "rcS").touch()
    program = tmp_path / "bin" / "px4"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {TESTS / "doubles" / "replayed_px4.py"} "$@"\n')
    program.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(px4, "PACE", 20.0)

    def run(capture: str, *words: str) -> tuple[int, str, dict[str, Any]]:
        from xitl_cli.main import main

        monkeypatch.setenv("XITL_CAPTURE", str(DATA / capture))
        profile = ["--profile", str(DATA / "mission.yaml"), "--firmware", str(program), "--out", "run"]
        monkeypatch.setattr("sys.argv", ["xitl", "sim", *profile, *words])
        with pytest.raises(SystemExit) as ended:
            main()
        told = capsys.readouterr()
        return int(ended.value.code or 0), told.err + told.out, summary(tmp_path / "run")

    return run


def test_the_mission_that_was_captured_is_sailed_again(sim: Sim) -> None:
    code, said, told = sim("mission.xz")
    assert code == 0, said
    assert told["mission"]["waypoints_reached"] == 2
    # From its release on the vessel is a function of the outputs, frame by frame.
    assert told["mission"]["cross_track_rms_m"] == pytest.approx(CAPTURED["cross_track_rms_m"], abs=0.1)
    assert max(told["mission"]["closest_m"]) < CAPTURED["closest_m"]
    autopilot = told["autopilot"]
    assert (autopilot["kind"], autopilot["vehicle"], autopilot["firmware"][:6]) == ("px4", "ground rover", "1.16.0")
    times = [autopilot[f"time_to_{what}_s"] for what in ("heartbeat", "origin", "ready", "arm", "motion")]
    assert times == sorted(times)
    events = [(event["event"], event["mode"], event["reason"]) for event in told["autopilot_events"]]
    assert ("mode", "AUTO", "") in events
    assert [reason for _, _, reason in events if reason] == []
    bridge = autopilot["bridge"]
    assert bridge["imu_out"] == pytest.approx(100 * told["duration_s"], abs=2)
    assert (bridge["unsent"], bridge["restarts"], bridge["junk"]) == (0, 0, 0)
    # Its own estimate from our sensors, told over MAVLink and stamped by its clock. The receiver wanders by 0.5 m.
    assert told["estimation"]["position_rms_m"] < 1.5
    assert told["estimation"]["heading_rms_deg"] < 2.0


def test_one_that_dies_under_way_ends_the_run_with_its_last_words(sim: Sim, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XITL_REPLAY_DIES", str(DEATH))
    code, said, told = sim("mission.xz")
    assert code == 2
    assert "px4 ended by itself (signal 6 ended it); its last output: Segmentation fault" in " ".join(said.split())
    assert told["duration_s"] == pytest.approx(DEATH / 100, abs=1.0)


def test_one_that_does_not_arm_tells_why(sim: Sim) -> None:
    code, said, _ = sim("refused.xz", "--set", "autopilot.arm_timeout_s=7")
    assert code == 2
    why = "gave up after 7 s of waiting for the autopilot to become ready to arm; it said: Preflight Fail: barometer 0"
    number = "the autopilot is MAVLink system 101, but this vessel is 1"  # the captured one was instance 100
    assert f"{why} missing; the bridge reports: {number}" in " ".join(said.split())
