"""Comparisons of real logs: against evo, against what the runs themselves measured, against each other."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.command_line import xitl_app
from tests.recorded import CALM, GUST, LOGS
from tests.recorded_run import recorded_run
from xitl_cli.logs import open_log
from xitl_cli.logs.compare.comparison import Comparison, compare

pytestmark = pytest.mark.slow


def compared(*arguments: object) -> dict[str, Any]:
    done = CliRunner().invoke(xitl_app(), ["logs", "compare", *map(str, arguments), "--json"])
    assert done.exit_code == 0, done.output
    document: dict[str, Any] = json.loads(done.stdout)
    return document


def facts(document: dict[str, Any], section: str = "trajectory") -> dict[str, Any]:
    found: dict[str, Any] = document["sections"][section]["facts"]
    return found


def rows(document: dict[str, Any], section: str) -> dict[str, dict[str, Any]]:
    grid = next(iter(document["sections"][section]["grids"].values()))
    return {row[0]: dict(zip(grid["columns"], row, strict=True)) for row in grid["rows"]}


@pytest.mark.parametrize("how", ["none", "sim3"])
def test_the_files_for_evo_give_its_figures(tmp_path: Path, how: str) -> None:
    metrics = pytest.importorskip("evo.core.metrics", reason="needs evo: pip install 'xitl[test]'")
    from evo.tools import file_interface  # type: ignore[import-untyped]

    document = compared(CALM, GUST, "--align", how, "--tum", tmp_path)
    a, b = (file_interface.read_tum_trajectory_file(str(tmp_path / f"{name}.tum")) for name in "ab")
    ours = rows(document, "trajectory")
    relation = metrics.PoseRelation
    for name, metric in (
        ("ATE, in space (m)", metrics.APE(relation.translation_part)),
        ("RPE, pose to pose (m)", metrics.RPE(relation.translation_part, 1, metrics.Unit.frames)),
        ("RPE, pose to pose (deg)", metrics.RPE(relation.rotation_angle_deg, 1, metrics.Unit.frames)),
        ("RPE, 1 m of B's path (m)", metrics.RPE(relation.translation_part, 1.0, metrics.Unit.meters)),
        ("RPE, 1 m of B's path (deg)", metrics.RPE(relation.rotation_angle_deg, 1.0, metrics.Unit.meters)),
    ):
        metric.process_data((a, b))
        theirs = metric.get_all_statistics()
        for key in ("rmse", "mean", "median", "std", "max", "sse"):
            # The files hold nine decimals: 1e-9 m of a centimetre between two poses, 1e-7 deg of a hundredth.
            assert ours[name][key] == pytest.approx(theirs[key], rel=1e-5, abs=1e-7), (name, key)
        assert ours[name]["count"] == len(metric.error)


def test_calm_and_gust_are_two_runs_of_one_mission() -> None:
    document = compared(CALM, GUST)
    assert document["time"]["method"] == "mission"
    events = rows(document, "events")
    assert [events[f"waypoint {number} reached"]["B later (s)"] for number in (1, 2, 3)] == pytest.approx(
        [-0.14, -0.12, -0.12]
    )
    # What the events say, the speed says too, until the mission ends.
    until_end = compared(CALM, GUST, "--until", 50)
    assert rows(until_end, "motion")["speed over ground"]["B later (s)"] == pytest.approx(-0.12, abs=0.05)
    assert rows(until_end, "motion")["yaw"]["B later (s)"] == pytest.approx(-0.12, abs=0.06)


def test_truth_and_estimate_of_one_file() -> None:
    said = facts(compared(CALM, CALM, "--of-a", "truth"))
    assert said["position_rms_m"] < 0.5
    assert said["iae_x_ms"] > 0.0
    same = facts(compared(CALM, CALM))
    assert (same["iae_x_ms"], same["iae_y_ms"], same["position_max_m"]) == (0.0, 0.0, 0.0)
    assert same["path_max_m"] < 0.05  # a path is drawn by points 5 cm apart


def test_the_two_logs_of_one_run_are_found_as_one() -> None:
    run = recorded_run("sitl", 40.0)
    document = compared(run / "autopilot.bin", run / "run.mcap")
    assert document["time"]["method"] == "same clock"
    assert document["time"]["sentence"].startswith("taken as one run: ")
    # Both are the autopilot's estimate: degrees of 1e-7 are a centimetre.
    assert facts(document)["position_max_m"] < 0.03
    assert rows(document, "motion")["yaw"]["B later (s)"] == pytest.approx(0.0, abs=0.02)
    back = facts(compared(run / "run.mcap", run / "autopilot.bin"))
    assert back["position_rms_m"] == pytest.approx(facts(document)["position_rms_m"], abs=0.01)


def test_the_error_of_the_estimate_is_that_of_the_summary() -> None:
    run = recorded_run("sitl", 40.0)
    summary = json.loads((run / "summary.json").read_text())["estimation"]
    with open_log(run / "run.mcap") as log:
        beats = log.tables["/link/agent/rx:HEARTBEAT"]
        armed = (beats.values("base_mode", raw=True) & 128) != 0
        heard_s = float(beats.stamp_ns[armed][0]) * 1e-9
    document = compared(run / "run.mcap", run / "run.mcap", "--of-b", "truth", "--from", heard_s)
    # The same estimates against the same truth, from when a heartbeat said armed. The recording has the truth every
    # 20 ms and reads it between on straight lines: at 3 m/s and under 1 m/s2 that is 0.1 mm.
    assert facts(document)["position_rms_m"] == pytest.approx(summary["position_rms_m"], rel=0.01)
    assert rows(document, "motion")["yaw"]["RMS"] == pytest.approx(summary["heading_rms_deg"], rel=0.01)


def test_logs_of_two_seeds_are_two_runs() -> None:
    one, other = recorded_run("sitl", 40.0), recorded_run("sitl", 40.0, "clock.seed=2")
    for name in ("autopilot.bin", "run.mcap"):
        assert compared(one / name, other / name)["time"]["method"] == "mission"
    document = compared(one / "autopilot.bin", other / "run.mcap")
    assert document["time"]["method"] == "mission", document["time"]
    # One log has it in MODE, the other in heartbeats: both begin with what the autopilot said, not up to 1 s late.
    assert rows(document, "events")["armed"]["B later (s)"] == pytest.approx(0.0, abs=0.1)


def test_the_answer_comes_first_and_the_page_is_written(tmp_path: Path) -> None:
    page = tmp_path / "both.html"
    done = CliRunner().invoke(
        xitl_app(), ["logs", "compare", str(CALM), str(GUST), "--report", str(page)], env={"COLUMNS": "80"}
    )
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert any("two runs, aligned where each first navigated by itself" in line for line in lines[:6])
    assert any("IAE x (east)" in line and "m s" in line for line in lines)
    assert all(len(line) <= 80 for line in lines if str(page) not in line)
    assert "\x1b" not in done.stdout
    text = page.read_text()
    for title in ("Paths", "Speed over ground", "Yaw", "Altitude", "Output 1", "Longest loop of each window"):
        assert title in text
    assert "Time base against the sample number" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((CALM, LOGS / "nowhere.bin"), "nowhere.bin: does not exist"),
        ((CALM, GUST, "--start", "sunrise"), "sunrise"),
        ((CALM, GUST, "--from", "90", "--until", "80"), "nothing to compare: the end is before the beginning"),
        ((CALM, GUST, "--tum", CALM), "cannot be written"),
    ],
)
def test_what_cannot_be_compared_is_one_sentence(arguments: tuple[object, ...], words: str) -> None:
    done = CliRunner().invoke(xitl_app(), ["logs", "compare", *map(str, arguments)])
    assert done.exit_code != 0
    assert words in f"{done.output}{done.stderr if done.stderr_bytes else ''}{done.exception}"


def test_forth_and_back_are_alike() -> None:
    with open_log(CALM) as log_a, open_log(GUST) as log_b:
        there: Comparison = compare(log_a, log_b, until_s=50.0)
        back: Comparison = compare(log_b, log_a, until_s=50.0)
    one, other = (
        {fact.key: fact.value for fact in found.sections[0].facts if isinstance(fact.value, float)}
        for found in (there, back)
    )
    for key in ("iae_x_ms", "iae_y_ms", "position_rms_m", "position_max_m", "path_rms_m"):
        assert one[key] == pytest.approx(other[key], rel=0.05), key
    assert np.isfinite(list(one.values())).all()
