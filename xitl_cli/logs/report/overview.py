"""What every report begins with: the way over ground, speed, yaw, outputs, modes; of all files on one time line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim_core.geodesy import LocalFrame
from xitl_cli.logs import signals
from xitl_cli.logs.log import Log
from xitl_cli.logs.report.model import FileReport, Overview, Track, Waypoint
from xitl_cli.logs.report.thinning import thin
from xitl_cli.logs.sections import Mark, Plot, Trace
from xitl_cli.logs.signals import Series, Span
from xitl_cli.logs.timeline.line import TimeLine

_MOST_TRACK_POINTS = 3000
_MOST_WAYPOINTS = 500
_MOST_SPANS = 500
_FARTHEST_M = 500e3
_NAVIGATION = (16, 17, 18, 19, 21, 22, 31, 82)  # MAV_CMD_NAV_… that are places to go to

Read = Callable[[Log], Series | None]
Style = Literal["line", "steps"]


@dataclass(frozen=True, slots=True)
class Source:
    """A log of a report. label: "" for the only one."""

    log: Log
    time_line: TimeLine
    label: str

    def named(self, name: str) -> str:
        return f"{name} · {self.label}" if self.label else name


def overview(logs: Sequence[Log], files: Sequence[FileReport]) -> Overview:
    several = len(logs) > 1
    sources = [Source(log, file.time_line, file.name if several else "") for log, file in zip(logs, files, strict=True)]
    tracks, waypoints, origin = _ways(sources)
    plots = [
        _over_time("overview.speed", "Speed over ground", "m/s", sources, _SPEEDS),
        _over_time("overview.yaw", "Yaw", "deg", sources, _YAWS),
        *_outputs(sources),
    ]
    modes, armed = states(sources, signals.modes), states(sources, signals.armed)
    lacks = [
        sentence
        for there, sentence in (
            (tracks, "no position was logged, so there is no map: POS, GPS or an odometry topic would give one"),
            (modes, "no mode was logged: MODE messages or heartbeats would tell"),
        )
        if not there
    ]
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
    key: str, title: str, unit: str, sources: Sequence[Source], reads: tuple[tuple[str, Read], ...]
) -> Plot | None:
    traces = [
        _trace(source, f"{name} ({found.source})", found)
        for source in sources
        for name, read in reads
        if (found := read(source.log)) is not None
    ]
    return Plot(key, title, f"{title.split()[0].lower()} ({unit})", tuple(traces)) if traces else None


def _outputs(sources: Sequence[Source]) -> list[Plot]:
    """One plot a unit: pulse widths, and commands from -1 to 1."""
    by_unit: dict[str, list[Trace]] = {}
    for source in sources:
        for channel, found in signals.outputs(source.log).items():
            by_unit.setdefault(found.unit, []).append(_trace(source, f"channel {channel}", found, "steps"))
    return [
        Plot(
            "overview.outputs" + ("" if unit else ".command"),
            "Outputs to motors and servos",
            f"pulse ({unit})" if unit else "command",
            tuple(traces),
        )
        for unit, traces in by_unit.items()
    ]


def _trace(source: Source, name: str, found: Series, style: Style = "line") -> Trace:
    at_ns = np.rint(source.time_line.seconds(found.stamp_ns) * 1e9).astype(np.int64)
    values = found.values
    if found.turns:
        at_ns, values = _broken_turns(at_ns, values)
    return thin(Trace(source.named(name), at_ns, values, style), over_time=True)


def _broken_turns(
    at_ns: NDArray[np.int64], degrees: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Without the stroke across the plot where 360 becomes 0."""
    turns = np.flatnonzero(np.abs(np.diff(degrees)) > 180.0) + 1
    return np.insert(at_ns, turns, at_ns[turns]), np.insert(degrees, turns, np.nan)


def states(sources: Sequence[Source], read: Callable[[Log], list[Span]]) -> tuple[Mark, ...]:
    """Of the first file that tells, on the report's time line."""
    for source in sources:
        if found := read(source.log):
            line = source.time_line
            return tuple(
                Mark(round(line.second(span.from_ns) * 1e9), span.text, round(line.second(span.until_ns) * 1e9))
                for span in found[:_MOST_SPANS]
            )
    return ()


def _ways(
    sources: Sequence[Source],
) -> tuple[list[Track], list[Waypoint], tuple[float, float, float] | None]:
    """All about the origin of the first file that has one; files without a place on the Earth as they are."""
    tracks: list[Track] = []
    origin: tuple[float, float, float] | None = None
    for source in sources:
        for name, of in (("estimate", "estimate"), ("truth", "truth")):
            place = signals.position_ned(source.log, "truth" if of == "truth" else "estimate", origin)
            if place is None:
                continue
            origin = origin or place.origin
            speed = signals.ground_speed(source.log, "truth" if of == "truth" else "estimate")
            if (track := _track(source, name, place.path, speed)) is not None:
                tracks.append(track)
    waypoints: list[Waypoint] = []
    if origin is not None:
        frame = LocalFrame(*origin)
        waypoints = next((found for source in sources if (found := _waypoints(source.log, frame))), [])
    return tracks, waypoints, origin


def _track(source: Source, name: str, path: Series, speed: Series | None) -> Track | None:
    north_m, east_m = path.values[:, 0], path.values[:, 1]
    near = (np.abs(north_m) < _FARTHEST_M) & (np.abs(east_m) < _FARTHEST_M)
    if not near.any():
        return None
    rows = np.flatnonzero(near)
    rows = rows[:: max(1, -(-len(rows) // _MOST_TRACK_POINTS))]
    stamps = path.stamp_ns[rows]
    return Track(
        source.named(name),
        source.time_line.seconds(stamps),
        east_m[rows].astype(np.float64),
        north_m[rows].astype(np.float64),
        None if speed is None else speed.at(stamps),
    )


def _waypoints(log: Log, frame: LocalFrame) -> list[Waypoint]:
    """Places of the mission, by number; the last version of each where it was sent or logged again."""
    for table, number, command, latitude, longitude in (
        ("CMD", "CNum", "CId", "Lat", "Lng"),
        ("MISSION_ITEM_INT", "seq", "command", "x", "y"),
        ("/link/agent/tx:MISSION_ITEM_INT", "seq", "command", "x", "y"),
        ("/link/agent/rx:MISSION_ITEM_INT", "seq", "command", "x", "y"),
    ):
        found = log.tables.get(table)
        names = (number, command, latitude, longitude)
        if found is None or not all(name in found.columns for name in names):
            continue
        rows = np.stack([np.asarray(found.values(name), dtype=np.float64) for name in names], axis=1)
        if np.nanmax(np.abs(rows[:, 2:]), initial=0.0) > 1000.0:
            rows[:, 2:] *= 1e-7
        with np.errstate(invalid="ignore"):
            good = np.isfinite(rows).all(axis=1) & np.isin(rows[:, 1], _NAVIGATION) & (rows[:, 0] > 0)
            good &= (np.abs(rows[:, 2]) <= 90.0) & (np.abs(rows[:, 3]) <= 180.0) & (rows[:, 2:] != 0.0).any(axis=1)
        last = {int(row[0]): row for row in rows[good]}
        if not last:
            continue
        places = np.array([last[each] for each in sorted(last)[:_MOST_WAYPOINTS]])
        path = frame.ned(places[:, 2], places[:, 3], np.full(len(places), frame.altitude_m))
        return [
            Waypoint(str(int(row[0])), float(where[1]), float(where[0]))
            for row, where in zip(places, path, strict=True)
            if abs(where[0]) < _FARTHEST_M and abs(where[1]) < _FARTHEST_M
        ]
    return []
