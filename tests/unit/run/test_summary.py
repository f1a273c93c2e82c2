"""summary.json and what a person sees of it, from a run made up so that every part of it has something to say."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from agent.wire import dialect
from tests.golden import Golden
from xitl_cli.commands.sim_report import show_result
from xitl_cli.profile import load_profile
from xitl_cli.record.topics import LinkReport, PaceReport, TakeoverReport, TaskTiming
from xitl_cli.run.core.reports import (
    ActuatorReport,
    ClockReport,
    Ending,
    FaultReport,
    NodeReport,
)
from xitl_cli.run.core.scores import MissionScore
from xitl_cli.run.core.statistics import Histogram
from xitl_cli.run.links.link_accounts import agent_traffic
from xitl_cli.run.session import Result
from xitl_cli.run.summary import RunOutcome, Sections, VesselOutcome, merged, summary_of


def histogram(*values_ns: int) -> Histogram:
    made = Histogram()
    for value_ns in values_ns:
        made.add(value_ns)
    return made


def outcome() -> RunOutcome:
    return RunOutcome(
        ending=Ending.FINISHED,
        error=None,
        crash=None,
        started_utc="2026-01-01T00:00:00+00:00",
        duration_s=200.0,
        wall_s=203.5,
        completed=True,
        vessels=(VesselOutcome(True, True, 0.0),),
    )


def sections(nodes: Sequence[NodeReport] = (), **values: Any) -> Sections:
    mission = MissionScore(load_profile("hitl-beaglebone").runnable().mission.waypoints_ned_m)
    frames = {"tx": {dialect.MAVLINK_MSG_ID_XITL_IMU: 9}, "rx": {dialect.MAVLINK_MSG_ID_XITL_ACTUATORS: 9}}
    agents = [agent_traffic(node, [], frames) for node in nodes]
    of_nodes = {"nodes": nodes, "agents": agents, "edges": [("PS1", "M")]}
    return merged([{"mission": mission.section(), "pace": PaceReport()}, of_nodes, values])


def summarised(profile: str, made: Sections) -> dict[str, Any]:
    return summary_of(load_profile(profile).runnable(), outcome(), made)


def eventful() -> Sections:
    bins = (0, 0, 0, 0, 0, 700, 290, 8, 2, 0, 0, 0, 0, 0, 0, 0)
    return sections(
        links=[
            LinkReport("sensors", 70_000, 69_990, 12, 10, 0, 2, 0, 0, 0, 12, 0.0003, 0.0009, 0.0009),
            LinkReport("actuators", 12_000, 12_000, 0, 0, 0, 0, 3, 0, 1, 0, 0.0004, 0.0004, 0.0004),
            LinkReport("standby sensors", 70_000, None),
        ],
        tasks=[
            TaskTiming("PS1", "physics", 400.0, 80_000, 0, 0.00011, 0.00008, 0.0009),
            TaskTiming("LC", "control", 50.0, 1000, 2, 0.0005, 6e-5, 0.0004, 1, 4e-5, 31_000_000_000, 5, bins, bins),
        ],
        clocks=[
            ClockReport("PS1", None, None, slope_s=0.0025, slope_std_s=1e-6),
            ClockReport("LC", -3e6, 79.98, 210.0, 1990, 12.0, 180.0, 0.12, 0.100008, 3.1e-5, 1, 0.31),
        ],
        nodes=[
            NodeReport(
                "LS,LC,LA",
                "TI AM335x BeagleBone Black",
                "0.1.0",
                30.6,
                0,
                kind="real",
                kernel="Linux 6.1.80-ti-rt armv7l",
                python="3.11.2",
                flags=("PREEMPT_RT", "SCHED_FIFO", "memory locked", "[red]pinned[/red]"),
                processors=1,
                temperature_c=51.2,
                cpu_percent=8.4,
                estimates=10_000,
                efforts=10_000,
            )
        ],
        actuators=ActuatorReport(histogram(4_000_000, 9_000_000), 7, 3),
        takeovers=[TakeoverReport("agent", "standby", 0.31, 0.05, 31.2)],
        faults=[
            FaultReport("link-cut", "link", 40.0, 45.0, {"frames_lost_to_agent": 12}),
            FaultReport("drifting-clock", "agent", 20.0, None),
            FaultReport("gnss-dropout", "gnss", None, None),
        ],
        pace=PaceReport(2, 3.4, 2, 3.6, 2.5),
    )


def shown(tmp_path: Path, made: Sections, verbose: bool = False, width: int = 80) -> str:
    console = Console(width=width, record=True, file=io.StringIO(), color_system=None)
    show_result(console, Result(summarised("hitl-beaglebone", made), tmp_path, 0), verbose)
    return console.export_text()


def test_the_summary_is_plain_json_with_everything_in_it() -> None:
    summary = summarised("hitl-beaglebone", eventful())
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    sensors = summary["links"][0]
    assert (sensors["sent"], sensors["received"], sensors["lost"]) == (70_000, 69_990, 12)
    assert (sensors["gaps"], sensors["late"], sensors["repeated"]) == (10, 0, 2)
    assert (sensors["refused"], sensors["impaired"]) == (0, 12)
    assert sensors["latency_us"] == {"p50": 300.0, "p99": 900.0, "max": 900.0}
    control = summary["tasks"][1]
    # 700 of 1000 below 64 µs; 990 below 128 µs, the share of p99 exactly. The means and the maximum are as measured.
    assert (control["start_jitter_p50_us"], control["start_jitter_p99_us"]) == (64.0, 128.0)
    assert control["start_jitter_max_us"] == pytest.approx(500.0)
    assert (control["skipped"], control["worst_run_s"], control["worst_start_s"]) == (1, 31.0, 5e-9)
    assert (len(control["run_histogram"]), sum(control["start_histogram"])) == (16, 1000)
    assert summary["tasks"][0]["start_jitter_p99_us"] is None
    clock = summary["clocks"][1]
    assert clock["drift_error_ppm"] == 0.31
    assert (clock["drift_ppm"], clock["drift_std_ppm"], clock["steps"], clock["slope_s"]) == (79.98, 0.12, 1, 0.100008)
    assert summary["actuators"]["age_us"]["max"] == 9000.0
    (takeover,) = summary["takeovers"]
    assert takeover == {"at_s": 31.2, "from_node": "agent", "to_node": "standby", "silent_s": 0.31, "step": 0.05}
    assert next(iter(takeover)) == "at_s"
    assert (summary["actuators"]["stale"], summary["actuators"]["longest_stale"]) == (7, 3)
    assert summary["takeovers"][0]["to_node"] == "standby"
    assert (summary["pace"]["slips"], summary["pace"]["slipped_s"], summary["pace"]["stalls"]) == (2, 3.4, 2)
    assert [fault["until_s"] for fault in summary["faults"]] == [45.0, None, None]
    assert summary["nodes"][0]["kind"] == "real"


def test_quantiles_of_bins_never_exceed_the_maximum() -> None:
    last = (0,) * 15 + (4,)
    one = (4,) + (0,) * 15
    tasks = [
        TaskTiming("LC", "a", 1.0, 4, 0, start_jitter_max_s=1.0, start_histogram=last),
        TaskTiming("LC", "b", 1.0, 4, 0, start_jitter_max_s=1e-6, start_histogram=one),
        TaskTiming("LC", "c", 1.0, 0, 0, start_histogram=(0,) * 16),
    ]
    summary = summarised("hitl-beaglebone", sections(tasks=tasks))
    assert [task["start_jitter_p99_us"] for task in summary["tasks"]] == [1e6, 1.0, None]


def test_the_report_leads_with_the_verdict_and_a_line_for_each_part(tmp_path: Path, golden: Golden) -> None:
    lines = shown(tmp_path, eventful()).splitlines()
    assert lines[0].startswith("completed: ")
    golden("text", lines[1], "2 times", "3.6 s", "2.5")
    words = " ".join(" ".join(lines).split())
    for expected in (
        "takeover standby for agent at 31.20 s, which was silent for 0.31 s; largest step 0.050",
        "timing deadlines missed: control 2 of 1001; clock of LC +79.98 ppm (standard error 0.31)",
        "links 152000 frames, 12 lost of sensors, unknown number lost of standby sensors, 3 dropped of actuators",
        "faults injected: link-cut, drifting-clock",
        "claimed links without data: D-LC, LS-M, LC-M",
    ):
        assert expected in words
    assert "missed  late" not in words  # tables are for --verbose


@pytest.mark.parametrize(("machine", "told"), [("emulated armv7l board, 0.77 M loops/s", True), ("BeagleBone", False)])
def test_the_timing_of_an_emulated_board_is_told_as_such(tmp_path: Path, machine: str, told: bool) -> None:
    tasks = [TaskTiming("LC", "control", 50.0, 4, 0, start_histogram=(0,) * 16)]
    made = sections(tasks=tasks, nodes=[NodeReport("LS,LC,LA", machine, "1", None, 0)])
    assert ("timing of an emulated board is that of its emulator" in " ".join(shown(tmp_path, made).split())) is told


@pytest.mark.parametrize(("kind", "told"), [("virtual", True), ("real", False)])
def test_nodes_claimed_real_that_were_virtual_are_told(tmp_path: Path, kind: str, told: bool) -> None:
    made = sections(nodes=[NodeReport("LS,LC,LA", "emulated armv7l board", "1", None, 0, kind=kind)])
    assert ("nodes claimed real, but virtual: LS, LC, LA" in " ".join(shown(tmp_path, made).split())) is told


@pytest.mark.parametrize("width", [80, 40, 24])
def test_nothing_of_the_report_is_cut_off(tmp_path: Path, width: int) -> None:
    text = shown(tmp_path, eventful(), verbose=True, width=width)
    assert max(len(line.rstrip()) for line in text.splitlines() if str(tmp_path) not in line) <= width
    assert "…" not in text
    words = " ".join(text.split())
    for expected in (
        "real, TI AM335x BeagleBone Black, PREEMPT_RT, SCHED_FIFO, memory locked, [red]pinned[/red], 31 MiB, CPU 8 %",
        "at most 9.0 ms; none new at 7 exchanges, at most 3 in a row",
        "sensors: 10 gaps, 2 repeated, 12 lost on purpose",
        "actuators: 1 refused",
        "2 times, 3.4 s in all",
    ):
        assert expected in words


def test_the_tables_have_what_the_summary_has(tmp_path: Path) -> None:
    words = " ".join(shown(tmp_path, eventful(), verbose=True).split())
    for expected in (
        "link-cut 40 45 12 frames lost to agent",
        "drifting-clock 20 the end –",
        "gnss-dropout never – –",
        "clock offset ± µs drift ± ppm varies sample ms varies µs steps",
        "79.98 0.31 0.12 100.00800 31.0 1",
    ):
        assert expected in words


def test_an_uneventful_run_is_said_in_few_lines(tmp_path: Path) -> None:
    text = shown(tmp_path, sections())
    assert "fault" not in text
    assert "takeover" not in text
    assert "suspended" not in text
    assert len(text.splitlines()) < 8


def test_a_run_without_shortfalls_kept_real_time(tmp_path: Path) -> None:
    assert shown(tmp_path, sections()).splitlines()[1] == "real time kept: 200.0 s in 203.5 s"
    assert summarised("hitl-beaglebone", sections())["verdict"]["real_time"] is True
    assert summarised("sitl", sections())["verdict"]["real_time"] is None
