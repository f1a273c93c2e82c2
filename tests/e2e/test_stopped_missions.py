"""Missions that a failsafe, a fence or an operator stops: the run names the cause."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from conftest import Xitl, summary

from xitl_cli.logs import open_log

FENCED = """\
extends: sitl
clock: {duration_s: 36.0}
autopilot:
  parameters: {FENCE_ENABLE: 1, FENCE_TYPE: 2, FENCE_RADIUS: 40, FENCE_ACTION: 1}
"""
pytestmark = pytest.mark.slow


def test_a_fence_breach_is_named_in_verdict_summary_and_recording(xitl: Xitl, tmp_path: Path) -> None:
    (tmp_path / "fenced.yaml").write_text(FENCED)
    done = xitl("sim", "-p", "fenced.yaml", "--out", "run")
    assert done.returncode == 1
    told = summary(tmp_path / "run")
    why = told["verdict"]["why"]
    assert why.startswith("stopped by RTL (Fence breached) at ")
    assert f"not completed: {why}" in " ".join(done.stdout.split())
    assert "failsafe Fence breached, RTL at " in " ".join(done.stdout.split())
    events = {event["event"]: event for event in told["autopilot_events"]}
    change = events["mode"]
    assert (change["mode"], change["mode_before"], change["reason"]) == ("RTL", "AUTO", "Fence breached, RTL")
    assert 0.0 <= change["at_s"] - events["failsafe"]["at_s"] <= 1.0  # a heartbeat a second
    with open_log(tmp_path / "run" / "run.mcap") as log:
        rows = log["/autopilot/events"]
        recorded = [
            {key: rows[key][number] for key in ("at_s", "event", "mode", "mode_before", "reason")}
            for number in range(len(rows))
        ]
        said = log["/log"]["message"].tolist()
    assert recorded == told["autopilot_events"]
    assert f"mode RTL after AUTO at {change['at_s']:.1f} s: Fence breached, RTL" in said


def test_a_place_ordered_by_an_operator_is_no_cross_track_error(xitl: Xitl, tmp_path: Path) -> None:
    """In GUIDED the vessel follows no leg of the mission: 60 m beside it are not counted."""
    orders: list[dict[str, Any]] = [{"time_s": 25.0, "action": "goto", "north_m": 10.0, "east_m": -60.0}]
    (tmp_path / "orders.jsonl").write_text("".join(f"{json.dumps(order)}\n" for order in orders))
    plain = ("--set", "clock.duration_s=24", "--out", "plain")
    ordered = ("--set", "clock.duration_s=50", "--out", "run", "--replay-events", "orders.jsonl")
    for arguments in (plain, ordered):
        assert xitl("sim", "--profile", "sitl", *arguments).returncode == 1
    told = summary(tmp_path / "run")
    assert told["verdict"]["why"] == "stopped by GUIDED at 25.0 s; 1 of 6 waypoints"
    before, after = summary(tmp_path / "plain")["mission"], told["mission"]
    assert after["cross_track_max_m"] == before["cross_track_max_m"]
    assert after["cross_track_rms_m"] == pytest.approx(before["cross_track_rms_m"], rel=0.2)
