"""What a campaign will take, before it runs: `xitl campaign PLAN --dry-run`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.command_line import xitl_app
from tests.golden import Golden
from xitl_cli.plugins.campaign.command import cost_text, size_text
from xitl_cli.plugins.campaign.estimate import RunCost, course_s, run_cost
from xitl_cli.plugins.campaign.execution import COMPLETED
from xitl_cli.plugins.campaign.plan import PlanError, read_plan
from xitl_cli.plugins.campaign.results import CampaignFolder
from xitl_cli.profile.schema.agents import MissionSpec, StartSpec

ENOUGH_S = 300.0
PLAN = """
base: sitl
axes:
  environment.wind.mean_mps: [0, 6]
seeds: 1-3
recordings: all
verdicts: [driver.completed, mission.cross_track_rms_m < 2]
"""


def short_runs(duration_s: float, folder: Path) -> dict[str, Any]:
    """A run that starts in 2 s, simulates ten times as fast as time, and records 1000 bytes a second after 500."""
    (folder / "run.mcap").write_bytes(bytes(500 + round(1000 * duration_s)))
    return {
        "status": COMPLETED,
        "wall_s": 2.0 + duration_s / 10.0,
        "summary": {"duration_s": duration_s, "wall_s": duration_s / 10.0},
    }


def planned(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "xitl_cli.plugins.campaign.estimate.try_first_run",
        lambda plan, duration_s, folder: short_runs(duration_s, folder),
    )


@pytest.mark.usefixtures("measured")
def test_a_run_costs_its_start_and_its_course_at_the_measured_speed(tmp_path: Path, golden: Golden) -> None:
    plan = read_plan(planned(tmp_path, PLAN))
    length_s = course_s(plan.base.loaded.profile.run_profiles()[0].mission)
    told = run_cost(plan, [])
    assert told.wall_s == pytest.approx(2.0 + length_s / 10.0)
    assert told.folder_bytes == pytest.approx(500 + 1000 * length_s, rel=1e-3)
    assert not told.at_most
    golden("text", told.basis, "10 times", "2 s", "10 s")


@pytest.mark.usefixtures("measured")
def test_without_a_course_a_run_is_as_long_as_its_limit(tmp_path: Path) -> None:
    plan = read_plan(planned(tmp_path, PLAN + "set: {clock.duration_s: 50}\n"))
    told = run_cost(plan, [])
    assert (told.wall_s, told.at_most) == (pytest.approx(7.0), True)
    assert "50 s of a run (clock.duration_s at most)" in told.basis


@pytest.mark.medium
@pytest.mark.usefixtures("measured")
def test_rows_of_an_earlier_campaign_of_the_same_plan_come_first(tmp_path: Path) -> None:
    path = planned(tmp_path, PLAN)
    plan, out = read_plan(path), tmp_path / "out"
    folder = CampaignFolder.create(out, plan)
    for number, wall_s in ((1, 4.0), (2, 8.0)):
        kept = out / "runs" / f"{number:04d}"
        kept.mkdir(parents=True)
        (kept / "run.mcap").write_bytes(bytes(number * 1000))
        row = {"number": number, "key": str(number), "status": COMPLETED, "passed": True, "wall_s": wall_s}
        folder.append({**row, "directory": str(kept)})
    folder.close()
    told = run_cost(plan, [out])
    assert (told.wall_s, told.folder_bytes) == (6.0, 1500.0)
    assert told.basis == f"the mean of 2 runs in {out}"
    path.write_text(PLAN.replace("1-3", "1-4"), encoding="utf-8")
    assert "measured" in run_cost(read_plan(path), [out]).basis


def test_the_course_is_its_legs_over_the_speed() -> None:
    mission = MissionSpec(speed_mps=2.0, start=StartSpec(north_m=-3.0), waypoints_ned_m=((0.0, 4.0), (0.0, 9.0)))
    assert course_s(mission) == pytest.approx((5.0 + 5.0) / 2.0)
    assert course_s(MissionSpec()) == 0.0


def test_cost_in_words(golden: Golden) -> None:
    cost = RunCost(30.0, 2e6, "the mean of 4 runs in runs/a")
    golden("text", cost_text(cost, 9, "failures", None, 4), "1 min", "30 s", "18 MB", "4 runs")
    assert "wall time: about 4 min 30 s over the workers of tls://head" in cost_text(
        cost, 9, "all", "tls://head:8786", None
    )
    assert "disk: about 9 kB, because no run is kept" in cost_text(cost, 9, "none", None, 1)
    unknown = cost_text(RunCost(None, None, "carry out one"), 9, "all", None, 1)
    assert unknown == "wall time: unknown; disk: unknown. Basis: carry out one"
    assert "wall time: at most about 30 s" in cost_text(RunCost(30.0, None, "", at_most=True), 1, "all", None, 8)
    assert [size_text(size) for size in (20, 3.2e6, 45e6, 1.26e9, 33e9)] == [
        "1 kB",
        "3.2 MB",
        "45 MB",
        "1.3 GB",
        "33 GB",
    ]


def test_a_dry_run_refuses_a_plan_without_runs(tmp_path: Path, golden: Golden) -> None:
    path = planned(tmp_path, PLAN + "constraints: [environment.wind.mean_mps > 9]\n")
    with pytest.raises(PlanError) as refused:
        CliRunner().invoke(xitl_app(["campaign"]), ["campaign", str(path), "--dry-run"], catch_exceptions=False)
    golden("error", refused.value)


def dry_run(plan: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """As typed; in the plan's folder, where no campaign was before."""
    command = [sys.executable, "-m", "xitl_cli.main", "campaign", str(plan), "--dry-run", *options]
    return subprocess.run(command, cwd=plan.parent, capture_output=True, text=True, timeout=ENOUGH_S, check=False)


@pytest.mark.medium
def test_a_dry_run_refuses_a_figure_that_no_summary_has(tmp_path: Path, golden: Golden) -> None:
    told = dry_run(planned(tmp_path, PLAN.replace("cross_track_rms_m", "cross_trak_rms_m")))
    assert told.returncode == 2
    golden("stderr", told.stderr)


@pytest.mark.slow
def test_a_dry_run_tells_time_disk_and_their_basis(tmp_path: Path) -> None:
    path = planned(tmp_path, PLAN)
    told = dry_run(path, "--workers", "2")
    text = " ".join(told.stdout.split())
    assert "6 runs in total." in text
    assert "with 2 parallel runs; disk: about " in text
    assert "measured in 10 s of the first run" in text
    rows = dry_run(path, "--json").stdout.splitlines()
    assert [json.loads(line)["number"] for line in rows] == [1, 2, 3, 4, 5, 6]
