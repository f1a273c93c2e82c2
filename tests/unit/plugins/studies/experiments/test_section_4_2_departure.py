from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.golden import Golden, line_with
from xitl_cli.errors import UserError
from xitl_cli.experiment.setup import ExperimentSetup, InterruptedRunError
from xitl_cli.experiment.time_series import TimeSeries
from xitl_cli.plugins.studies.experiments import figures, section_4_2_departure
from xitl_cli.plugins.studies.experiments.section_4_2_departure import (
    ENVIRONMENTS,
    EVENTS,
    DepartureTraces,
    compare_departures,
    departure_report,
    dominant_period_s,
)
from xitl_cli.run.session import Result

TIMES = dict(zip(EVENTS, (12.0, 20.0, 20.5, 21.25), strict=True))
NO_TRACES = DepartureTraces(None, None, None, None, None)


def ardurover(directory: Path) -> str:
    """A program of that name; it is never started."""
    path = directory / "ardurover"
    path.write_bytes(Path("/bin/true").read_bytes())
    path.chmod(0o755)
    return str(path)


@pytest.fixture(autouse=True)
def _neither_logs_nor_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(section_4_2_departure, "_traces", lambda directory: NO_TRACES)
    monkeypatch.setattr(figures, "write_figures", lambda report, directory: [])


def make_runs(
    monkeypatch: pytest.MonkeyPatch, seen: list[Any], code: Callable[[int], int] = lambda n: 0, **more: Any
) -> None:
    """In place of runs: profiles are noted, and with our sensors all is 5 s sooner."""

    def run(profile: Any, out: Path, overwrite: bool, make_display: Any, timed: bool = False) -> Result:
        seen.append((profile.runnable(), out, overwrite))
        ours = profile.autopilot.bridge.sensors is not None
        times = {event: at_s - 5.0 * ours for event, at_s in TIMES.items()}
        summary = {"error": None, "autopilot": {"firmware": "4.7.0", **times}, **more}
        return Result(summary, out, code(len(seen)))

    monkeypatch.setattr("xitl_cli.experiment.setup.run", run)


@pytest.mark.medium
def test_six_runs_that_differ_in_environment_and_sensors_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    make_runs(monkeypatch, seen)
    firmware = ardurover(tmp_path)
    report = departure_report(ExperimentSetup(tmp_path / "out", seed=7, duration_s=90.0, firmware=firmware))
    runs = report.details["runs"]
    assert [(one["environment"], one["sensors"]) for one in runs] == [
        (environment, sensors) for environment in ENVIRONMENTS for sensors in ("own", "ours")
    ]
    for (profile, out, overwrite), one in zip(seen, runs, strict=True):
        assert profile.environment.current.speed_mps == (0.0 if one["environment"] == "calm" else 0.5)
        assert profile.environment.wind.mean_mps == (5.0 if one["environment"] == "current-waves-gusts" else 0.0)
        assert profile.autopilot.bridge.sensors == (None if one["sensors"] == "own" else "vectornav")
        assert not profile.autopilot.moored_until_armed
        assert (profile.clock.seed, profile.clock.duration_s, profile.autopilot.firmware) == (7, 90.0, firmware)
        assert (out, overwrite) == (tmp_path / "out" / f"{one['environment']}-{one['sensors']}", False)
        assert Path(one["profile"]).is_file()
    assert {row["difference_s"] for row in report.details["rows"]} == {-5.0}
    late, sooner = report.rows[0], report.rows[2]
    assert (late.paper, late.ours, late.unit) == (30.0, 0.0, "s")
    assert (sooner.paper, sooner.ours) == (10.0, 5.0)
    assert "by less" in sooner.difference


@pytest.mark.medium
def test_what_did_not_happen_has_no_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_runs(monkeypatch, [], autopilot={"firmware": "4.7.0"}, error="gave up")
    report = departure_report(ExperimentSetup(tmp_path / "out", firmware=ardurover(tmp_path)))
    assert report.details["runs"][0]["problem"] == "gave up"
    assert all(row["own_s"] is None and row["difference_s"] is None for row in report.details["rows"])
    assert not report.completed
    json.dumps(report.as_json(), allow_nan=False)


def test_an_interrupted_run_ends_all_and_keeps_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_runs(monkeypatch, [], lambda number: 130 if number == 4 else 0)
    with pytest.raises(InterruptedRunError) as stopped:
        departure_report(ExperimentSetup(tmp_path / "out", firmware=ardurover(tmp_path)))
    assert stopped.value.done is not None
    assert len(stopped.value.done.runs) == 3


def test_without_ardupilot_the_embedded_autopilot_departs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(section_4_2_departure, "_embedded_times_s", lambda directory: dict(TIMES))
    seen: list[Any] = []
    make_runs(monkeypatch, seen)
    report = departure_report(ExperimentSetup(tmp_path / "out"))
    assert [profile.autopilot.kind for profile, _, _ in seen] == ["embedded"] * 3
    assert "xitl firmware get rover" in report.notes[0]
    assert {row["embedded_s"] for row in report.details["rows"]} == set(TIMES.values())


def test_a_firmware_that_is_named_and_not_there(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nowhere"):
        departure_report(ExperimentSetup(tmp_path, firmware="/nowhere/ardurover"))


def test_a_place_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_runs(monkeypatch, [])
    (tmp_path / "taken").write_text("")
    with pytest.raises(UserError, match="choose another --out"):
        departure_report(ExperimentSetup(tmp_path / "taken" / "deeper", firmware=ardurover(tmp_path)))


@pytest.mark.medium
def test_a_profile_of_somebody_s_own_is_not_written_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    make_runs(monkeypatch, [])
    firmware, own = ardurover(tmp_path), tmp_path / "calm-own.yaml"
    own.write_text("extends: sitl\n")
    with pytest.raises(UserError) as refused:
        departure_report(ExperimentSetup(tmp_path, firmware=firmware))
    golden("error", refused.value)
    assert own.read_text() == "extends: sitl\n"
    departure_report(ExperimentSetup(tmp_path, firmware=firmware, overwrite=True))
    departure_report(ExperimentSetup(tmp_path, firmware=firmware))  # its own from an earlier time are fine


def test_the_period_of_a_swell() -> None:
    time_s = np.arange(0.0, 40.0, 0.1)
    swell = 0.1 * np.sin(2.0 * np.pi * time_s / 2.5 + 0.3) + 0.02 * time_s + 70.0
    assert dominant_period_s(TimeSeries(time_s, swell)) == pytest.approx(2.5, abs=0.02)
    assert dominant_period_s(TimeSeries(time_s, np.full(len(time_s), 70.0))) is None


def invoke(*words: str) -> tuple[int, str]:
    from tests.command_line import xitl_app

    result = CliRunner().invoke(xitl_app(), ["paper", "4.2", *words])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stdout


@pytest.mark.medium
def test_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    make_runs(monkeypatch, [])
    code, out = invoke("--firmware", ardurover(tmp_path), "--out", str(tmp_path / "out"))
    assert code == 0
    golden("line", line_with(out, "current-waves-gusts, our sensors", "7.0 s", "15.0 s"))
    (late,) = (line.split() for line in out.splitlines() if line.startswith("gusts start late by, own sensors"))
    assert late[6:10] == ["30", "s", "0", "s"]
    assert json.loads((tmp_path / "out/table.json").read_text())["section"] == "4.2"


@pytest.mark.medium
def test_the_table_for_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_runs(monkeypatch, [], autopilot=None)
    code, out = invoke("--firmware", ardurover(tmp_path), "--out", str(tmp_path / "out"), "--json")
    assert code == 1
    read = json.loads(out)
    assert len(read["rows"]) == 12
    assert read["rows"][0] == {
        "environment": "calm",
        "event": "time_to_origin_s",
        "own_s": None,
        "ours_s": None,
        "embedded_s": None,
        "difference_s": None,
    }


def test_all_ways_side_by_side() -> None:
    assert len(compare_departures([])) == len(ENVIRONMENTS) * len(EVENTS)
