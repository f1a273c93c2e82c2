"""Section 4.3: one mission along the log boom in software in the loop and in hardware in the loop.

The software side runs in lockstep. The hardware side runs in real time. It is an agent on a board, if one is given.
Otherwise it is ArduPilot's Linux build if available, or its simulated build or the embedded autopilot as a separate
process. If perception is installed, a companion maps the boom in both runs, and its map is recomputed from the
recording.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.experiment.report import ExperimentReport, PaperFigure, PaperRow
from xitl_cli.experiment.setup import ExperimentSetup
from xitl_cli.experiment.time_series import Floats, TimeSeries, time_series, true_path_ne_m
from xitl_cli.extras import PERCEPTION
from xitl_cli.firmware.cache import find_firmware
from xitl_cli.log_analyses import log_analyses
from xitl_cli.logs import open_log
from xitl_cli.logs.compare.comparison import OVERLAID, Comparison, compare
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.signals.series import column_series
from xitl_cli.plugins.studies.experiments.figures import OTHER, OURS, mark_paper, name_lines
from xitl_cli.run.session import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from xitl_cli.mapping.rebuild import Measured

MAX_LOOP_US = 300_000.0
"""MaxT while arming in HITL, as printed in the paper."""
LINUX_LOOP_US = 401_037.0
"""MaxT of ArduPilot's Linux build on a PC with sensors injected as a MicroStrain: one recorded run."""

SITL, HITL = "sitl", "hitl"
DURATION_S = 240.0
WAYPOINTS_NE_M = ((11.8, 17.6), (107.8, 89.6))
_HIGHEST_MAP = 8_000  # drawn points


@dataclass(frozen=True, slots=True)
class HardwareSide:
    """Substitute for the hardware."""

    extends: str
    """Profile that it extends."""
    keys: str
    """Additional keys."""
    said: str
    """Description as a sentence."""
    software: str = "sitl"
    """Profile that the software side extends."""
    firmware: str = ""
    """Keys of the software side."""


@dataclass(frozen=True, slots=True)
class TimeBaseFit:
    """Least-squares line of time stamps against sample numbers."""

    name: str
    numbers: Floats
    """Sample numbers, (N,)."""
    time_s: Floats
    """Times, (N,)."""
    residual_s: Floats
    """Deviations from the line, (N,)."""
    rate_hz: float
    """Rate of the line."""
    rms_s: float
    """RMS of the residual."""

    @classmethod
    def of_stamps(cls, name: str, stamp_ns: Any) -> TimeBaseFit | None:
        """Fit the line; None for fewer than three samples."""
        if len(stamp_ns) < 3:
            return None
        time_s = ((np.asarray(stamp_ns, dtype=np.int64) - int(stamp_ns[0])) * 1e-9).astype(np.float64)
        numbers = np.arange(len(time_s), dtype=np.float64)
        slope, start = np.polyfit(numbers, time_s, 1)
        residual = time_s - (slope * numbers + start)
        return cls(name, numbers, time_s, residual, float(1.0 / slope), float(np.sqrt(np.mean(residual**2))))


@dataclass(frozen=True, slots=True)
class LoopSide:
    """One of the two runs. Times are in seconds: from the mission start for speed, yaw and outputs, else its clock."""

    name: str
    path_m: Floats
    speed: TimeSeries | None
    yaw: TimeSeries | None
    outputs: Mapping[int, TimeSeries]
    events: tuple[tuple[float, str], ...]
    max_t: TimeSeries | None
    load: TimeSeries | None
    missed: int
    """Missed deadlines of all tasks or loops."""
    mission_s: float | None
    """Start of the mission on the autopilot's clock, None without a start."""
    bases: tuple[TimeBaseFit, ...]
    """The autopilot's time base, and the high level's."""


@dataclass(frozen=True, slots=True)
class BoomMap:
    """Maps of the boom from one run."""

    name: str
    """Name of the side."""
    online_ned_m: Floats
    """Online map, placed by the true pose at its start, (N, 3)."""
    offline_ned_m: Floats
    """Recomputed map, placed in the same way, (N, 3)."""
    boom_ne_m: Floats
    """Middles of the boom's floats, (K, 2)."""
    report: Mapping[str, Any]
    """Report of `xitl map`."""


def sitl_hitl_report(setup: ExperimentSetup) -> ExperimentReport:
    """Carry out both runs. Raises UserError if a run is impossible, and InterruptedRunError with nothing to compare."""
    hardware = find_hardware(setup)
    maps = not PERCEPTION.missing
    duration_s = setup.duration_s or DURATION_S
    results: list[Result] = []
    for name, extends, keys in ((SITL, hardware.software, hardware.firmware), (HITL, hardware.extends, hardware.keys)):
        text = loop_profile(name, extends, keys, maps)
        setup.tell(f"{name}: the mission in {'lockstep' if name == SITL else 'real time, a minute or two'}")
        results.append(setup.run_profile(name, text, {"clock.seed": setup.seed, "clock.duration_s": duration_s}))
        mission = results[-1].summary.get("mission") or {}
        setup.tell(
            f"  {mission.get('waypoints_reached', 0)} of {mission.get('waypoints_total', 0)} waypoints: "
            f"{results[-1].directory}"
        )
    sides = [loop_side(name, result.directory) for name, result in zip((SITL, HITL), results, strict=True)]
    found = _compared(*(result.directory for result in results))
    boom_maps: list[BoomMap] = []
    if maps:
        setup.tell("odometry and maps again, from the recordings")
        measured = [boom_map(name, result.recording) for name, result in zip((SITL, HITL), results, strict=True)]
        boom_maps = [one for one in measured if one is not None]
    note = f"SITL in lockstep; HITL: {hardware.said}"
    without = "" if maps else f" No maps: {', '.join(PERCEPTION.missing)} not installed; {PERCEPTION.pip_line}."
    figures = [
        PaperFigure(
            "4.3-mission",
            "Path, speed over ground, yaw and outputs of both, from where each began its mission (the paper's "
            "figure 21).",
            lambda figure: _draw_mission(figure, sides),
            (7.0, 6.2),
        ),
        PaperFigure(
            "4.3-scheduler",
            "Events since each autopilot's start, its longest loops and load (the paper's figures 22 and 23a).",
            lambda figure: _draw_scheduler(figure, sides),
            (7.0, 6.4),
        ),
        PaperFigure(
            "4.3-time-bases",
            "Time of autopilot and high level against their sample numbers, and what is off a straight line (the "
            "paper's figure 23b).",
            lambda figure: _draw_bases(figure, sides),
            (7.0, 4.8),
        ),
    ]
    if boom_maps:
        figures.append(
            PaperFigure(
                "4.3-map",
                "Points of the log boom and what is about it, from above: during the run and from its recording (the "
                "paper's figure 24).",
                lambda figure: _draw_maps(figure, boom_maps),
                (7.0, 5.6),
            )
        )
    return ExperimentReport(
        section="4.3",
        title="One mission in software and in hardware in the loop",
        notes=(f"{note}.{without}", *_real_time_notes(results[-1])),
        rows=tuple(_rows(results, sides, found, boom_maps, hardware)),
        figures=tuple(figures),
        runs=tuple(str(result.directory) for result in results),
        completed=all(bool((result.summary.get("mission") or {}).get("completed")) for result in results),
        details={
            "hardware": hardware.said,
            "comparison": {
                fact.key: fact.value for section in (found.sections if found else ()) for fact in section.facts
            },
            "maps": [dict(one.report) for one in boom_maps],
        },
    )


def _real_time_notes(result: Result) -> tuple[str, ...]:
    """Note if this machine did not keep up: other load affects every figure of the run."""
    verdict = result.summary.get("verdict") or {}
    if verdict.get("real_time") is not False:
        return ()
    reason = "; ".join(verdict.get("shortfalls") or ())
    return (f"The HITL run did not keep real time on this machine ({reason}), which affects its timing and maps.",)


def find_hardware(setup: ExperimentSetup) -> HardwareSide:
    """Return the substitute for the hardware. Raises UserError for a firmware firmware that does not exist."""
    if setup.board is not None:
        board = f"autopilot: {{runs: board, link: {setup.board!r}, connect_timeout_s: 20}}"
        keys = f"technique: hitl\n{board}\nclock: {{mode: realtime}}\n"
        return HardwareSide("sitl", keys, f"the embedded autopilot on the board at {setup.board}, in real time")
    firmware = () if setup.firmware is None else (setup.firmware,)
    for build, profile, words in (
        ("linux", "hitl-ardupilot-linux-loopback", "ArduPilot's Linux build here, a MicroStrain port between"),
        ("sitl", "hitl-ardupilot-ahrs-loopback", "ArduPilot's simulated build in real time, a VectorNav port between"),
    ):
        if build == "linux" and firmware:
            continue  # the given firmware is a simulated build: it also runs the software side
        try:
            program = find_firmware("rover", build, *firmware)
            simulated = find_firmware("rover", "sitl", *firmware)
        except UserError:
            if firmware:
                raise
            continue
        named = [f"autopilot: {{firmware: {str(one)!r}}}\n" for one in (program, simulated)]
        return HardwareSide(profile, named[0], words, "sitl-ardupilot-ahrs", named[1])
    keys = "technique: hitl\nautopilot: {runs: process, link: 'udp://127.0.0.1:0'}\nclock: {mode: realtime}\n"
    said = (
        "the embedded autopilot as a separate process over UDP, in real time, because there is no board and no "
        "ArduPilot here (--board URL; `xitl firmware get rover`)"
    )
    return HardwareSide("sitl", keys, said)


def loop_profile(name: str, extends: str, keys: str, maps: bool) -> str:
    """Return the profile of either side: the mission along the boom."""
    parts = [extends, "sites/santo-antonio-river", *(["sensors/perception"] if maps else [])]
    link = "tcp://127.0.0.1:0" if name == SITL else "udp://127.0.0.1:0"
    companion = f"companion: {{runs: process, link: '{link}', parameters: {{AVD_ENABLE: 0}}}}\n" if maps else ""
    return (
        f"# Section 4.3 of the paper: a mission along the log boom, {name.upper()}.\n"
        f"extends: [{', '.join(parts)}, environments/current-waves]\n"
        f"description: A mission along the log boom, {name.upper()}\n\n"
        f"mission: {{waypoints_ned_m: {[list(place) for place in WAYPOINTS_NE_M]}}}\n"
        f"{companion}{keys}"
    )


def loop_side(name: str, directory: Path) -> LoopSide:
    """Read the data of a run from both its logs."""
    log_path = directory / "autopilot.bin"
    with open_log(directory / "run.mcap") as run, open_log(log_path if log_path.exists() else run.path) as log:
        # The first autonomous navigation while armed
        armed = signals.armed(log)
        starts = [
            max(mode.from_ns, span.from_ns)
            for mode in signals.modes(log)
            if mode.text.upper() == "AUTO"
            for span in armed
            if span.from_ns < mode.until_ns and mode.from_ns < span.until_ns
        ]
        begun_s = min(starts) * 1e-9 if starts else None
        # Long loops of the autopilot's scheduler, or missed deadlines in the run's summary
        table = log.tables.get("PM")
        loops = 0 if table is None or "NLon" not in table.columns else int(np.sum(table.values("NLon", raw=True)))
        summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
        return LoopSide(
            name,
            true_path_ne_m(run),
            _from(time_series(signals.ground_speed(log)), begun_s),
            _from(time_series(signals.yaw(log)), begun_s),
            {
                channel: shifted
                for channel, series in signals.outputs(log).items()
                if (shifted := _from(time_series(series), begun_s)) is not None and np.ptp(shifted.values) > 0.0
            },
            tuple(_events(log)),
            time_series(column_series(log, "PM", "MaxT", "us", raw=True)),
            time_series(column_series(log, "PM", "Load", "%", factor=0.1, raw=True)),
            loops + sum(int(task["missed"]) for task in summary.get("tasks") or ()),
            begun_s,
            tuple(
                base
                for words, where, table in (("autopilot", log, "ATT"), ("high level", run, "/companion/odometry"))
                if table in where.tables
                and (base := TimeBaseFit.of_stamps(words, np.sort(where.tables[table].stamp_ns))) is not None
            ),
        )


def boom_map(name: str, recording: Path) -> BoomMap | None:
    """Return the run's map and the map recomputed from its recording; None if the run made none."""
    from xitl_cli.mapping.clouds import map_points
    from xitl_cli.mapping.rebuild import measure, profile_of
    from xitl_cli.scenery import Scenery

    with open_log(recording) as log:
        measured = measure(log)
        if measured.online is None or measured.truth is None or not len(measured.online.stamp_ns):
            return None
        online = np.concatenate([part.points_odom_m for part in map_points(log).values()])
        profile = profile_of(log)
        boom = None if profile is None else Scenery(profile).boom
        return BoomMap(
            name,
            _placed(measured, measured.online.stamp_ns[0], online),
            _placed(measured, measured.rebuilt.trajectory.stamp_ns[0], measured.rebuilt.points_odom_m),
            np.empty((0, 2)) if boom is None else np.asarray(boom.centre_ned_m[:, :2], dtype=np.float64),
            {key: measured.report[key] for key in ("online", "offline", "difference")},
        )


def _placed(measured: Measured, began_ns: int, points_odom_m: Any) -> Floats:
    """Convert to NED by the true pose at the start of the odometry."""
    from sim_core.frames import quat_to_matrix
    from xitl_cli.mapping.clouds import at

    assert measured.truth is not None
    began_ns = int(np.clip(began_ns, measured.truth.stamp_ns[0], measured.truth.stamp_ns[-1]))
    pose = at(measured.truth, np.array([began_ns], dtype=np.int64))
    ned: Floats = points_odom_m @ quat_to_matrix(pose.quat_wxyz)[0].T + pose.pos_m[0]
    return ned


def _from(series: TimeSeries | None, begun_s: float | None) -> TimeSeries | None:
    """Shift to a clock that begins with the mission."""
    if series is None or begun_s is None:
        return None
    return TimeSeries(series.time_s - begun_s, series.values)


def _events(log: Log) -> Iterator[tuple[float, str]]:
    """Yield arming, modes and events by name, in seconds of the log's clock."""
    from xitl_cli.logs.model.codes import event_name
    from xitl_cli.logs.signals.states import event_rows

    yield from ((at_ns * 1e-9, event_name(number)) for at_ns, number in event_rows(log))
    yield from ((mode.from_ns * 1e-9, f"mode {mode.text}") for mode in signals.modes(log))


def _compared(software: Path, hardware: Path) -> Comparison | None:
    """Compare the autopilots' logs from the start of each mission; None without a start."""
    from xitl_cli.logs.model.errors import LogError

    logs = [
        side / "autopilot.bin" if (side / "autopilot.bin").exists() else side / "run.mcap"
        for side in (software, hardware)
    ]
    with open_log(logs[0]) as a, open_log(logs[1]) as b:
        try:
            return compare(a, b, start="mission", analyses=log_analyses(OVERLAID))
        except LogError:
            return None


def _rows(
    results: Sequence[Result],
    sides: Sequence[LoopSide],
    comparison: Comparison | None,
    maps: Sequence[BoomMap],
    hardware: HardwareSide,
) -> Iterator[PaperRow]:
    done = [bool((result.summary.get("mission") or {}).get("completed")) for result in results]
    completed = [side.name.upper() for side, is_done in zip(sides, done, strict=True) if is_done]
    names = "both" if all(done) else ", ".join(completed) or "none"
    yield PaperRow("mission completed", "both", names, "", "As in the paper." if all(done) else "See the runs.")
    facts = {fact.key: fact.value for section in (comparison.sections if comparison else ()) for fact in section.facts}
    off_m = facts.get("path_rms_m")
    yield PaperRow(
        "paths apart, RMS",
        "alike",
        _number(off_m),
        "m",
        "HITL off SITL's path; the paper draws it.",
    )
    motion = {
        row[0]: row for one in (comparison.sections if comparison else ()) for grid in one.grids for row in grid.rows
    }
    for name, words, unit in (("speed over ground", "speeds apart, RMS", "m/s"), ("yaw", "yaws apart, RMS", "deg")):
        rms = motion.get(name, (None,) * 4)[3]
        yield PaperRow(words, "alike", _number(rms), unit, "From the start of each mission; includes waves and noise.")
    software, hardware_side = sides
    late_s = None
    if software.mission_s is not None and hardware_side.mission_s is not None:
        late_s = round(hardware_side.mission_s - software.mission_s, 1)
    yield PaperRow("HITL begins later by", "later", late_s, "s", _late_text(late_s))
    for side, printed in ((software, None), (hardware_side, MAX_LOOP_US)):
        longest = None if side.max_t is None else float(side.max_t.values.max())
        yield PaperRow(f"MaxT, {side.name.upper()}", printed, longest, "us", _loop_text(side, longest, hardware))
    yield PaperRow(
        "deadlines missed in HITL",
        "some",
        hardware_side.missed,
        "",
        "All tasks and loops of the run, not only while arming.",
    )
    for side in sides:
        kind = "simulated" if side.name == SITL else "real"
        for base in side.bases:
            printed_base = "straight" if side.name == HITL else "varies"
            yield PaperRow(
                f"{base.name} off a line, {side.name.upper()}", printed_base, round(1e3 * base.rms_s, 3), "ms",
                f"At {base.rate_hz:.3f} Hz over {base.time_s[-1]:.0f} s of {kind} time.",
            )  # fmt: skip
    for one in maps:
        online = (one.report["online"] or {}).get("mapping", {})
        yield PaperRow(
            f"boom's points off it, {one.name.upper()}", None, _number(online.get("boom_rms_m")), "m",
            "RMS of the map made during the run; the paper shows its maps.",
        )  # fmt: skip
        apart = (one.report["difference"] or {}).get("map_rms_m")
        yield PaperRow(
            f"offline map apart, {one.name.upper()}",
            "slightly" if one.name == SITL else "alike",
            _number(apart),
            "m",
            _map_text(one.name, _number(apart)),
        )


def _late_text(late_s: float | None) -> str:
    if late_s is None:
        return "One of them did not start its mission."
    if late_s > 0.5:
        return "Later, as in the paper, by the autopilot's own clock."
    return "Not later: this autopilot needs the same time in real time and in lockstep."


def _loop_text(side: LoopSide, longest: float | None, hardware: HardwareSide) -> str:
    if longest is None:
        return "Not logged."
    if side.name == SITL:
        return "Simulated time: no evidence of processor load."
    ratio = f"{longest / MAX_LOOP_US:.2g} times the paper's" if longest else "None"
    linux = f"; ArduPilot's Linux build on a PC took {LINUX_LOOP_US / 1e3:.0f} ms while arming"
    return f"{ratio}{'' if 'Linux' in hardware.said else linux}."


def _map_text(name: str, apart_m: float | None) -> str:
    if apart_m is None:
        return "No map."
    if apart_m < 1e-3:
        return "The same map: a lockstep recording contains all messages to the companion."
    if name == SITL:
        return "Clouds and the autopilot's messages reach recording and companion at different times."
    return "In real time, clouds reach companion and recording at different times."


def _number(value: Any) -> float | None:
    return round(float(value), 3) if isinstance(value, float | int) and not isinstance(value, bool) else None


_COLOURS = {SITL: OURS, HITL: OTHER}
_WIDTHS = {SITL: 2.2, HITL: 1.0}


def _draw_mission(figure: Figure, sides: Sequence[LoopSide]) -> None:
    """Draw path, speed, yaw and outputs."""
    (path, speed), (yaw, outputs) = figure.subplots(2, 2)
    longest_s = max((float(side.speed.time_s[-1]) for side in sides if side.speed is not None), default=1.0)
    for side in sides:
        look = {"color": _COLOURS[side.name], "linewidth": _WIDTHS[side.name], "label": side.name.upper()}
        path.plot(side.path_m[:, 1], side.path_m[:, 0], **look)
        for axes, found in ((speed, side.speed), (yaw, side.yaw)):
            if found is not None:
                axes.plot(found.time_s, _unbroken(found.values) if axes is yaw else found.values, **look)
        for style, (channel, found) in zip(("-", "--"), list(side.outputs.items())[:2], strict=False):
            outputs.plot(
                found.time_s, found.values, linestyle=style, **{**look, "label": f"{side.name.upper()}, {channel}"}
            )
    path.plot(*np.array(WAYPOINTS_NE_M).T[::-1], "kx", markersize=5, label="waypoints")
    path.set_aspect("equal", adjustable="datalim")
    path.set_xlabel("east (m)")
    path.set_ylabel("north (m)")
    for axes, words in ((speed, "speed over ground (m/s)"), (yaw, "yaw (°)"), (outputs, "outputs (µs)")):
        axes.set_xlabel("time since the mission began (s)")
        axes.set_ylabel(words)
        axes.set_xlim(-5.0, longest_s)
    for axes in (path, speed, yaw, outputs):
        name_lines(axes, loc="best")


def _unbroken(values: Floats) -> Floats:
    """Break the line at the jump from 360 to 0."""
    drawn = values.copy()
    drawn[1:][np.abs(np.diff(values)) > 180.0] = np.nan
    return drawn


def _draw_scheduler(figure: Figure, sides: Sequence[LoopSide]) -> None:
    """Draw events as marks, MaxT with the paper's, load."""
    events, max_t, load = figure.subplots(3, 1, sharex=True, height_ratios=(2.2, 1.6, 1.0))
    kinds = list(dict.fromkeys(words for side in sides for _, words in sorted(side.events)))
    for number, side in enumerate(sides):
        look = {"color": _COLOURS[side.name], "label": side.name.upper()}
        places = [(at_s, kinds.index(words) + 0.15 * (0.5 - number)) for at_s, words in side.events]
        if places:
            events.plot(*zip(*places, strict=True), "o", markersize=5, **look)
        if side.max_t is not None:
            max_t.plot(side.max_t.time_s, side.max_t.values * 1e-3, marker=".", linewidth=_WIDTHS[side.name], **look)
        if side.load is not None:
            load.plot(side.load.time_s, side.load.values, marker=".", linewidth=_WIDTHS[side.name], **look)
    events.set_yticks(range(len(kinds)), kinds)
    events.set_ylim(-0.6, len(kinds) - 0.4)
    max_t.set_yscale("log")
    mark_paper(max_t, MAX_LOOP_US * 1e-3, "300 ms while arming")
    max_t.yaxis.set_major_formatter("{x:g}")
    max_t.yaxis.set_minor_formatter("{x:g}")
    max_t.set_ylabel("MaxT (ms)")
    load.set_ylabel("load (%)")
    load.set_xlabel("time since the autopilot's start (s)")
    for axes in (events, max_t, load):
        name_lines(axes, loc="center right")
    if not load.lines:
        load.text(0.5, 0.5, "not logged by this autopilot", transform=load.transAxes, ha="center", fontsize=8)


def _draw_bases(figure: Figure, sides: Sequence[LoopSide]) -> None:
    """Draw time against sample numbers, and residuals."""
    times, residuals = figure.subplots(1, 2)
    styles = {"autopilot": "-", "high level": "--"}
    for side in sides:
        for base in side.bases:
            look = {
                "color": _COLOURS[side.name], "linestyle": styles[base.name], "linewidth": _WIDTHS[side.name],
                "label": f"{side.name.upper()}, {base.name}",
            }  # fmt: skip
            every = max(1, len(base.numbers) // 2000)
            times.plot(base.numbers[::every], base.time_s[::every], **look)
            residuals.plot(base.time_s[::every], 1e3 * base.residual_s[::every], **look)
    times.set_xlabel("sample number")
    times.set_ylabel("time (s)")
    residuals.set_xlabel("time (s)")
    residuals.set_ylabel("off the straight line (ms)")
    for axes in (times, residuals):
        name_lines(axes, loc="best")


def _draw_maps(figure: Figure, maps: Sequence[BoomMap]) -> None:
    """Draw a row for each run: online and offline."""
    panels = figure.subplots(len(maps), 2, sharex=True, sharey=True, squeeze=False)
    for row, one in enumerate(maps):
        for axes, words, points in zip(
            panels[row], ("online", "offline"), (one.online_ned_m, one.offline_ned_m), strict=True
        ):
            (low_n, low_e), (high_n, high_e) = (pick(np.array(WAYPOINTS_NE_M), axis=0) for pick in (np.min, np.max))
            inside = (points[:, 0] > low_n - 30) & (points[:, 0] < high_n + 40)
            inside &= (points[:, 1] > low_e - 30) & (points[:, 1] < high_e + 40)
            shown = points[inside][:: max(1, int(inside.sum()) // _HIGHEST_MAP)]
            axes.scatter(
                shown[:, 1],
                shown[:, 0],
                s=0.6,
                c=_COLOURS[one.name],
                linewidths=0,
                rasterized=True,
                label="points of the map",
            )
            axes.plot(one.boom_ne_m[:, 1], one.boom_ne_m[:, 0], color="black", linewidth=0.7, label="true boom")
            axes.set_xlim(low_e - 30, high_e + 40)
            axes.set_ylim(low_n - 30, high_n + 40)
            axes.set_aspect("equal", adjustable="box")
            axes.set_title(f"{one.name.upper()}, {words}")
    for axes in panels[-1]:
        axes.set_xlabel("east (m)")
    for axes in panels[:, 0]:
        axes.set_ylabel("north (m)")
    panels[0, 0].legend(loc="upper left")
