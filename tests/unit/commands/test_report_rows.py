"""Each row of a run's report, from parts of a summary that are made for the test."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from xitl_cli.commands import sim_report
from xitl_cli.commands.sim_report import (
    autopilot_rows,
    closest_m,
    details,
    fleet_row,
    incidents,
    perception_rows,
    verdict_lines,
    worst_vessels,
)
from xitl_cli.run.session import Result

VERDICT = {"completed": False, "why": "its reason", "real_time": None, "shortfalls": [], "duration_asked": False}
RUN = {"duration_s": 60.04, "wall_s": 3.06, "real_time_factor": 19.62, "physics": {"compiled": True}}


def verdict(ended: str = "crashed", run: dict[str, Any] | None = None, **of: Any) -> list[tuple[str, str]]:
    return list(verdict_lines({**RUN, **(run or {}), "ended": ended, "verdict": {**VERDICT, **of}}))


def test_how_a_run_ended() -> None:
    assert verdict(completed=True)[0] == ("completed: its reason", "bold green")
    assert verdict("duration reached", duration_asked=True)[0] == ("ended: its reason", "bold green")
    assert verdict("duration reached")[0] == ("not completed: its reason", "bold red")
    assert verdict(duration_asked=True)[0] == ("not completed: its reason", "bold red")
    assert verdict("interrupted")[0] == ("its reason", "bold red")
    assert verdict("failed")[0] == ("failed: its reason", "bold red")


def test_how_fast_a_run_was() -> None:
    assert verdict()[1] == ("lockstep: 60.0 s in 3.1 s, 19.6× real time", "")
    assert verdict(run={"real_time_factor": None})[1] == ("lockstep: 60.0 s in 3.1 s", "")
    assert verdict(run={"physics": {"compiled": False}})[1][0].endswith("19.6× real time, physics in numpy")
    assert verdict(real_time=True)[1] == ("real time kept: 60.0 s in 3.1 s", "bold green")
    text, style = verdict(real_time=False, shortfalls=["a", "b"])[1]
    assert "a" in text
    assert style == "bold red"


def autopilot(**of: Any) -> dict[str, Any]:
    times = dict.fromkeys(("time_to_heartbeat_s", *sim_report._TIMES))
    section = {"kind": "ardupilot", "vehicle": "boat", "firmware": "", "log": "a.bin", "program": "x", "bridge": None}
    return {**section, **times, "scheduler": None, "clock": "real", "agent": {"missed": 2, "cycles": 900}, **of}


def test_an_autopilot_with_its_times() -> None:
    assert list(autopilot_rows(None)) == []
    assert list(autopilot_rows(autopilot())) == [("autopilot", "ardupilot boat")]
    rows = list(autopilot_rows(autopilot(firmware="V4.5", time_to_ready_s=12.34, time_to_arm_s=13.06)))
    assert rows == [("autopilot", "ardupilot boat V4.5"), ("", "ready to arm 12.3 s, armed 13.1 s")]


def test_an_autopilot_without_a_log() -> None:
    assert list(autopilot_rows(autopilot(log=None)))[1] == ("", "it wrote no log")
    assert list(autopilot_rows(autopilot(log=None, program=None)))[1] == ("", "its log stays on its machine")


def test_counts_of_a_bridge() -> None:
    none = {"imu_out": 0, "solution_out": 0, "gnss_out": 0, "outputs_in": 7, "world_rate": 0}
    quiet = {**dict.fromkeys(sim_report.troubles(sim_report.BridgeCounts), 0), **none}
    assert list(autopilot_rows(autopilot(bridge=quiet)))[1] == ("bridge", "no frames in\n7 outputs back")
    key, words = next(iter(sim_report.troubles(sim_report.BridgeCounts).items()))
    busy = {**quiet, "imu_out": 5, "gnss_out": 1, "world_rate": 400, key: 3}
    assert list(autopilot_rows(autopilot(bridge=busy)))[1] == (
        "bridge",
        f"frames in: 5 inertial, 1 of satellites\n7 outputs back, world at 400 Hz, 3 {words}",
    )


def test_the_scheduler_of_an_autopilot() -> None:
    nothing = dict.fromkeys(("long_loops", "loops", "max_us", "load_mean_percent", "load_max_percent"))
    missed = "the agent missed 2 of 900 cycles"
    assert list(autopilot_rows(autopilot(scheduler=nothing)))[1] == ("scheduler", f"\n{missed}")
    full = {"long_loops": 4, "loops": 500, "max_us": 2540, "load_mean_percent": 12.34, "load_max_percent": 56.78}
    assert list(autopilot_rows(autopilot(scheduler=full, clock="simulated")))[1] == (
        "scheduler",
        "4 long of 500 loops, longest 2.5 ms, load 12.3 %, at most 56.8 %\n"
        f"(measured by its simulated clock, not in processor time)\n{missed}",
    )


CALM: dict[str, Any] = {"takeovers": [], "autopilot_events": [], "faults": [], "collisions": None}


def test_incidents_of_each_kind() -> None:
    assert list(incidents(CALM)) == []
    assert list(incidents({**CALM, "collisions": {"count": 0}})) == []
    takeover = {"to_node": "B", "from_node": "A", "at_s": 3.456, "silent_s": 0.2, "step": 0.05}
    events = [
        {"event": "failsafe", "reason": "no link", "at_s": 4.0},
        {"event": "mode", "mode": "AUTO", "at_s": 5.0},
        {"event": "fence limits speed", "mode": "AUTO", "at_s": 6.0},
    ]
    faults = [{"name": "a", "from_s": 0.0}, {"name": "never", "from_s": None}, {"name": "b", "from_s": 2.0}]
    hits = {"count": 3, "by": {"boom": 2, "shore": 1}, "first_s": 7.0, "max_impact_mps": 0.456}
    assert list(
        incidents({"takeovers": [takeover], "autopilot_events": events, "faults": faults, "collisions": hits})
    ) == [
        ("takeover", "B for A at 3.46 s, which was silent for 0.20 s; largest step 0.050"),
        ("failsafe", "no link at 4.0 s"),
        ("fence", "limits the speed at 6.0 s, in mode AUTO"),
        ("faults", "injected: a, b"),
        ("collisions", "3: 2 with boom, 1 with shore; the first at 7.00 s, the hardest at 0.46 m/s"),
    ]


def link(name: str, **of: Any) -> dict[str, Any]:
    quiet = dict.fromkeys(sim_report.troubles(sim_report.LinkReport), 0)
    counts = {"name": name, "sent": 10, "received": 10, "lost": 0, "dropped": 0, "gaps": 0, "host_end": {}}
    return {**quiet, **counts, "latency_us": {"p50": None, "p99": None, "max": None}, **of}


def node(**of: Any) -> dict[str, Any]:
    quiet = dict.fromkeys(sim_report.troubles(sim_report.NodeReport), 0)
    state = dict.fromkeys(sim_report._MACHINE_STATE)
    return {**quiet, **state, "nodes": "LC,PA", "kind": "fcu", "machine": "armv7l", "flags": [], "link": "agent", **of}


def test_details_of_machines_commands_and_links() -> None:
    summary: dict[str, Any] = {"nodes": [node()], "actuators": None, "links": [link("sensors")], "pace": None}
    assert list(details(summary)) == [("node", "LC PA, fcu, armv7l")]
    key, words = next(iter(sim_report.troubles(sim_report.NodeReport).items()))
    trouble, sentence = next(iter(sim_report.troubles(sim_report.LinkReport).items()))
    summary = {
        "nodes": [node(link="can0", flags=["locked"], memory_mib=99.6, temperature_c=50.2, **{key: 2})],
        "actuators": {"age_us": {"p50": 1240, "p99": 2560, "max": 9000}, "stale": 3, "longest_stale": 2},
        "links": [link("a", **{trouble: 4}), link("b", host_end={"errors": 1, "losses": 0, "other": 5})],
        "pace": {"slips": 2, "slipped_s": 12.34},
    }
    assert list(details(summary)) == [
        ("node", f"can0, LC PA, fcu, armv7l, locked, 100 MiB, 50 °C, 2 {words}"),
        ("commands", "1.2 ms old when used, p99 2.6, at most 9.0 ms; none new at 3 exchanges, at most 2 in a row"),
        ("link", f"a: 4 {sentence}"),
        ("link", "b: 1 bus errors here"),
        ("suspended", "2 times, 12.3 s in all: this machine did not run"),
    ]
    summary["actuators"]["stale"] = 0
    assert ("commands", "1.2 ms old when used, p99 2.6, at most 9.0 ms") in list(details(summary))
    summary["actuators"]["age_us"]["max"] = 0
    summary["pace"]["slips"] = 0
    assert [label for label, _ in details(summary)] == ["node", "link", "link"]


@pytest.mark.parametrize(
    ("links", "text"),
    [
        ([link("a"), link("b", sent=0, received=7)], "17 frames, none lost"),
        ([link("a", lost=2), link("b", dropped=3)], "20 frames, 2 lost of a, 3 dropped of b"),
        ([link("a", lost=None)], "10 frames, unknown number lost of a"),
        ([link("a", lost=None, gaps=4)], "10 frames, unknown number lost of a, at least 4"),
        ([link("a", lost=None, sent=None, received=0)], "0 frames, none lost"),
        (
            [link("a", latency_us={"p99": 1250}), link("b"), link("c", latency_us={"p99": 800})],
            "30 frames, none lost; latency, 99 %: a 1.2 ms, c 0.8 ms",
        ),
    ],
)
def test_the_line_of_all_links(links: list[dict[str, Any]], text: str) -> None:
    assert sim_report._links_line(links) == text


def task(name: str, missed: int = 0, skipped: int = 0) -> dict[str, Any]:
    times = dict.fromkeys(("start_jitter_p99_us", "start_jitter_max_us", "run_p99_us"), 1234.5)
    return {"node": "LC", "task": name, "rate_hz": 50.0, "cycles": 100, "missed": missed, "skipped": skipped, **times}


def clock(name: str = "LC", **of: Any) -> dict[str, Any]:
    keys = ("offset_us", "asymmetry_bound_us", "drift_ppm", "drift_error_ppm", "drift_std_ppm", "slope_s")
    return {**dict.fromkeys((*keys, "slope_std_s")), "node": name, "steps": 0, **of}


def test_the_line_of_deadlines_and_clocks() -> None:
    summary = {"tasks": [task("a"), task("b")], "clocks": [clock("PS1", drift_ppm=9.0), clock()], "nodes": []}
    assert sim_report._timing(summary) == "none of 200 deadlines of 2 tasks missed"
    summary["tasks"].append(task("c", missed=3, skipped=2))
    summary["clocks"].append(clock("HC", drift_ppm=-1.234, drift_error_ppm=0.056))
    summary["clocks"].append(clock("LC", drift_ppm=2.0))
    summary["nodes"].append(node(machine=f"{sim_report.EMULATED} armv7l"))
    assert sim_report._timing(summary) == (
        "deadlines missed: c 3 of 102; clock of HC -1.23 ppm (standard error 0.056); clock of LC +2.00 ppm; "
        "the timing of an emulated board is that of its emulator"
    )


def test_the_tables_have_a_cell_for_each_figure() -> None:
    latency = {"p50": 99.96, "p99": 250.4, "max": None}
    clocks = [
        clock(offset_us=-99_999.9, asymmetry_bound_us=12.34, drift_ppm=1.234, drift_error_ppm=0.056, slope_s=0.02),
        clock("HC", offset_us=-100_000.0, drift_std_ppm=3.0, slope_std_s=1.5e-6, steps=None),
    ]
    faults = [
        {"name": "a", "from_s": None, "until_s": None, "did": {}},
        {"name": "b", "from_s": 1.5, "until_s": 2.0, "did": {"frames_lost": 3, "late": 1}},
        {"name": "c", "from_s": 4.0, "until_s": None, "did": {}},
    ]
    tasks = [{**task("main"), "run_max_us": 0.0}]
    summary = {"links": [link("a", lost=None, latency_us=latency)], "tasks": tasks, "clocks": clocks, "faults": faults}
    of_links, of_tasks, of_clocks, of_faults = ([*rows] for _, rows, _ in sim_report._tables(summary))
    assert of_links == [["a", "10", "10", "–", "0", "100.0", "250", "–"]]
    assert of_tasks == [["LC", "main", "50", "100", "0", "1234", "1234", "1234", "0"]]
    assert of_clocks == [
        ["LC", "-100000 µs", "12.3", "1.23", "0.06", "–", "20.00000", "–", "0"],
        ["HC", "-0.1000 s", "–", "–", "–", "3.00", "–", "1.5", "–"],
    ]
    assert of_faults == [
        ["a", "never", "–", "–"],
        ["b", "1.5", "2", "3 frames lost, 1 late"],
        ["c", "4", "the end", "–"],
    ]
    for heads, rows, text_columns in sim_report._tables(summary):
        assert {len(row) for row in rows} == {len(heads)}
        assert text_columns[0] == 0


GRAPH = {"measured": {"wdri": None}, "missing": [], "unclaimed": [], "overclaimed": []}


def test_the_profile_with_what_it_claims() -> None:
    summary = {"profile": "p", "technique": "HITL", "seed": 7, "wdri": 0.756, "graph": GRAPH}
    assert sim_report._profile_text(summary) == "p (HITL, seed 7), WDRI 0.76 claimed, none measured"
    odd = {"measured": {"wdri": 0.5}, "missing": ["a-b", "c-d"], "unclaimed": ["e-f"], "overclaimed": ["LC"]}
    assert sim_report._profile_text({**summary, "graph": odd}).splitlines() == [
        "p (HITL, seed 7), WDRI 0.76 claimed, 0.50 measured",
        "claimed links without data: a-b, c-d",
        "links with data, not claimed: e-f",
        "nodes claimed real, but virtual: LC",
    ]


def perceived(**of: Any) -> dict[str, Any]:
    return {**dict.fromkeys(("perception", "odometry", "mapping", "obstacles", "companion")), **of}


def test_radar_odometry_and_map() -> None:
    assert list(perception_rows(perceived())) == []
    assert list(perception_rows(perceived(perception={"radar": {"turns": 3, "plots": 40}}))) == [
        ("radar", "3 turns, 40 plots")
    ]
    odometry = {"poses": 9, "ate_rms_m": None, "path_m": 50.0, "rate_hz": None, "anchored_rms_m": 0.3, "rpe_m": None}
    assert list(perception_rows(perceived(odometry={**odometry, "poses": 0}))) == []
    assert list(perception_rows(perceived(odometry=odometry))) == [
        ("odometry", "9 poses, too few to compare with the truth")
    ]
    odometry["ate_rms_m"] = 0.25
    assert list(perception_rows(perceived(odometry=odometry))) == [
        ("odometry", "ATE 0.25 m (0.50 % of 50 m), 0.30 m from a common start")
    ]
    odometry.update(rate_hz=9.96, path_m=0.0, rpe_m=0.02)
    assert list(perception_rows(perceived(odometry=odometry))) == [
        ("odometry", "10.0 Hz, ATE 0.25 m, 0.30 m from a common start, RPE 0.02 m in a second")
    ]
    mapping = {"points": 0, "sonar_points": 7, "boom_rms_m": None, "boom_uncut_rms_m": None, "coverage": None}
    assert list(perception_rows(perceived(mapping=mapping))) == []
    mapping["points"] = 1000
    assert list(perception_rows(perceived(mapping=mapping))) == [("map", "1000 points by lidar, 7 by sonar")]
    mapping.update(boom_rms_m=0.101, boom_uncut_rms_m=0.2, coverage=0.756)
    assert list(perception_rows(perceived(mapping=mapping))) == [
        (
            "map",
            "1000 points by lidar, 7 by sonar; 0.10 m RMS off the log boom within a metre of it, 0.20 m for all of its "
            "points, 76 % of it seen",
        )
    ]


def test_the_companion_and_its_obstacles() -> None:
    counts = dict.fromkeys(("detours", "stops", "detections", "chunks_lost", "map_chunks_lost", "clouds_dropped"), 0)
    companion: dict[str, Any] = {"gone_s": None, "warnings": [], "detections_matched": 0, **counts}
    assert list(perception_rows(perceived(companion=companion))) == []
    companion.update(gone_s=12.34, warnings=["one", "two"], detours=2, stops=1)
    obstacles: dict[str, Any] = {"detected": 3, "launched": 4, "false": 0, "min_clearance_m": None, "classes": {}}
    assert list(perception_rows(perceived(companion=companion, obstacles=obstacles))) == [
        ("companion", "lost at 12.3 s"),
        ("companion", "one"),
        ("companion", "two"),
        ("obstacles", "3 of 4 floating bodies detected, 0 false; 2 detours, 1 stop"),
    ]
    companion.update(gone_s=None, warnings=[], detections=20, detections_matched=15, chunks_lost=1, map_chunks_lost=2)
    obstacles.update(
        min_clearance_m=1.26, classes={"log": {"right": 2, "tracked": 3}, "buoy": {"right": 1, "tracked": 1}}
    )
    assert list(perception_rows(perceived(companion=companion, obstacles=obstacles))) == [
        ("obstacles", "3 of 4 floating bodies detected, 0 false, smallest clearance 1.3 m; 2 detours, 1 stop"),
        ("classes", "right for 2 of 3 log, 1 of 1 buoy; 15 of 20 detections matched"),
        ("clouds", "3 chunks lost; the companion was too slow for 0 clouds and dropped them"),
    ]
    companion.update(chunks_lost=0, map_chunks_lost=0, clouds_dropped=5)
    rows = dict(perception_rows(perceived(companion=companion, obstacles=obstacles)))
    assert rows["clouds"] == "0 chunks lost; the companion was too slow for 5 clouds and dropped them"


def vessel(completed: bool = True, cross_track_m: float | None = 1.0, **of: Any) -> dict[str, Any]:
    mission = {"cross_track_rms_m": cross_track_m, "waypoints_total": 6, "waypoints_reached": 5}
    track = {"mode": "AUTO", "speed_mean_mps": 1.234}
    estimation = {"position_rms_m": 0.0}
    return {"driver": {"completed": completed}, "mission": mission, "track": track, "estimation": estimation, **of}


def test_the_worst_vessels_of_a_large_fleet_come_first() -> None:
    vessels = {
        "good": vessel(),
        "off": vessel(cross_track_m=9.0),
        "lost": vessel(completed=False, cross_track_m=None),
        "no mission": vessel(completed=False, mission=None),
        "worst": vessel(completed=False, cross_track_m=3.0),
    }
    assert worst_vessels(vessels, 5) == list(vessels)
    assert worst_vessels(vessels, 4) == ["worst", "lost", "no mission", "off"]


def test_the_row_of_a_vessel_and_its_closest_neighbour() -> None:
    pairs = [
        {"vessels": ["a", "b"], "distance_m": 12.0},
        {"vessels": ["b", "c"], "distance_m": None},
        {"vessels": ["c", "a"], "distance_m": 120.4},
    ]
    nothing = vessel(mission=None, track={"mode": None, "speed_mean_mps": None})
    summary = {"vessels": {"a": vessel(), "b": nothing}, "encounters": {"pairs": pairs}}
    assert fleet_row(summary, "a") == ["a", "AUTO", "5/6", "1.00 m", "1.23 m/s", "0 m", "12.00 m"]
    assert fleet_row(summary, "b") == ["b", "–", "–", "–", "–", "0 m", "12.00 m"]
    assert closest_m(summary, "c") == 120.4
    assert closest_m({"encounters": None}, "a") is None
    summary["vessels"]["a"]["mission"]["waypoints_total"] = 0
    assert fleet_row(summary, "a")[2] == "–"


def test_a_large_fleet_tells_how_many_it_hides(tmp_path: Path) -> None:
    part = vessel(warnings=[], links=[link("a", lost=1)], tasks=[], nodes=[], **perceived(), **CALM)
    vessels = {f"v{number:02}": part for number in range(sim_report.MOST_ROWS)}
    vessels["bad"] = {**part, "driver": {"completed": False}, "warnings": ["it is stuck"]}
    verdict_of_run = {**VERDICT, "completed": True}
    summary = {**RUN, "ended": "", "verdict": verdict_of_run, "warnings": ["slow", "slow too"], "vessels": vessels}
    summary |= {"profile": "p", "technique": "SITL", "seed": 1}
    (tmp_path / "summary.json").touch()
    stream = io.StringIO()
    sim_report.show_result(Console(file=stream, width=200, markup=False, highlight=False), Result(summary, tmp_path, 0))
    text = stream.getvalue()
    assert text.splitlines()[0] == "completed: its reason"
    assert "and 1 more, 1 of them completed; see summary.json, or use --verbose\n" in text
    assert "and 1 more incident; see summary.json\n" in text
    assert text.count("links: 10 frames, 1 lost of a") == sim_report.MOST_ROWS
    assert "p (SITL, seed 1), 17 vessels\n" in text
    for warning in ("slow", "slow too", "it is stuck"):
        assert any(line.endswith(f" {warning}") for line in text.splitlines())
    assert text.endswith(f"{tmp_path}/: summary.json, 17 folders of its vessels\n")
