"""A fleet whose autopilots work in processes beside the host's: the same run, and one that is lost is named."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from conftest import payloads, summary

from xitl_cli.profile import load_profile
from xitl_cli.run import session
from xitl_cli.run.links.agent_workers import AgentWorkers
from xitl_cli.run.nodes.display import NoDisplay

pytestmark = pytest.mark.slow

WALL = ("started_utc", "wall_s", "real_time_factor")


def fleet(folder: Path, seconds: float) -> Any:
    (folder / "fleet.yaml").write_text(
        "extends: sitl\nvessels:\n  boat: {count: 3, formation: {shape: column, spacing_m: 15}}\n"
    )
    return load_profile(str(folder / "fleet.yaml"), [f"clock.duration_s={seconds}"])


def test_a_run_is_the_same_in_one_process_and_in_three(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, workers in (("one", None), ("three", AgentWorkers(2))):
        monkeypatch.setattr(session, "fleet_workers", lambda profiles, workers=workers: workers)
        session.run(fleet(tmp_path, 6.0), tmp_path / name, False, NoDisplay, timed=True)
    assert payloads(tmp_path / "one/run.mcap") == payloads(tmp_path / "three/run.mcap")
    for boat in ("boat_1", "boat_2", "boat_3"):
        log = (tmp_path / "one" / boat / "autopilot.bin").read_bytes()
        assert len(log) > 10_000
        assert (tmp_path / "three" / boat / "autopilot.bin").read_bytes() == log
    told = [{**summary(tmp_path / name), **dict.fromkeys(WALL)} for name in ("one", "three")]
    assert told[0] == told[1]


def test_a_process_that_is_killed_ends_the_run_with_its_vessels_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workers = AgentWorkers(1)
    monkeypatch.setattr(session, "fleet_workers", lambda profiles: workers)

    class Killing(NoDisplay):
        def due(self) -> bool:
            os.kill(workers._workers[0]._process.pid, signal.SIGKILL)
            return False

    result = session.run(fleet(tmp_path, 60.0), tmp_path / "run", False, Killing, timed=True)
    assert result.exit_code == session.USER_ERROR
    told = summary(tmp_path / "run")
    assert told["ended"] == "failed"
    assert told["error"].startswith(
        "boat_1: the process of the autopilot, and of those of boat_2, boat_3, ended: signal 9"
    )
