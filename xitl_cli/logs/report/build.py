"""Report of several logs: opening, alignment on one time line, analysis of each, overview of all."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.geodesy import LocalFrame
from xitl_cli.logs.charts.chart import read_chart
from xitl_cli.logs.clocks.time_line import AlignedLog, TimeLine
from xitl_cli.logs.model.analysis import AnalysisFailure, LogAnalysis, analysis_failure
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Mark, Plot, Section, Trace
from xitl_cli.logs.model.table import whole_ns
from xitl_cli.logs.report.causes import without_contradictions
from xitl_cli.logs.report.file_report import FileReport, RefusedFile
from xitl_cli.logs.report.model import MapTrack, MapWaypoint, Overview, Report
from xitl_cli.logs.report.plots import thin
from xitl_cli.logs.report.signal_data import MOST_BYTES, HeldLog, held_log
from xitl_cli.logs.report.wording import vehicle_line
from xitl_cli.logs.signals import Series, SignalSource, StateSpan
from xitl_cli.logs.signals.missions import mission_rows
from xitl_cli.logs.summary import vehicle_facts

_MOST_TRACK_POINTS = 3000
_MOST_WAYPOINTS = 500
_MOST_SPANS = 500
_FARTHEST_M = 500e3

Read = Callable[[Log], Series | None]
Style = Literal["line", "steps"]


@dataclass(frozen=True, slots=True)
class ReportLog:
    """A log of a report. label: "" for a single log."""

    log: Log
    time_line: TimeLine
    label: str

    def named(self, name: str) -> str:
        return f"{name} · {self.label}" if self.label else name


def build_overview(logs: Sequence[Log], files: Sequence[FileReport]) -> Overview:
    several = len(logs) > 1
    sources = [
        ReportLog(log, file.time_line, file.name if several else "") for log, file in zip(logs, files, strict=True)
    ]
    tracks, waypoints, origin = _ways(sources)
    # One plot per unit: pulse widths, and commands from -1 to 1.
    by_unit: dict[str, list[Trace]] = {}
    for source in sources:
        names = signals.output_names(source.log)
        for channel, output in signals.outputs(source.log).items():
            name = f"channel {channel}" if output.unit else names.get(channel, f"channel {channel}")
            by_unit.setdefault(output.unit, []).append(_trace(source, name, output, "steps"))
    plots = [
        _over_time("overview.speed", "Speed over ground", "m/s", sources, _SPEEDS),
        _over_time("overview.yaw", "Yaw", "deg", sources, _YAWS),
        *[
            Plot(
                "overview.outputs" + ("" if unit else ".command"),
                "Outputs to motors and servos",
                f"pulse ({unit})" if unit else "command",
                tuple(traces),
            )
            for unit, traces in by_unit.items()
        ],
    ]
    modes, armed = state_marks(sources, signals.modes), state_marks(sources, signals.armed)
    lacks = []
    if not tracks:
        lacks.append("no position was logged, so there is no map; log POS, GPS or an odometry topic")
    if not modes:
        lacks.append("no mode was logged; log MODE messages or heartbeats")
    return Overview(
        tuple(plot for plot in plots if plot is not None),
        tuple(tracks),
        tuple(waypoints),
        modes,
        armed,
        origin,
        tuple(lacks),
    )


_SPEEDS: tuple[tuple[str, Read], ...] = (
    ("speed", signals.ground_speed),
    ("true", lambda log: signals.ground_speed(log, "truth")),
)
_YAWS: tuple[tuple[str, Read], ...] = (
    ("yaw", signals.yaw),
    ("desired", signals.yaw_desired),
    ("true", lambda log: signals.yaw(log, "truth")),
)


def _over_time(
    key: str, title: str, unit: str, sources: Sequence[ReportLog], reads: tuple[tuple[str, Read], ...]
) -> Plot | None:
    traces = []
    for source in sources:
        for name, read in reads:
            series = read(source.log)
            if series is not None:
                traces.append(_trace(source, f"{name} ({series.source})", series))
    return Plot(key, title, f"{title.split()[0].lower()} ({unit})", tuple(traces)) if traces else None


def _trace(source: ReportLog, name: str, series: Series, style: Style = "line") -> Trace:
    at_ns = whole_ns(source.time_line.seconds(series.stamp_ns) * 1e9)
    values = series.values
    if series.turns:
        # Values without the line across the plot at the step from 360 to 0.
        turns = np.flatnonzero(np.abs(np.diff(values)) > 180.0) + 1
        at_ns, values = np.insert(at_ns, turns, at_ns[turns]), np.insert(values, turns, np.nan)
    return thin(Trace(source.named(name), at_ns, values, style), over_time=True)


def state_marks(sources: Sequence[ReportLog], read: Callable[[Log], list[StateSpan]]) -> tuple[Mark, ...]:
    """Marks of the first file that has them, on the report's time line."""
    for source in sources:
        if spans := read(source.log):
            line = source.time_line
            return tuple(
                Mark(round(line.second(span.from_ns) * 1e9), span.text, round(line.second(span.until_ns) * 1e9))
                for span in spans[:_MOST_SPANS]
            )
    return ()


def _ways(sources: Sequence[ReportLog]) -> tuple[list[MapTrack], list[MapWaypoint], tuple[float, float, float] | None]:
    """Tracks about the origin of the first file that has one; files without a position on the Earth are unchanged."""
    tracks: list[MapTrack] = []
    origin: tuple[float, float, float] | None = None
    for source in sources:
        for of in get_args(SignalSource):
            place = signals.position_ned(source.log, of, origin)
            if place is None:
                continue
            origin = origin or place.origin
            track = _track(source, of, place.path, signals.ground_speed(source.log, of))
            if track is not None:
                tracks.append(track)
    waypoints: list[MapWaypoint] = []
    if origin is not None:
        frame = LocalFrame(*origin)
        missions = (_waypoints(source.log, frame) for source in sources)
        waypoints = next((mission for mission in missions if mission), [])
    return tracks, waypoints, origin


def _track(source: ReportLog, name: str, path: Series, speed: Series | None) -> MapTrack | None:
    north_m, east_m = path.values[:, 0], path.values[:, 1]
    near = (np.abs(north_m) < _FARTHEST_M) & (np.abs(east_m) < _FARTHEST_M)
    if not near.any():
        return None
    rows = np.flatnonzero(near)
    rows = rows[:: max(1, -(-len(rows) // _MOST_TRACK_POINTS))]
    stamps = path.stamp_ns[rows]
    return MapTrack(
        source.named(name),
        source.time_line.seconds(stamps),
        east_m[rows].astype(np.float64),
        north_m[rows].astype(np.float64),
        None if speed is None else speed.interpolated(stamps),
    )


def _waypoints(log: Log, frame: LocalFrame) -> list[MapWaypoint]:
    """Waypoints of the mission by number, in the last version that was sent or logged."""
    last = {item.seq: item for _, _, item in mission_rows(log) if item.seq and item.place}
    places = [last[seq] for seq in sorted(last)[:_MOST_WAYPOINTS]]
    latitudes, longitudes = (
        np.array([getattr(item, f"{name}_deg") for item in places]) for name in ("latitude", "longitude")
    )
    path = frame.ned(latitudes, longitudes, np.full(len(places), frame.altitude_m))
    return [
        MapWaypoint(str(item.seq), float(where[1]), float(where[0]))
        for item, where in zip(places, path, strict=True)
        if abs(where[0]) < _FARTHEST_M and abs(where[1]) < _FARTHEST_M
    ]


OVERVIEW = "overview"

Progress = Callable[[str], None]


def build_report(
    paths: Sequence[Path],
    analyses: Sequence[LogAnalysis],
    progress: Progress = lambda _: None,
    vessel: str = "",
    *,
    overview: bool = True,
    signals_held: bool = False,
) -> Report:
    """Build a report of every file that can be opened; the others become refusals.

    analyses: in the order of their sections. progress: callback that gets the current step. vessel: as in `open_all`,
    for recordings of several vessels. overview: whether the report begins with the overview. signals_held: whether the
    report keeps signals for the picker of a page.
    """
    with ExitStack() as opened:
        logs, refusals = open_all(paths, opened, vessel)
        names = [name + of_vessel(log) for name, log in zip(short_names([log.path for log in logs]), logs, strict=True)]
        laid = [AlignedLog(log, time_line) for log, time_line in zip(logs, time_lines(logs), strict=True)]
        files = [_file(log, name, analyses, progress) for log, name in zip(laid, names, strict=True)]
        first_part = Overview()
        if overview and files:
            progress(OVERVIEW)
            try:
                first_part = build_overview(laid, files)
            except Exception as error:  # noqa: BLE001  the user still gets the sections, and this as a failure
                files[0] = _with_failure(files[0], OVERVIEW, error)
        held: tuple[HeldLog, ...] = ()
        if signals_held and files:
            progress("signals")
            try:
                held = tuple(
                    held_log(log, file.time_line, file.name if len(files) > 1 else "", MOST_BYTES // len(files))
                    for log, file in zip(laid, files, strict=True)
                )
            except Exception as error:  # noqa: BLE001  as above
                files[0] = _with_failure(files[0], "signals", error)
        # Damage inside a recording is found when its topics are read.
        files = [replace(file, health=log.health) for file, log in zip(files, laid, strict=True)]
        return Report(without_contradictions(files), tuple(refusals), first_part, held)


def with_chart(report: Report, path: Path) -> Report:
    """Return the report with a chart below its tracks. Raises LogError as `read_chart`, and without a track."""
    overview = report.overview
    if not overview.tracks:
        raise LogError(f"{path}: cannot be drawn, because no log has positions; give a log with POS, GPS or odometry")
    places = np.concatenate([np.column_stack([track.east_m, track.north_m]) for track in overview.tracks])
    return replace(report, overview=replace(overview, chart=read_chart(path, overview.origin, places)))


def open_all(paths: Sequence[Path], opened: ExitStack, vessel: str | None = "") -> tuple[list[Log], list[RefusedFile]]:
    """Open files in order. A file that is given twice is opened once.

    For the directory of a run, its recording and the log of its autopilot are opened.

    vessel: the vessel to show of a recording of several. "": the vessel with a folder that contains another of the
    files, as in a run's directory, else the first. None: all vessels, unchanged.
    """
    from xitl_cli.logs.formats import open_log
    from xitl_cli.logs.formats.run_directory import own_log_in, recording_in

    folders = [path.absolute().parent.name for path in paths]
    logs: dict[Path, Log] = {}
    refusals = []
    wanted = deque(paths)
    while wanted:
        path = wanted.popleft()
        if recording_in(path) in logs:
            continue
        try:
            log = open_log(path, vessel)
            nearest = next((folder for folder in folders if folder in log.vessels), log.vessel)
            if vessel == "" and nearest != log.vessel:
                log.close()
                log = open_log(path, nearest)
            logs[log.path] = opened.enter_context(log)
        except LogError as error:
            refusals.append(RefusedFile(path, str(error)))
            continue
        own = own_log_in(path, log.vessel)
        if own is not None:
            wanted.appendleft(own)
    return list(logs.values()), refusals


def of_vessel(log: Log) -> str:
    """The vessel shown, and the number of vessels, to follow the name of the file; empty for a single vessel."""
    return f" ({log.vessel}, one of {len(log.vessels)} vessels)" if log.vessel else ""


def time_lines(logs: Sequence[Log]) -> list[TimeLine]:
    """The time line of each log. A log that could not be aligned counts from its own beginning and reports this."""
    if len(logs) < 2:
        return [TimeLine(zero_ns=log.zero_ns) for log in logs]
    from xitl_cli.logs.clocks.alignment import align_logs as align

    placements = align(logs)
    zero = next(place.log.zero_ns for place in placements if place.reference)
    return [
        TimeLine(
            zero if place.aligned else place.log.zero_ns,
            place.stretches if place.aligned else (),
            place.offset_ns,
            place.drift_ppm,
            place.error_s,
            place.method,
            place.sentence,
            place.reference,
        )
        for place in placements
    ]


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name of each file, with as many folders as needed to distinguish it from the others."""
    named = []
    for path in paths:
        parts = path.absolute().parts
        for many in range(1, len(parts) + 1):
            tail = parts[-many:]
            if sum(other.absolute().parts[-many:] == tail for other in paths) == 1 or many == len(parts):
                named.append("/".join(tail))
                break
    return named


def _file(log: AlignedLog, name: str, analyses: Sequence[LogAnalysis], progress: Progress) -> FileReport:
    sections: list[Section] = []
    failures: list[AnalysisFailure] = []
    for analysis in analyses:
        progress(f"{name}: {analysis.name}")
        try:
            section = analysis.section(log)
            if section is not None:
                # Thin the arrays, because the log is closed later
                plots = (
                    replace(plot, traces=tuple(thin(trace, over_time=plot.kind == "time") for trace in plot.traces))
                    for plot in section.plots
                )
                sections.append(replace(section, plots=tuple[Plot, ...](plots)))
        except Exception as error:  # noqa: BLE001  the user still gets the other sections, and this as a failure
            failures.append(analysis_failure(analysis.name, error, analysis.package))
    vehicle = ""
    with suppress(Exception):  # the analysis of the vehicle names the fault
        vehicle = vehicle_line(vehicle_facts(log))
    return FileReport(
        name,
        log.path,
        log.format,
        log.base,
        log.span_ns,
        log.health,
        dict(log.facts),
        tuple(sections),
        log.time_line,
        vehicle,
        tuple(failures),
        log.vessel,
        log.vessels,
    )


def _with_failure(file: FileReport, name: str, error: Exception) -> FileReport:
    return replace(file, failures=(*file.failures, analysis_failure(name, error)))
