"""Reports of the paper's sections from made results: the values of their tables, and what their figures draw."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.recorded import CALM, GUST
from xitl_cli.experiment.report import ExperimentReport, PaperRow
from xitl_cli.experiment.setup import ExperimentSetup
from xitl_cli.experiment.time_series import TimeSeries
from xitl_cli.extras import Extra
from xitl_cli.logs import open_log
from xitl_cli.plugins.studies.experiments import (
    section_4_1_recorded_outputs,
    section_4_2_departure,
    section_4_3_sitl_hitl,
    section_4_4_lidar_sonar,
)
from xitl_cli.plugins.studies.experiments.section_4_1_recorded_outputs import ReplayComparison, recorded_outputs_report
from xitl_cli.plugins.studies.experiments.section_4_2_departure import DepartureTraces, departure_report
from xitl_cli.plugins.studies.experiments.section_4_3_sitl_hitl import (
    BoomMap,
    LoopSide,
    TimeBaseFit,
    loop_side,
    sitl_hitl_report,
)
from xitl_cli.plugins.studies.experiments.section_4_4_lidar_sonar import (
    Footprint,
    FusedCloud,
    lidar_sonar_report,
)
from xitl_cli.plugins.studies.experiments.wdri_indices import wdri_report
from xitl_cli.run.session import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

pytest.importorskip("matplotlib")
DATA = Path(__file__).parents[4] / "data"


@pytest.fixture(autouse=True)
def _no_ardupilot(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "cache"))


def runs_are(monkeypatch: pytest.MonkeyPatch, summary: Callable[[str], dict[str, Any]]) -> None:
    """In place of runs. summary: of the run in a folder of this name."""

    def run(profile: Any, out: Path, overwrite: bool, make_display: Any, timed: bool = False) -> Result:
        return Result(summary(out.name), out, 0)

    monkeypatch.setattr("xitl_cli.experiment.setup.run", run)


def rows_of(report: ExperimentReport) -> dict[str, PaperRow]:
    return {row.quantity: row for row in report.rows}


def drawn(report: ExperimentReport, name: str) -> list[Axes]:
    """The panels of a figure."""
    from matplotlib.figure import Figure

    (wanted,) = [figure for figure in report.figures if figure.name == name]
    canvas = Figure(figsize=wanted.size_in)
    wanted.draw(canvas)
    return list(canvas.axes)


def lines(axes: Axes) -> dict[str, tuple[list[float], list[float]]]:
    """Coordinates of the lines of a panel by their names; names that matplotlib gives are left out."""
    named = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
    return {str(line.get_label()): (list(line.get_xdata()), list(line.get_ydata())) for line in named}  # type: ignore[arg-type]


def series(*values: float, step_s: float = 1.0) -> TimeSeries:
    return TimeSeries(step_s * np.arange(len(values)), np.array(values))


# Section 4.1
REAL_M = np.array([[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]])
SIMULATED_M = np.array([[0.0, 0.0], [1.5, 1.0], [4.0, 3.5]])


def replay_report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, asked: list[Any], **more: Any) -> ExperimentReport:
    made = {
        "time_s": np.array([0.0, 5.0, 10.0]),
        "real_m": REAL_M,
        "simulated_m": SIMULATED_M,
        "facts": {"iae_x_ms": 3.5, "iae_y_ms": 14.2},
        "real_speed": series(1.0, 2.0, 1.5, 1.0, step_s=4.0),
        "simulated_speed": series(0.5, 1.0, 2.5, 9.0, step_s=4.0),
        "speed_rms_mps": 0.1234,
        "outputs": {1: series(1500.0, 1600.0, 1700.0, step_s=6.0), 3: series(1500.0, 1400.0, step_s=5.0)},
    } | more

    def compared(real: Any, simulated: Any, start_s: float) -> ReplayComparison:
        asked.append((real.path, simulated.path, start_s))
        return ReplayComparison(**made)

    def run(profile: Any, out: Path, overwrite: bool, make_display: Any, timed: bool = False) -> Result:
        out.mkdir(parents=True)
        (out / "run.mcap").write_bytes(GUST.read_bytes())  # any log
        asked.append(profile)
        return Result({"driver": {"completed": True}}, out, 0)

    monkeypatch.setattr("xitl_cli.experiment.setup.run", run)
    monkeypatch.setattr(section_4_1_recorded_outputs, "compare_replay", compared)
    return recorded_outputs_report(ExperimentSetup(tmp_path, real=CALM, from_s=60.0, until_s=100.0, duration_s=10.0))


@pytest.mark.medium
def test_the_table_of_a_replay(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[Any] = []
    report = replay_report(monkeypatch, tmp_path, asked)
    profile, (real, simulated, start_s) = asked
    assert (real, simulated) == (CALM, tmp_path / "simulated" / "run.mcap")
    assert start_s == pytest.approx(60.0, abs=0.11)  # the first output from then on
    replay = profile.driver.replay
    assert (replay.start_s, replay.end_s - replay.start_s) == pytest.approx((start_s, 10.0), abs=1e-5)
    assert profile.clock.duration_s == 11.0
    rows = rows_of(report)
    assert [rows[name].ours for name in ("IAE x", "IAE y", "replayed for")] == [3.5, 14.2, 10.0]
    assert rows["IAE x"].difference.startswith("Alike: 0.35 m mean over 10 s")
    assert rows["IAE y"].difference.startswith("10 times the paper's: 1.42 m mean over 10 s")
    assert [rows[f"largest error in {axis}"].ours for axis in "xy"] == [2.0, 1.0]
    assert rows["speeds differ by, RMS"].ours == 0.123
    assert rows["speeds differ by, RMS"].difference == "6 % of its top speed of 2.00 m/s."
    assert report.notes[0] == f"The real side is {CALM}."
    assert report.details["drawn"] == {}
    assert report.details["comparison"] == {"iae_x_ms": 3.5, "iae_y_ms": 14.2}
    assert report.completed


@pytest.mark.medium
def test_a_recording_without_speed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    report = replay_report(monkeypatch, tmp_path, [], real_speed=None, speed_rms_mps=None)
    row = rows_of(report)["speeds differ by, RMS"]
    assert (row.ours, row.difference) == (None, "The recording has no speed.")
    _, speeds, _ = drawn(report, "4.1-profiles")
    assert list(lines(speeds)) == ["simulation"]


@pytest.mark.medium
def test_the_figures_of_a_replay(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    report = replay_report(monkeypatch, tmp_path, [])
    (path,) = drawn(report, "4.1-path")
    assert lines(path) == {
        "recording": ([0.0, 1.0, 2.0], [0.0, 2.0, 4.0]),
        "simulation": ([0.0, 1.5, 4.0], [0.0, 1.0, 3.5]),
        "start": ([0.0], [0.0]),
    }
    errors, speeds, outputs = drawn(report, "4.1-profiles")
    found = lines(errors)
    assert found["error in x"] == ([0.0, 5.0, 10.0], [0.0, 0.5, 2.0])
    assert found["error in y"] == ([0.0, 5.0, 10.0], [0.0, -1.0, -0.5])
    levels = sorted(line.get_ydata()[0] for line in errors.get_lines() if len(line.get_xdata()) == 2)  # type: ignore[arg-type, index]
    assert levels == [-1.25, 1.25]
    assert lines(speeds) == {  # up to the end of the comparison at 10 s
        "recording": ([0.0, 4.0, 8.0], [1.0, 2.0, 1.5]),
        "simulation": ([0.0, 4.0, 8.0], [0.5, 1.0, 2.5]),
    }
    assert lines(outputs)["output 1"] == ([0.0, 6.0], [1500.0, 1600.0])
    assert lines(outputs)["output 3"] == ([0.0, 5.0], [1500.0, 1400.0])
    assert outputs.get_ylabel() == "output (µs)"
    (commands,) = drawn(replay_report(monkeypatch, tmp_path / "b", [], outputs={1: series(0.0, -2.0)}), "4.1-profiles")[
        2:
    ]
    assert commands.get_ylabel() == "command"


@pytest.mark.medium
def test_a_replay_is_compared_with_the_log_that_drove_it(tmp_path: Path) -> None:
    """The outputs of an ArduRover drive the scale vessel for 8 s: the curves against both logs."""
    report = recorded_outputs_report(ExperimentSetup(tmp_path, real=CALM, from_s=60.0, until_s=68.0))
    (path,) = drawn(report, "4.1-path")
    errors, speeds, outputs = drawn(report, "4.1-profiles")
    time_s, error_x = map(np.array, lines(errors)["error in x"])
    _, error_y = map(np.array, lines(errors)["error in y"])
    assert (time_s[0], time_s[-1]) == pytest.approx((0.0, 8.0), abs=0.25)
    with open_log(CALM) as log, open_log(tmp_path / "simulated" / "run.mcap") as run:
        pos, truth, ways = log.tables["POS"], run.tables["/truth/state"], log.tables["RCOU"]
        at_s = 1e-9 * pos.stamp_ns - 60.0
        north_m = np.interp(time_s, at_s, 110600.0 * np.asarray(pos.values("Lat")))
        east_m = np.interp(time_s, at_s, 110020.0 * np.asarray(pos.values("Lng")))
        place = np.asarray(truth.values("position_ned_m"))
        truth_s = 1e-9 * (truth.stamp_ns - truth.stamp_ns[0])
        pulses = {number: (1e-9 * ways.stamp_ns - 60.0, np.asarray(ways.values(f"C{number}"))) for number in (1, 3)}
    real_x, real_y = map(np.array, lines(path)["recording"])
    assert real_x == pytest.approx(east_m - east_m[0], abs=0.05)
    assert real_y == pytest.approx(north_m - north_m[0], abs=0.05)
    simulated_x, simulated_y = map(np.array, lines(path)["simulation"])
    assert np.hypot(simulated_x[0], simulated_y[0]) < 0.6  # from rest, where the recording goes at 4 m/s
    assert simulated_x - simulated_x[0] == pytest.approx(np.interp(time_s, truth_s, place[:, 1]), abs=0.05)
    assert simulated_y - simulated_y[0] == pytest.approx(np.interp(time_s, truth_s, place[:, 0]), abs=0.05)
    assert error_x == pytest.approx(simulated_x - real_x)
    assert error_y == pytest.approx(simulated_y - real_y)
    rows = rows_of(report)
    for axis, error in (("x", error_x), ("y", error_y)):
        assert rows[f"IAE {axis}"].ours == pytest.approx(np.trapezoid(np.abs(error), time_s), rel=0.02, abs=0.006)
        assert rows[f"largest error in {axis}"].ours == pytest.approx(np.abs(error).max(), abs=0.006)
    real_s, real_mps = map(np.array, lines(speeds)["recording"])
    assert (real_s[0], real_s[-1]) == pytest.approx((0.0, 8.0), abs=0.3)
    way_m = np.hypot(np.diff(real_x), np.diff(real_y)).sum()
    assert np.trapezoid(real_mps, real_s) == pytest.approx(way_m, rel=0.1)
    simulated_s, simulated_mps = map(np.array, lines(speeds)["simulation"])
    apart = np.interp(time_s, simulated_s, simulated_mps) - np.interp(time_s, real_s, real_mps)
    assert rows["speeds differ by, RMS"].ours == pytest.approx(np.sqrt(np.mean(apart**2)), rel=0.1)
    for number, (at_s, width_us) in pulses.items():
        shown_s, shown_us = map(np.array, lines(outputs)[f"output {number}"])
        assert shown_us == pytest.approx(width_us[np.argmin(np.abs(at_s[:, None] - shown_s), axis=0)])
    assert report.completed


# Section 4.2
TIMES_S = dict(zip(section_4_2_departure.EVENTS, (12.0, 20.0, 20.5, 21.25), strict=True))
SWELL_S = np.arange(0.0, 60.0, 0.1)


def departure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, late_s: float = 0.0) -> ExperimentReport:
    """Departures with ArduPilot: sooner by 5 s with our sensors, and later by `late_s` in gusts."""

    def summary(name: str) -> dict[str, Any]:
        later_s = late_s * name.startswith("current-waves-gusts") - 5.0 * name.endswith("-ours")
        times = {event: at_s + later_s for event, at_s in TIMES_S.items()}
        return {"autopilot": {"firmware": "4.7.0", **times}}

    def traces(directory: Path) -> DepartureTraces:
        gusts, ours = "gusts" in directory.name, directory.name.endswith("-ours")
        calm = directory.name.startswith("calm")
        swell = 70.0 + (0.0 if calm else 0.2) * np.sin(2.0 * math.pi * SWELL_S / 4.0)
        return DepartureTraces(
            TimeSeries(SWELL_S, swell + 1.5),
            TimeSeries(SWELL_S, swell),
            series(0.0, 3.2 - 0.6 * ours, 1.0),
            None if ours else series(70.0, 70.5),
            series(2000.0, 4000.0 if gusts else 3000.0),
        )

    runs_are(monkeypatch, summary)
    monkeypatch.setattr(section_4_2_departure, "_traces", traces)
    program = tmp_path / "ardurover"
    program.write_bytes(Path("/bin/true").read_bytes())
    program.chmod(0o755)
    return departure_report(ExperimentSetup(tmp_path / "out", firmware=str(program)))


@pytest.mark.medium
def test_the_table_of_departures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    report = departure(monkeypatch, tmp_path, late_s=15.0)
    rows = rows_of(report)
    assert report.title == "Departure of ArduPilot 4.7.0 in three environments"
    assert rows["gusts start late by, own sensors"].ours == 15.0
    assert rows["gusts start late by, own sensors"].difference == (
        "It starts 15 s later in gusts, 0.5 times the paper's delay."
    )
    assert rows["gusts start late by, our sensors"].difference == "It starts 15 s later in gusts."
    assert rows["gusts, sooner with ours by"].ours == 5.0
    assert (rows["top speed, own sensors"].ours, rows["top speed, our sensors"].ours) == (3.2, 2.6)
    assert rows["top speed, own sensors"].difference == "The requested speed, within a tenth."
    assert rows["top speed, our sensors"].difference == "0.4 m/s under the requested speed."
    for way in ("own", "our"):
        wave = rows[f"wave period, {way} sensors"]
        assert wave.ours == pytest.approx(4.0, abs=0.03)
        assert "spectrum, 0.14" in wave.difference  # 0.2 m over the root of two, of not quite whole swings
    assert [rows[f"MaxT, {way} sensors"].ours for way in ("own", "our")] == [4000.0, 4000.0]
    assert rows["MaxT, own sensors"].difference.startswith("3000 us in still water")
    assert rows["MaxT, our sensors"].paper == "no loss"
    assert report.completed


@pytest.mark.medium
def test_the_figures_of_departures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    report = departure(monkeypatch, tmp_path)
    own, ours = drawn(report, "4.2-departure")
    assert (own.get_title(), ours.get_title()) == ("own sensors", "our sensors")
    found = lines(own)
    assert found["still water"] == ([0.0, 1.0, 2.0], [0.0, 3.2, 1.0])
    assert set(found) == {*section_4_2_departure.ENVIRONMENTS.values(), "paper: 3 m/s", "paper: gusts start here"}
    assert found["paper: gusts start here"][0] == [51.25, 51.25]  # 30 s after the motion in still water
    assert "paper: gusts start here" not in lines(ours)
    upright = [next(iter(line.get_xdata())) for line in ours.get_lines() if list(line.get_ydata()) == [0, 1]]  # type: ignore[arg-type]
    assert upright == [16.25] * 3
    dots = [list(line.get_xdata()) for line in ours.get_lines() if line.get_marker() == "o"]  # type: ignore[arg-type]
    assert dots == [[7.0]] * 3
    calm, waves, gusts = drawn(report, "4.2-altitude")
    assert gusts.get_title() == "current, waves and gusts, our sensors"
    for panel, height_m in ((calm, 0.0), (waves, 0.2), (gusts, 0.2)):
        for time_s, altitude_m in lines(panel).values():
            assert (time_s[0], time_s[-1]) == pytest.approx((0.05, 29.95), abs=0.06)  # 30 s from the motion at 16.25 s
            assert np.abs(altitude_m).max() == pytest.approx(height_m, abs=0.01)
            expected = height_m * np.sin(2.0 * math.pi * (np.array(time_s) + 16.25) / 4.0)
            assert altitude_m == pytest.approx(expected, abs=0.01)
    loops, heights = drawn(report, "4.2-maxt")
    assert lines(loops)["current, waves and gusts, own sensors"] == ([0.0, 1.0], [2.0, 4.0])
    assert len(lines(loops)) == 6
    assert [list(line.get_ydata()) for line in heights.get_lines()] == [[70.0, 70.5]] * 3  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("late_s", "text"),
    [
        (4.9, "Currents, waves and gusts do not delay it: this estimator sets its origin in any of the three."),
        (-5.0, "It starts 5 s sooner in gusts, -0.2 times the paper's delay."),
    ],
)
@pytest.mark.medium
def test_what_is_said_of_a_delay(late_s: float, text: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert rows_of(departure(monkeypatch, tmp_path, late_s))["gusts start late by, own sensors"].difference == text


# Section 4.3
def base(name: str, rms_ms: float) -> TimeBaseFit:
    residual_s = 1e-3 * rms_ms * np.array([1.0, -1.0, 1.0, -1.0])
    return TimeBaseFit(name, np.arange(4.0), 0.02 * np.arange(4.0), residual_s, 50.0, 1e-3 * rms_ms)


def side(name: str, **more: Any) -> LoopSide:
    later = 2.0 if name == "hitl" else 0.0
    made: dict[str, Any] = {
        "name": name,
        "path_m": np.array([[0.0, 1.0], [2.0, 4.0 + later]]),
        "speed": series(0.0, 1.0 + later),
        "yaw": series(350.0, 5.0, 20.0),
        "outputs": {channel: series(1500.0, 1500.0 + channel) for channel in (1, 3, 4)},
        "events": ((1.0 + later, "armed"), (2.0, "mode AUTO")),
        "max_t": series(1000.0, 150_000.0 * (1.0 + later)),
        "load": series(10.0, 20.0) if later else None,
        "missed": 7,
        "mission_s": 20.0 + 3.04 * later,
        "bases": (base("autopilot", 0.25 + later), base("high level", 1.0)),
    }
    return LoopSide(**(made | more))


def boom(name: str, _recording: Path) -> BoomMap:
    apart_m = 0.0005 if name == "sitl" else 0.02
    points = np.array(
        [[50.0, 50.0, 0.0], [148.5, 60.0, 0.0], [147.0, 129.0, 0.0], [-19.0, 0.0, 0.0], [50.0, -13.0, 0.0]]
    )
    report = {"online": {"mapping": {"boom_rms_m": 0.1234}}, "offline": {}, "difference": {"map_rms_m": apart_m}}
    return BoomMap(name, points, points[:1] + 1.0, np.array([[10.0, 20.0], [30.0, 40.0]]), report)


@pytest.fixture
def two_sides(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., ExperimentReport]:
    def report(
        maps: bool = True, verdict: dict[str, Any] | None = None, done: Sequence[str] = ("sitl", "hitl"), **more: Any
    ) -> ExperimentReport:
        missing = Extra("perception", ("json",) if maps else ("a_module_that_is_not_there",), "perception")
        monkeypatch.setattr(section_4_3_sitl_hitl, "PERCEPTION", missing)
        monkeypatch.setattr(section_4_3_sitl_hitl, "loop_side", lambda name, _: side(name, **more))
        monkeypatch.setattr(section_4_3_sitl_hitl, "boom_map", boom)
        monkeypatch.setattr(section_4_3_sitl_hitl, "_compared", lambda *_: None)
        runs_are(
            monkeypatch,
            lambda name: {
                "mission": {"completed": name in done, "waypoints_reached": 1, "waypoints_total": 2},
                "verdict": verdict,
            },
        )
        return sitl_hitl_report(ExperimentSetup(tmp_path))

    return report


@pytest.mark.medium
def test_the_table_of_both_sides(two_sides: Callable[..., ExperimentReport]) -> None:
    report = two_sides()
    rows = rows_of(report)
    assert report.completed
    assert rows["mission completed"].ours == "both"
    assert rows["paths apart, RMS"].ours is None  # nothing to compare
    assert rows["HITL begins later by"].ours == 6.1
    assert rows["HITL begins later by"].difference.startswith("Later, as in the paper")
    assert (rows["MaxT, SITL"].paper, rows["MaxT, SITL"].ours) == (None, 150_000.0)
    assert (rows["MaxT, HITL"].paper, rows["MaxT, HITL"].ours) == (300_000.0, 450_000.0)
    assert rows["MaxT, SITL"].difference == "Simulated time: no evidence of processor load."
    assert rows["MaxT, HITL"].difference == (
        "1.5 times the paper's; ArduPilot's Linux build on a PC took 401 ms while arming."
    )
    assert rows["deadlines missed in HITL"].ours == 7
    assert (rows["autopilot off a line, HITL"].ours, rows["high level off a line, SITL"].ours) == (2.25, 1.0)
    assert rows["autopilot off a line, HITL"].paper == "straight"
    assert rows["autopilot off a line, SITL"].paper == "varies"
    assert rows["autopilot off a line, SITL"].difference == "At 50.000 Hz over 0 s of simulated time."
    assert rows["boom's points off it, SITL"].ours == 0.123
    assert (rows["offline map apart, SITL"].ours, rows["offline map apart, HITL"].ours) == (0.001, 0.02)
    assert rows["offline map apart, HITL"].difference.startswith("In real time, clouds reach companion")
    assert len(report.notes) == 1
    assert [one["difference"]["map_rms_m"] for one in report.details["maps"]] == [0.0005, 0.02]


@pytest.mark.medium
def test_what_is_missing_is_said(two_sides: Callable[..., ExperimentReport]) -> None:
    slow = {"real_time": False, "shortfalls": ["late by 2 s", "12 deadlines missed"]}
    report = two_sides(maps=False, verdict=slow, done=("sitl",), mission_s=None, max_t=None, bases=())
    rows = rows_of(report)
    assert not report.completed
    assert rows["mission completed"].ours == "SITL"
    assert rows["HITL begins later by"].ours is None
    assert rows["HITL begins later by"].difference == "One of them did not start its mission."
    assert rows["MaxT, HITL"].difference == "Not logged."
    assert not any("map" in name or "off a line" in name for name in rows)
    first, second = report.notes
    assert "No maps: a_module_that_is_not_there not installed" in first
    assert "(late by 2 s; 12 deadlines missed)" in second
    assert [figure.name for figure in report.figures] == ["4.3-mission", "4.3-scheduler", "4.3-time-bases"]
    assert rows_of(two_sides(maps=False, done=()))["mission completed"].ours == "none"


@pytest.mark.medium
def test_the_mission_of_both_sides_is_drawn(two_sides: Callable[..., ExperimentReport]) -> None:
    path, speed, yaw, outputs = drawn(two_sides(), "4.3-mission")
    assert lines(path) == {
        "SITL": ([1.0, 4.0], [0.0, 2.0]),
        "HITL": ([1.0, 6.0], [0.0, 2.0]),
        "waypoints": ([17.6, 89.6], [11.8, 107.8]),
    }
    assert lines(speed) == {"SITL": ([0.0, 1.0], [0.0, 1.0]), "HITL": ([0.0, 1.0], [0.0, 3.0])}
    time_s, yaw_deg = lines(yaw)["SITL"]
    assert time_s == [0.0, 1.0, 2.0]
    assert [yaw_deg[0], yaw_deg[2]] == [350.0, 20.0]
    assert math.isnan(yaw_deg[1])  # the line is broken between 350 and 5 degrees
    assert sorted(lines(outputs)) == ["HITL, 1", "HITL, 3", "SITL, 1", "SITL, 3"]
    assert lines(outputs)["SITL, 3"][1] == [1500.0, 1503.0]
    assert speed.get_xlim() == (-5.0, 1.0)
    assert (path.get_xlabel(), path.get_ylabel()) == ("east (m)", "north (m)")


@pytest.mark.medium
def test_scheduler_and_time_bases_are_drawn(two_sides: Callable[..., ExperimentReport]) -> None:
    report = two_sides()
    events, max_t, load = drawn(report, "4.3-scheduler")
    assert lines(events)["SITL"] == ([1.0, 2.0], pytest.approx([0.075, 1.075]))
    assert lines(events)["HITL"] == ([3.0, 2.0], pytest.approx([-0.075, 0.925]))
    assert [label.get_text() for label in events.get_yticklabels()] == ["armed", "mode AUTO"]
    assert lines(max_t)["SITL"][1] == pytest.approx([1.0, 150.0])
    assert lines(max_t)["HITL"][1] == pytest.approx([1.0, 450.0])
    assert lines(max_t)["paper: 300 ms while arming"][1] == [300.0, 300.0]
    assert lines(load) == {"HITL": ([0.0, 1.0], [10.0, 20.0])}
    *_, empty = drawn(two_sides(load=None), "4.3-scheduler")
    assert [text.get_text() for text in empty.texts] == ["not logged by this autopilot"]
    times, residuals = drawn(report, "4.3-time-bases")
    assert lines(times)["HITL, autopilot"] == ([0.0, 1.0, 2.0, 3.0], pytest.approx([0.0, 0.02, 0.04, 0.06]))
    assert lines(residuals)["HITL, autopilot"][1] == pytest.approx([2.25, -2.25, 2.25, -2.25])
    assert sorted(lines(times)) == ["HITL, autopilot", "HITL, high level", "SITL, autopilot", "SITL, high level"]


@pytest.mark.medium
def test_maps_are_drawn_where_the_boom_is(two_sides: Callable[..., ExperimentReport]) -> None:
    """From 30 m before the first waypoint to 40 m beyond the last: north -18.2 to 147.8, east -12.4 to 129.6."""
    online, offline, *others = drawn(two_sides(), "4.3-map")
    assert [axes.get_title() for axes in (online, offline, *others)] == [
        "SITL, online",
        "SITL, offline",
        "HITL, online",
        "HITL, offline",
    ]
    (points,) = online.collections
    assert points.get_offsets().tolist() == [[50.0, 50.0], [129.0, 147.0]]  # type: ignore[union-attr]
    (points,) = offline.collections
    assert points.get_offsets().tolist() == [[51.0, 51.0]]  # type: ignore[union-attr]
    assert lines(online)["true boom"] == ([20.0, 40.0], [10.0, 30.0])
    assert (online.get_xlim(), online.get_ylim()) == (
        pytest.approx((-12.4, 129.6)),
        pytest.approx((-18.2, 147.8)),
    )


@pytest.fixture
def flown(tmp_path: Path) -> Path:
    """A run's folder with the log of an ArduRover."""
    (tmp_path / "autopilot.bin").symlink_to(CALM)
    (tmp_path / "summary.json").write_text('{"tasks": [{"missed": 2}, {"missed": 3}]}', encoding="utf-8")
    (tmp_path / "run.mcap").write_bytes(recording("release-0.1.0"))
    return tmp_path


def recording(name: str) -> bytes:
    import lzma

    return lzma.decompress((DATA / "recordings" / f"{name}.mcap.xz").read_bytes())


@pytest.mark.medium
def test_a_side_is_read_from_both_logs_of_its_run(flown: Path) -> None:
    found = loop_side("hitl", flown)
    with open_log(CALM) as log, open_log(flown / "run.mcap") as run:
        modes, loops = log.tables["MODE"], log.tables["PM"]
        auto_s = 1e-9 * float(modes.stamp_ns[np.asarray(modes.values("ModeNum", raw=True)) == 10][0])
        assert log.span_ns is not None
        begun_s = 1e-9 * log.span_ns[0]  # it logs while armed
        assert found.mission_s == pytest.approx(max(auto_s, begun_s))
        assert found.missed == 5 + int(np.sum(loops.values("NLon", raw=True)))
        assert found.max_t is not None
        assert found.max_t.values.tolist() == np.asarray(loops.values("MaxT", raw=True)).tolist()
        assert found.load is not None
        assert found.load.values == pytest.approx(0.1 * np.asarray(loops.values("Load", raw=True)))
        yaw = log.tables["ATT"]
        assert found.yaw is not None
        assert found.yaw.time_s == pytest.approx(1e-9 * yaw.stamp_ns - found.mission_s)
        assert found.yaw.values == pytest.approx(np.asarray(yaw.values("Yaw")))
        assert sorted(found.outputs) == [1, 3]  # the others do not change
        assert found.path_m == pytest.approx(np.asarray(run.tables["/truth/state"].values("position_ned_m"))[:, :2])
        (base,) = found.bases
        assert base.name == "autopilot"
        assert len(base.time_s) == len(yaw)
    named = {words: at_s for at_s, words in reversed(found.events)}
    assert named["mode AUTO"] == pytest.approx(auto_s)


@pytest.mark.medium
def test_a_run_is_like_itself_and_less_like_another(flown: Path, tmp_path: Path) -> None:
    gusty = tmp_path / "gusty"
    gusty.mkdir()
    (gusty / "autopilot.bin").symlink_to(GUST)
    for other, same in ((flown, True), (gusty, False)):
        found = section_4_3_sitl_hitl._compared(flown, other)
        assert found is not None
        facts = {fact.key: fact.value for section in found.sections for fact in section.facts}
        grids = [grid for section in found.sections for grid in section.grids]
        yaw = next(row for grid in grids for row in grid.rows if row[0] == "yaw")
        assert (facts["path_rms_m"] == pytest.approx(0.0, abs=0.01)) is same
        assert (yaw[3] == pytest.approx(0.0, abs=0.1)) is same


# Section 4.4
CLOUD = FusedCloud(
    lidar_ned_m=np.array(
        [
            [5.0, 5.0, 0.40],  # on the water, which is 0.35 m below the start
            [5.0, 6.0, 0.26],  # 9 cm above
            [5.0, 6.0, 0.44],
            [9.0, 2.5, 0.20],  # on the branch
            [9.0, 2.5, 0.40],  # water under it
            [5.0, 5.0, 0.49],  # 14 cm below: noise
        ]
    ),
    sonar_ned_m=np.array([[9.0, 2.5, 0.5], [10.0, -4.0, 1.5], [10.5, -4.2, 1.5], [0.0, 9.0, 1.5]]),
    water_down_m=0.35,
    ranges_m={10.0: 9.0, 16.0: 9.128, -30.0: 4.0},
    proximity={"OBSTACLE_DISTANCE": 12, "DISTANCE_SENSOR": 3},
)


def cloud_report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cloud: FusedCloud) -> ExperimentReport:
    runs_are(monkeypatch, lambda name: {})
    monkeypatch.setattr(section_4_4_lidar_sonar, "PERCEPTION", Extra("perception", ("json",), "perception"))
    monkeypatch.setattr(section_4_4_lidar_sonar, "fused_cloud", lambda log: cloud)
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "run.mcap").write_bytes(recording("release-0.1.0"))
    return lidar_sonar_report(ExperimentSetup(tmp_path))


@pytest.mark.medium
def test_points_are_counted_on_the_bodies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    report = cloud_report(monkeypatch, tmp_path, CLOUD)
    ours = {name: row.ours for name, row in rows_of(report).items()}
    assert ours == {
        "water plane in the lidar": 3,
        "lidar under the water": 0,
        "branch in the lidar": 1,
        "branch in the sonar": 1,
        "sunken trunk in the lidar": 0,
        "sunken trunk in the sonar": 2,
        "proximity messages": 15,
        "reported range of the branch": 9.13,  # at 15.5 degrees: the sector at 16
    }
    assert rows_of(report)["proximity messages"].difference == (
        "To the autopilot: 12 OBSTACLE_DISTANCE, 3 DISTANCE_SENSOR."
    )
    assert rows_of(report)["reported range of the branch"].difference == "The branch, 9.3 m away."
    heights_mm = 1e3 * np.std([-0.05, 0.09, -0.09])
    assert f"within {heights_mm:.0f} mm RMS" in rows_of(report)["water plane in the lidar"].difference
    assert report.completed
    assert (tmp_path / "sunken-trunk.obj").read_text(encoding="utf-8").startswith("# sunken trunk, metres\nv ")


@pytest.mark.medium
def test_what_the_paper_does_not_see_fails_the_report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    under = np.vstack([CLOUD.lidar_ned_m, [[10.0, -4.0, 0.0], [3.0, 3.0, 0.51]]])
    report = cloud_report(monkeypatch, tmp_path, FusedCloud(under, CLOUD.sonar_ned_m, 0.35, {}, {}))
    rows = rows_of(report)
    assert (rows["sunken trunk in the lidar"].ours, rows["lidar under the water"].ours) == (1, 1)
    assert rows["lidar under the water"].difference == "The paper's lidar sees nothing there."
    assert rows["sunken trunk in the lidar"].difference == "The paper's lidar does not see it."
    assert rows["proximity messages"].difference == "To the autopilot: none."
    assert rows["reported range of the branch"].difference == "No range was reported in its direction."
    assert not report.completed


@pytest.mark.parametrize(
    ("ranges_m", "told_m"),
    [({}, None), ({20.6: 3.0}, None), ({20.4: 3.0}, 3.0), ({11.0: 5.0, 15.0: 7.0}, 7.0)],
)
def test_the_range_toward_a_place_is_that_of_its_sector(ranges_m: dict[float, float], told_m: float | None) -> None:
    """The branch is at 15.52 degrees; a sector covers 5 degrees to either side."""
    cloud = FusedCloud(np.empty((0, 3)), np.empty((0, 3)), 0.0, ranges_m)
    assert cloud.told_toward((9.0, 2.5)) == told_m


def test_a_footprint_is_all_about_a_line() -> None:
    """2 m to the north-east and as far back, 0.5 m about it."""
    footprint = Footprint((1.0, 2.0), 4.0, 45.0, 0.5)
    root = math.sqrt(0.5)
    points = [
        (1.0, 2.0),
        (1.0 + 2.0 * root, 2.0 + 2.0 * root),
        (1.0 + 2.49 * root, 2.0 + 2.49 * root),
        (1.0 + 2.51 * root, 2.0 + 2.51 * root),
        (1.0 - 0.49 * root, 2.0 + 0.49 * root),
        (1.0 + 0.51 * root, 2.0 - 0.51 * root),
        (1.0 + 2.0 * root, 2.0 - 2.0 * root),
    ]
    inside = footprint.holds(np.array([(*point, 9.0) for point in points]))
    assert inside.tolist() == [True, True, True, False, True, False, False]


@pytest.mark.medium
def test_the_cloud_is_drawn_from_above_and_from_the_side(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    report = cloud_report(monkeypatch, tmp_path, CLOUD)
    above, side_view, *_ = drawn(report, "4.4-cloud")
    shown = [tuple(place) for drawn_ in above.collections for place in np.asarray(drawn_.get_offsets()).tolist()]
    assert (2.5, 9.0) in shown  # east, north
    assert (-4.0, 10.0) in shown
    along = 1.5 * np.array([math.sin(math.radians(70.0)), math.cos(math.radians(70.0))])
    ends = [list(zip(*xy, strict=True)) for xy in ((line.get_xdata(), line.get_ydata()) for line in above.get_lines())]  # type: ignore[arg-type]
    assert any(
        len(two) == 2
        and np.allclose(sorted(two), sorted([(2.5 - along[0], 9.0 - along[1]), (2.5 + along[0], 9.0 + along[1])]))
        for two in ends
    )
    (trunk,) = side_view.patches
    half_m = 2.0 * math.cos(math.radians(60.0))
    assert trunk.get_bbox().bounds == pytest.approx((10.0 - half_m, -1.65, 2.0 * half_m, 0.7))  # type: ignore[attr-defined]


@pytest.mark.medium
def test_the_eight_graphs_are_drawn_with_their_indices() -> None:
    panels = drawn(wdri_report(ExperimentSetup(Path())), "wdri-graphs")
    assert len(panels) == 9
    for axes, printed in zip(panels, wdri_report(ExperimentSetup(Path())).rows, strict=False):
        names = {text.get_text(): text.get_position() for text in axes.texts}
        assert f"paper {printed.paper:.2f}" in axes.get_title()
        assert printed.quantity.split(", ")[0] in axes.get_title()
        assert set(names) == {"D", "HS", "HC", "HA", "M", "LA", "LC", "LS", "PS1"}
        assert names["D"] == pytest.approx((-1.0, 0.0))
        assert names["HA"] == pytest.approx((0.5, math.sqrt(0.75)))
        centres = [patch.center for patch in axes.patches if patch.get_radius() == 0.2]  # type: ignore[attr-defined]
        assert sorted(centres) == sorted(names.values())
