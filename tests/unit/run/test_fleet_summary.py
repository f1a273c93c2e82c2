"""summary.json of a fleet and what a person sees of it, from a run made up."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from tests.golden import Golden, line_with
from xitl_cli.commands.sim_report import show_result
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import LinkReport, PaceReport, TaskTiming
from xitl_cli.run.core.reports import Ending, NodeReport
from xitl_cli.run.nodes.display import LiveDisplay, PlainDisplay, RunStatus
from xitl_cli.run.session import Result
from xitl_cli.run.summary import RunOutcome, VesselOutcome, fleet_summary, merged, summary_of


@pytest.fixture(scope="module")
def alone() -> RunProfile:
    return load_profile("sitl", ["mission.waypoints_ned_m=[[50, 0]]"]).runnable()


def profiles_of(alone: RunProfile, count: int, mode: str = "lockstep") -> list[RunProfile]:
    clock = replace(alone.clock, mode=mode)
    return [replace(alone, vessel=f"boat_{number}", clock=clock) for number in range(1, count + 1)]


def part(number: int, missed: int = 0) -> dict[str, Any]:
    mission = {
        "completed": number > 1, "waypoints_reached": int(number > 1), "waypoints_total": 1,
        "cross_track_rms_m": 0.1 * number, "cross_track_max_m": 0.4, "closest_m": [0.3],
    }  # fmt: skip
    track = {"mode": "AUTO", "armed": True, "north_m": 1.0, "east_m": 2.0, "heading_deg": 3.0, "speed_mps": 1.0}
    track |= {"path_m": 50.0, "speed_mean_mps": 1.5, "speed_max_mps": 2.0}
    task = TaskTiming("LC", "control", 50.0, 1000, missed)
    link = LinkReport("sensors", 1000, 990, 10 if number == 1 else 0)
    return merged([{"mission": mission, "track": track, "tasks": [task], "links": [link]}])


def made(alone: RunProfile, count: int, mode: str = "lockstep", ending: Ending = Ending.FINISHED) -> dict[str, Any]:
    outcome = RunOutcome(
        ending=ending,
        error=None,
        crash=None,
        started_utc="2026-01-01T00:00:00+00:00",
        duration_s=60.0,
        wall_s=60.0,
        completed=ending is Ending.FINISHED,
        vessels=tuple(
            VesselOutcome(True, number > 1 or ending is Ending.FINISHED, 0.0) for number in range(1, count + 1)
        ),
    )
    world = merged(
        [{"tasks": [TaskTiming("PS1", "physics", 400.0, 24000, 0)], "pace": PaceReport(), "warnings": ["!"]}]
    )
    vessels = [part(number, missed=100 if number == 2 else 0) for number in range(1, count + 1)]
    return fleet_summary(profiles_of(alone, count, mode), outcome, world, vessels)


def test_what_is_the_runs_is_at_the_top_and_what_is_a_vessels_is_in_its_part(alone: RunProfile) -> None:
    summary = made(alone, 3)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert list(summary["vessels"]) == ["boat_1", "boat_2", "boat_3"]
    assert [task["task"] for task in summary["tasks"]] == ["physics"]
    assert summary["warnings"] == ["!"]
    assert summary["driver"] == {"kind": "mission", "completed": True, "moored_s": 0.0}
    outcome = RunOutcome(Ending.FINISHED, None, None, "", 60.0, 60.0, True, (VesselOutcome(True, True, 0.0),))
    own = summary_of(alone, outcome, merged([part(1), {"pace": PaceReport()}]))
    run = ("format", "xitl", "profile", "seed", "clock", "started_utc", "ended", "error", "duration_s", "wall_s")
    left = set(own) - {*run, "real_time_factor", "physics", "pace", "debris", "operator"}
    assert left <= set(summary["vessels"]["boat_1"])  # as those of a vessel alone
    assert {*run, "real_time_factor", "pace", "debris", "verdict"} <= set(summary)
    assert summary["vessels"]["boat_2"]["mission"]["cross_track_rms_m"] == pytest.approx(0.2)


def test_the_verdict_is_over_all_and_names_who_fell_short(alone: RunProfile, golden: Golden) -> None:
    cut = made(alone, 3, ending=Ending.DURATION)["verdict"]
    assert (cut["completed"], cut["why"]) == (False, "duration reached; 2 of 3 vessels did their part")
    late = made(alone, 3, mode="realtime")
    assert late["verdict"]["real_time"] is False
    golden("text", late["verdict"]["shortfalls"], "10 %", "100", "1000")
    assert late["vessels"]["boat_2"]["verdict"]["real_time"] is False
    assert late["vessels"]["boat_3"]["verdict"]["real_time"] is True
    assert "10 % of the agent's cycles" in late["warnings"][-1]


@pytest.mark.parametrize("ending", [Ending.FINISHED, Ending.DURATION])
def test_a_fleet_in_which_a_controller_failed_has_failed(alone: RunProfile, ending: Ending) -> None:
    outcome = RunOutcome(ending, None, None, "", 60.0, 60.0, True, (VesselOutcome(True, True, 0.0),) * 2, timed=True)
    nodes = [NodeReport("LS,LC,LA", "PC", "0.1.0", None, 0, controller_failures=count) for count in (0, 7)]
    vessels = [part(number) | {"nodes": [node]} for number, node in enumerate(nodes, start=2)]
    verdict = fleet_summary(profiles_of(alone, 2), outcome, merged([{"pace": PaceReport()}]), vessels)["verdict"]
    assert (verdict["completed"], verdict["duration_asked"]) == (False, False)
    assert "boat_2: " in verdict["why"]
    assert "failed at 7 of its steps" in verdict["why"]


@pytest.fixture(scope="module")
def pair(alone: RunProfile) -> dict[str, Any]:
    return made(alone, 2)


def shown(pair: dict[str, Any], tmp_path: Path, count: int, verbose: bool = False) -> list[str]:
    console = Console(width=80, record=True, file=io.StringIO(), color_system=None)
    first, last = pair["vessels"].values()
    more = [last | {"mission": last["mission"] | {"cross_track_rms_m": 0.1 * number}} for number in range(2, count + 1)]
    vessels = {f"boat_{number}": part for number, part in enumerate([first, *more], start=1)}
    show_result(console, Result(pair | {"vessels": vessels}, tmp_path, 0), verbose)
    return console.export_text().splitlines()


@pytest.mark.parametrize("count", [1, 4, 32])
def test_a_row_a_vessel_at_80_columns_of_a_long_fleet_the_worst(
    pair: dict[str, Any], tmp_path: Path, count: int, golden: Golden
) -> None:
    lines = shown(pair, tmp_path, count)
    assert max(map(len, lines[:-1])) <= 80  # the last one is a path, which stays one word
    rows = [line for line in lines if line.startswith("boat_") and "AUTO" in line]
    if count <= 16:
        assert [line.split()[0] for line in rows] == [f"boat_{number}" for number in range(1, count + 1)]
    else:
        assert [line.split()[0] for line in rows] == [f"boat_{number}" for number in range(32, 16, -1)]
        golden("line", line_with(lines, "and 16 more, 16 of them completed"))
        assert sum(line.startswith("boat_") and "AUTO" in line for line in shown(pair, tmp_path, 32, True)) == 32
    assert any("10 lost of sensors" in line for line in lines)


def status(number: int, **values: Any) -> RunStatus:
    known = {
        "sim_s": 12.3, "duration_s": 60.0, "mode": "AUTO", "armed": True, "waypoints_reached": 1, "waypoints_total": 6,
        "speed_mps": 3.0, "heading_deg": 45.0, "cross_track_m": 0.1 * number, "position_error_m": 0.2,
        "current_mps": 0.0, "wind_mps": 0.0, "motors": (0.1, 0.2), "vessel": f"boat_{number}",
    }  # fmt: skip
    return RunStatus(**known | values)  # type: ignore[arg-type]


def test_a_line_now_and_then_says_of_a_fleet_what_is_under_way_and_who_is_worst(golden: Golden) -> None:
    stream = io.StringIO()
    PlainDisplay(Console(file=stream, width=200)).show(status(1), status(2, cross_track_m=-4.0), status(3, mode="HOLD"))
    golden("text", stream.getvalue(), "12.3 s", "4.00 m")


@pytest.mark.parametrize("count", [4, 40])
def test_the_panel_has_a_row_a_vessel_and_of_a_long_fleet_those_that_fit(count: int) -> None:
    console = Console(width=80, height=24, file=io.StringIO(), force_terminal=True, color_system=None)
    view = LiveDisplay(console, "fleet")
    view.show(*(status(number) for number in range(1, count + 1)))
    view.close()
    text = console.file.getvalue()  # type: ignore[attr-defined]
    rows = {line for line in text.splitlines() if "boat_" in line}
    assert all("AUTO armed" in line and "0.20 m" in line for line in rows)
    assert len(rows) == min(count, 16)
    assert ("and 24 more" in text) == (count == 40)
    assert ("boat_40" in text) == (count == 40)
