"""Any mix of autopilots in one water: in process, apart over UDP and a serial line, started by hand, and none."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from conftest import Xitl, command, environment, summary

PLACES = [(round(7.2 * number, 1), round(-9.6 * number, 1)) for number in range(5)]  # side by side, 12 m apart
VESSELS = {
    "inside": "{}",
    "apart": "{runs: process, link: 'udp://127.0.0.1:0'}",
    "line": "{runs: process, link: 'serial://pty?baud=921600'}",
    "away": "{runs: board, link: '%s', system_id: 9}",
    "bare": "{kind: none}",
}
DRIVER = "driver: {kind: script, script: [{at_s: 0, motors: [0.3, 0.3]}, {at_s: 2, end: true}]}, "


def mixed(link: str) -> str:
    lines = ["extends: sitl", "technique: hitl", "clock: {physics_rate_hz: 200}", "vessels:"]
    for (name, autopilot), (north_m, east_m) in zip(VESSELS.items(), PLACES, strict=True):
        start = f"{{north_m: {north_m}, east_m: {east_m}, heading_deg: 36.87}}"
        ahead = f"[[{north_m + 6.4:.1f}, {east_m + 4.8:.1f}]]"
        driver = DRIVER if name == "bare" else ""
        own = autopilot % link if "%s" in autopilot else autopilot
        lines.append(f"  {name}: {{autopilot: {own}, {driver}mission: {{start: {start}, waypoints_ned_m: {ahead}}}}}")
    return "\n".join(lines)


@pytest.mark.slow
def test_every_way_of_running_an_autopilot_in_one_lockstep_run(xitl: Xitl, tmp_path: Path, free_port: int) -> None:
    link = f"udp://127.0.0.1:{free_port}"
    (tmp_path / "mix.yaml").write_text(mixed(link))
    agent = subprocess.Popen(
        command("agent", "--link", link, "--system-id", "9"), env=environment(), stdout=subprocess.PIPE, text=True
    )
    try:
        assert agent.stdout is not None
        assert agent.stdout.readline()
        result = xitl("sim", "--profile", "mix.yaml", "--out", "run")
    finally:
        agent.terminate()
        agent.communicate()
    assert result.returncode == 0, result.stdout + result.stderr
    told = summary(tmp_path / "run")["vessels"]
    assert {name: one["system_id"] for name, one in told.items() if name != "bare"} == {
        "inside": 1,
        "apart": 2,
        "line": 3,
        "away": 9,
    }
    for name in ("inside", "apart", "line", "away"):
        assert told[name]["driver"]["completed"], name
        assert all(one["lost"] == 0 and one["received"] for one in told[name]["links"]), name
    for name in ("inside", "apart", "line"):
        assert (tmp_path / "run" / name / "autopilot.bin").stat().st_size, name
