"""Combine logs of runs and vehicles into a scene with one time line and one map.

logs -> one time line (from their clocks, else from a common event)
     -> one map (from their positions on the Earth, else from their starts)
     -> ViewScene once, ViewInstant at any time, marks and findings
"""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from functools import lru_cache
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

import xitl_cli.logs.signals as signals
from agent.wire.dialect import MAV_SEVERITY_INFO
from sim_core.dataclass import dataclass
from sim_core.frames import ned_to_enu, quat_ned_frd_to_enu_flu
from sim_core.geodesy import LocalFrame
from xitl_cli.logs.charts.chart import read_chart
from xitl_cli.logs.compare.pairing import pair_logs, paired_events
from xitl_cli.logs.formats import open_log
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Severity
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.report.build import short_names
from xitl_cli.logs.signals.moments import moments
from xitl_cli.plugins.view.camera_images import image_tracks
from xitl_cli.plugins.view.model import (
    Array,
    BodyInstant,
    SceneMesh,
    SceneVessel,
    SceneWater,
    SceneWaves,
    VesselInstant,
    ViewEvent,
    ViewImage,
    ViewInstant,
    ViewScene,
)
from xitl_cli.plugins.view.scene import (
    NO_WAVES,
    PLAIN_LENGTH_M,
    ROUNDING_S,
    DrawnEntity,
    make_view_scene,
    passing_at,
    plain_vessel,
    read_bodies,
    read_missions,
    read_passing,
    read_scene_updates,
)
from xitl_cli.plugins.view.tracks import (
    FARTHEST_M,
    HeldValues,
    MapPlace,
    MissionChange,
    PoseTrack,
    Seconds,
    VesselTrack,
    continuous,
    forward,
    mission_at,
    read_vessel,
)
from xitl_cli.profile.files.catalogue import PROFILE
from xitl_cli.profile.load import recorded_profiles
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import SeaComponents, vessel_name

if TYPE_CHECKING:
    from xitl_cli.logs.report.model import Report

SCENE = "/scene"
_MARKED = ("fault", "takeover", "error", "event", "estimator")


@dataclass(frozen=True, slots=True)
class SceneMark:
    """An event: arming, a mode, a reached waypoint, a fault, a contact, or an action of an operator."""

    time_s: float
    text: str


@dataclass(frozen=True, slots=True)
class SceneFinding:
    """A finding of the log analysis."""

    time_s: float | None
    """Time of the first evidence, None without one."""
    severity: Severity
    sentence: str
    next_step: str


@dataclass(frozen=True, slots=True, eq=False)
class PlacedLog:
    """A log of one vessel with its placement on the time line and in the map."""

    log: Log
    name: str
    """Name of the vessel in the scene."""
    seconds: Seconds
    """Placement on the time line."""
    place: MapPlace
    track: VesselTrack

    def second(self, stamp_ns: int) -> float:
        """Return a stamp of the log as time on the time line of the scene."""
        return float(self.seconds(np.array([stamp_ns], dtype=np.int64))[0])


@dataclass(frozen=True, slots=True, eq=False)
class DriftingBody:
    """Drifting debris, from its first report on."""

    pose: PoseTrack
    meshes: tuple[SceneMesh, ...]


class LogScene:
    """Logs of vessels as one scene. It is a context manager that closes the logs."""

    def __init__(
        self,
        scene: ViewScene,
        placed: Sequence[PlacedLog],
        others: Mapping[str, PoseTrack],
        bodies: Mapping[int, DriftingBody],
        passing: Sequence[DrawnEntity] = (),
    ) -> None:
        self.scene = scene
        """The constant part. Its notes explain the alignment of the logs, and the data that they lack."""
        self._passing = sorted(passing, key=attrgetter("from_s"))
        self._passing_s = [entity.from_s for entity in self._passing]
        self._longest_s = max((entity.lifetime_s for entity in passing), default=0.0)
        self._placed = placed
        self._images = {vessel.name: dict(image_tracks(vessel.log, vessel.seconds)) for vessel in placed}
        self._others = others
        self._bodies = bodies
        spans = [vessel.track.pose.span_s for vessel in placed]
        self.span_s = min(span[0] for span in spans), max(span[1] for span in spans)
        """First and last time with a known pose of any vessel."""
        lead = placed[0]
        self._waves = _seas(lead, scene.water.waves)
        self._wind, self._current = (_stream(lead, name) for name in ("wind_ned_mps", "current_ned_mps"))
        self._events = sorted((event for vessel in placed for event in _events(vessel)), key=attrgetter("time_s"))
        marks: set[tuple[float, str]] = set()
        for vessel in placed:
            who = f"{vessel.name}: " if vessel.name and len(placed) > 1 else ""
            marks |= {(round(event.at_s, 2), who + event.what) for event in paired_events(vessel.log, vessel.second)}
            for at_ns, text in _moments(vessel.log):
                marks.add((round(vessel.second(at_ns), 2), who + text))
        inside = sorted(mark for mark in marks if self.span_s[0] - 1.0 <= mark[0] <= self.span_s[1] + 1.0)
        self.marks = tuple(SceneMark(min(max(at_s, self.span_s[0]), self.span_s[1]), text) for at_s, text in inside)
        """Events in order of time."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vessels that have a log."""
        return tuple(vessel.name for vessel in self._placed)

    @property
    def logs(self) -> tuple[Log, ...]:
        """One log per file."""
        return tuple({vessel.log.path: vessel.log for vessel in self._placed}.values())

    def track(self, name: str) -> VesselTrack:
        """Return the data of one vessel over time."""
        return next(vessel.track for vessel in self._placed if vessel.name == name)

    def instant(self, time_s: float, since_s: float | None = None, seen: bool = True) -> ViewInstant:
        """Return the world at time_s, with the messages after since_s. seen: include the clouds of sensors."""
        vessels = {vessel.name: vessel.track.at(time_s, seen) for vessel in self._placed}
        vessels |= {name: VesselInstant(*pose.at(time_s)) for name, pose in self._others.items()}
        first = bisect_right(self._passing_s, time_s - self._longest_s)
        behind = bisect_right(self._passing_s, time_s + ROUNDING_S)
        latest = {entity.name: entity for entity in self._passing[first:behind]}  # temporary drawings
        return ViewInstant(
            time_s,
            vessels,
            _flow(self._wind, time_s),
            _flow(self._current, time_s),
            {
                number: BodyInstant(*body.pose.at(time_s), body.meshes)
                for number, body in self._bodies.items()
                if body.pose.span_s[0] <= time_s
            },
            tuple(event for event in self._events if since_s is not None and since_s < event.time_s <= time_s),
            waves=None if self._waves is None else self._waves.at(time_s),
            drawings=passing_at(latest, time_s),
        )

    def images(self, time_s: float) -> dict[tuple[str, str], ViewImage]:
        """Return the newest image of each camera at time_s, by vessel and camera."""
        return {
            (vessel, camera): image
            for vessel, tracks in self._images.items()
            for camera, track in tracks.items()
            if (image := track.at(time_s)) is not None
        }

    def findings(self) -> list[SceneFinding]:
        """Run all analyses on all logs and return their findings, the worst first. It takes seconds."""
        from xitl_cli.log_analyses import log_analyses
        from xitl_cli.logs.report.build import build_report
        from xitl_cli.registry import PluginError

        try:
            analyses = log_analyses()
        except PluginError as error:
            return [SceneFinding(None, Severity.NOTICE, "The logs are not analysed", str(error))]
        paths: dict[str, dict[Path, None]] = {}  # logs of each vessel
        for vessel in self._placed:
            paths.setdefault(vessel.log.vessel, {})[vessel.log.path] = None
        findings: list[tuple[str, SceneFinding]] = []
        for name, logs in paths.items():
            findings += self._of_report(build_report(list(logs), analyses, vessel=name))
        return _worst_first(findings)

    def findings_of(self, report: Report) -> list[SceneFinding]:
        """Return the findings of a report for the logs of this scene, the worst first. Other files are omitted."""
        return _worst_first(list(self._of_report(report)))

    def lead_second(self, stamp_ns: int) -> tuple[Path, float]:
        """Return the path of the lead log, and one of its stamps as time on the time line of the scene."""
        return self._placed[0].log.path, self._placed[0].second(stamp_ns)

    def _of_report(self, report: Report) -> Iterator[tuple[str, SceneFinding]]:
        """Yield key and finding of each problem in a report, for the logs of this scene."""
        placed = {(vessel.log.path, vessel.log.vessel): vessel for vessel in reversed(self._placed)}
        for entry in report.findings:
            vessel, finding = placed.get((entry.file.path, entry.file.vessel)), entry.finding
            if finding.severity is Severity.OK or vessel is None:
                continue
            at_ns = next((evidence.at_ns for evidence in finding.evidence if evidence.at_ns is not None), None)
            time_s = None if at_ns is None else min(max(vessel.second(at_ns), self.span_s[0]), self.span_s[1])
            about = f"{vessel.name}: " if vessel.name and len(self._placed) > 1 else ""
            sentence = about + finding.sentence
            yield finding.key, SceneFinding(time_s, finding.severity, sentence, finding.next_step)

    def close(self) -> None:
        """Close the logs. Instants cannot be drawn afterwards, because their clouds are read from the logs."""
        for vessel in self._placed:
            vessel.log.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True, slots=True, eq=False)
class _Recording:
    """The surroundings that a recording of xitl contains."""

    raw: Log
    """All topics of the file."""
    profiles: tuple[RunProfile, ...] = ()
    drawn: tuple[tuple[int, list[DrawnEntity]], ...] = ()
    """Stamps in ns and entities of the recorded scene updates."""

    @property
    def entities(self) -> list[DrawnEntity]:
        return [entity for _, entities in self.drawn for entity in entities]


def _worst_first(findings: Sequence[tuple[str, SceneFinding]]) -> list[SceneFinding]:
    """Return the findings without duplicates of key and sentence, the worst first."""
    once: dict[tuple[str, str], SceneFinding] = {}
    for key, finding in findings:
        once.setdefault((key, finding.sentence), finding)
    return sorted(once.values(), key=lambda finding: -finding.severity)


def open_scene(paths: Sequence[Path], vessel: str | None = None, chart: Path | None = None) -> LogScene:
    """Return the logs at `paths` as one scene. The lead is the first log with surroundings, else the first log.

    vessel: the vessel to show from recordings of several vessels, all by default. chart: file or folder of a chart on
    the water. Raises LogError if a file is not a log, if no log has both positions and attitudes, and as `read_chart`.
    """
    if not paths:
        raise LogError("no log; name a .bin, a .tlog or an .mcap")
    with ExitStack() as opened:
        logs = [log for path in dict.fromkeys(paths) for log in _open_vessels(path, vessel, opened)]
        recordings: dict[Path, _Recording] = {}
        for log in logs:  # several of them for a recording of several vessels
            if log.path not in recordings:
                recordings[log.path] = _recording(log, opened)
        lead = next((log for log in logs if recordings[log.path].drawn), logs[0])
        logs.sort(key=lambda log: log.path != lead.path)
        notes: list[str] = []
        placed = _place_logs(logs, notes)
        scene, others, bodies = _surroundings(placed, recordings, notes)
        if chart is not None:
            places = np.concatenate([vessel.track.pose.position_enu_m[:, :2] for vessel in placed])
            scene = replace(scene, chart=read_chart(chart, placed[0].place.origin, places))
        opened.pop_all()
        for recording in recordings.values():
            if recording.raw not in logs:
                recording.raw.close()
    passing = [
        replace(entity, from_s=placed[0].second(stamp_ns))
        for stamp_ns, entities in recordings[lead.path].drawn
        for entity in read_passing(entities)
    ]
    return LogScene(scene, placed, others, bodies, passing)


@contextmanager
def scene_of(recording: LogScene | Sequence[Path]) -> Iterator[LogScene]:
    """Yield an open scene as it is, or the scene of the logs at paths, which is closed afterwards."""
    if isinstance(recording, LogScene):
        yield recording
    else:
        with open_scene(recording) as scene:
            yield scene


def _open_vessels(path: Path, vessel: str | None, opened: ExitStack) -> Iterator[Log]:
    """Yield the log. For a recording of several vessels, yield one log per vessel."""
    log = open_log(path)
    if log.vessels:
        log.close()
        for name in (vessel,) if vessel else log.vessels:
            yield opened.enter_context(open_log(path, name))
        return
    opened.enter_context(log)
    if vessel and log.base == "simulation":
        open_log(path, vessel)  # which refuses it
    yield log


def _recording(log: Log, opened: ExitStack) -> _Recording:
    raw = log if not log.vessel else opened.enter_context(open_log(log.path))
    if log.format != "mcap" or log.base != "simulation":
        return _Recording(raw)
    stamp_ns = raw.tables[SCENE].stamp_ns.tolist() if SCENE in raw.tables else ()
    drawn = zip(stamp_ns, map(read_scene_updates, raw.payloads(SCENE)), strict=True)
    return _Recording(raw, recorded_profiles(log.attachment(PROFILE)), tuple(drawn))


def _place_logs(logs: Sequence[Log], notes: list[str]) -> list[PlacedLog]:
    """Return the logs that have positions and attitudes. The first is the lead, to which the others are aligned."""
    names = [log.vessel for log in logs]
    paths = list(dict.fromkeys(log.path for log in logs))
    if len(paths) > 1:  # the names begin with the file's name, and contain no `/`
        files = dict(zip(paths, short_names(paths), strict=True))
        names = [f"{files[log.path]} {log.vessel}".strip().replace("/", " ") for log in logs]
    placed: list[PlacedLog] = []
    lacking: list[str] = []
    for log, name in zip(logs, names, strict=True):
        lack = _lack(log)
        if lack:
            lacking.append(f"{log.path}: {lack}")
            continue
        lead = placed[0] if placed else None
        seconds = _seconds(log, lead, name, notes)
        place = _map_place(log, lead, seconds, name, notes)
        track = read_vessel(log, seconds, place)
        if track is None:
            lacking.append(f"{log.path}: its positions and attitudes have no common time, so it cannot be drawn")
            continue
        placed.append(PlacedLog(log, name, seconds, place, track))
    if not placed:
        raise LogError("; ".join(lacking))
    notes += lacking
    if len(placed) == 1 and len(logs) > 1 and not placed[0].log.vessel:
        placed = [replace(placed[0], name="")]
    return placed


def _lack(log: Log) -> str:
    """Return a clause about the data that the log lacks for drawing, empty if it is complete."""
    if log.span_ns is None:
        return "has no data with a time, so it cannot be drawn; give another log"
    sources: tuple[signals.SignalSource, ...] = ("truth", "estimate")
    place = any(signals.position_ned(log, of) is not None for of in sources)
    turn = any(signals.yaw(log, of) is not None for of in sources)
    if place and turn:
        return ""
    missing = "position" if turn else "attitude" if place else "position and no attitude"
    return (
        f"has no {missing}, so it cannot be drawn; give a log with both (POS or GPS and ATT, GLOBAL_POSITION_INT and "
        "ATTITUDE, or an odometry or pose topic)"
    )


def _seconds(log: Log, lead: PlacedLog | None, name: str, notes: list[str]) -> Seconds:
    """Align a log with the lead's time: by the clocks of both, else by a common event, else by the first rows."""
    if lead is None:
        zero_ns = log.zero_ns
        return lambda stamp_ns: (np.asarray(stamp_ns, dtype=np.int64) - zero_ns).astype(np.float64) * 1e-9
    if lead.log.path == log.path:
        return lead.seconds
    try:
        pairing = pair_logs(lead.log, log)
    except LogError:
        first_ns = (log.span_ns or (0, 0))[0]
        begins_s = lead.track.pose.span_s[0]
        notes.append(f"{name}: has no common time with {lead.name}; both begin at the same time here")
        return lambda stamp_ns: (np.asarray(stamp_ns, dtype=np.int64) - first_ns).astype(np.float64) * 1e-9 + begins_s
    notes.append(f"{name}: aligned with the time of {lead.name}: {pairing.sentence}")
    return lambda stamp_ns: lead.seconds(pairing.on_a(np.asarray(stamp_ns, dtype=np.int64)))


def _map_place(log: Log, lead: PlacedLog | None, seconds: Seconds, name: str, notes: list[str]) -> MapPlace:
    """Align a log with the lead's map: by near positions on the Earth of both, else by their starts."""
    own = _origin(log)
    if lead is None or log.path == lead.log.path:
        return MapPlace(own) if lead is None else lead.place
    about = lead.place.origin
    if about is not None and (own is not None or signals.position_ned(log, "estimate", about) is not None):
        position = signals.position_ned(log, "truth", about) or signals.position_ned(log, "estimate", about)
        if position is not None and position.origin == about and np.hypot(*position.path.values[0, :2]) < FARTHEST_M:
            return MapPlace(about, lead.place.shift_enu_m)
    alone = read_vessel(log, seconds, MapPlace(own))
    if alone is None:
        return MapPlace(own)
    starts_s = max(alone.pose.span_s[0], lead.track.pose.span_s[0])
    shift = lead.track.pose.at(starts_s)[0] - alone.pose.at(starts_s)[0]
    why = "has no place on the Earth" if own is None else f"is too far from {lead.name} for one map"
    if about is None and own is not None:
        why = f"has a place on the Earth, but {lead.name} has none"
    notes.append(f"{name}: {why}; both start at the same place here")
    east, north, up = shift.tolist()
    return MapPlace(own, (east, north, up))


def _origin(log: Log) -> tuple[float, float, float] | None:
    """Return the origin of the log's own map."""
    position = signals.position_ned(log, "truth") or signals.position_ned(log, "estimate")
    return None if position is None else position.origin


def _surroundings(
    placed: list[PlacedLog], recordings: Mapping[Path, _Recording], notes: list[str]
) -> tuple[ViewScene, dict[str, PoseTrack], dict[int, DriftingBody]]:
    """Return the lead's scene with the vessels of all logs. Set the recorded missions in `placed`."""
    lead = placed[0]
    recording = recordings[lead.log.path]
    title = ", ".join(vessel.name or vessel.log.path.name for vessel in placed)
    scene = make_view_scene(title, recording.entities, recording.profiles)
    vessels: dict[str, SceneVessel] = {}
    plain: list[str] = []
    length_m = max((vessel.length_m for vessel in scene.vessels.values()), default=PLAIN_LENGTH_M)
    for number, vessel in enumerate(placed):
        own = recordings[vessel.log.path]
        own_scene = scene if own is recording else make_view_scene(title, own.entities, own.profiles)
        drawn = own_scene.vessels.get(vessel.log.vessel)
        if drawn is None:
            drawn = plain_vessel(length_m, len(plain))
            plain.append(vessel.name or vessel.log.path.name)
        missions = _drawn_missions(own, vessel) or vessel.track.missions
        placed[number] = replace(vessel, track=replace(vessel.track, missions=missions))
        vessels[vessel.name] = replace(drawn, mission_enu_m=mission_at(missions, -math.inf).places_enu_m)
    others: dict[str, PoseTrack] = {}
    if len(recordings) == 1 or lead.log.vessels:
        for name in scene.vessels.keys() - {vessel.log.vessel for vessel in placed if vessel.log.path == lead.log.path}:
            table = recording.raw.tables.get(f"/{vessel_name('truth/state', name)}")  # of a vessel without an autopilot
            pose = None if table is None else _poses(table, np.arange(len(table)), lead.seconds)
            if name and pose is not None:
                others[name] = pose
                vessels[name] = scene.vessels[name]
    if plain:
        notes.append(
            f"{', '.join(plain)}: the log does not describe the shape of the vessel; a plain boat of 2 m is drawn"
        )
    water = scene.water
    if not recording.drawn:
        # Still water in the middle of the paths
        places = np.concatenate([vessel.track.pose.position_enu_m for vessel in placed])
        low, high = places.min(axis=0), places.max(axis=0)
        east, north = ((low + high) / 2)[:2].tolist()
        water = SceneWater(0.0, (east, north))
        notes.append(f"{lead.log.path.name}: has no scene; the water is drawn without banks and waves")
    elif not recording.profiles:
        notes.append(
            f"{lead.log.path.name}: has no profile that this version can read; the water is drawn without waves"
        )
    scene = replace(scene, vessels=vessels, water=water, notes=(*scene.notes, *dict.fromkeys(notes)))
    return scene, others, _bodies(recording, lead)


def _drawn_missions(recording: _Recording, vessel: PlacedLog) -> tuple[MissionChange, ...]:
    """Return the missions of a run's vessel, in the map of the scene. They are empty without waypoints."""
    plans = [(stamp_ns, read_missions(entities).get(vessel.log.vessel)) for stamp_ns, entities in recording.drawn]
    plans = [(stamp_ns, places) for stamp_ns, places in plans if places is not None and len(places) > 1]
    if not plans:
        return ()
    # The shift from the map of the run to the map of the scene
    shift_enu_m, own, origin = np.asarray(vessel.place.shift_enu_m), _origin(vessel.log), vessel.place.origin
    if own is not None and origin is not None and own != origin:
        ned = LocalFrame(*origin).ned(*(np.array([value]) for value in own))[0]
        shift_enu_m = ned_to_enu(ned) + shift_enu_m
    return tuple(MissionChange(vessel.second(stamp_ns), places + shift_enu_m) for stamp_ns, places in plans)


def _poses(table: Table, rows: NDArray[np.intp], seconds: Seconds) -> PoseTrack | None:
    """Return the poses from the columns position_ned_m and quaternion_ned_frd, None without them."""
    if not {"position_ned_m", "quaternion_ned_frd"} <= set(table.columns) or not len(rows):
        return None
    at_s, later = forward(seconds(table.stamp_ns[rows]))
    place = ned_to_enu(np.asarray(table.values("position_ned_m", rows[later]), dtype=np.float64))
    turn = quat_ned_frd_to_enu_flu(np.asarray(table.values("quaternion_ned_frd", rows[later]), dtype=np.float64))
    return PoseTrack(at_s, place, at_s, continuous(turn))


def _bodies(recording: _Recording, lead: PlacedLog) -> dict[int, DriftingBody]:
    table = recording.raw.tables.get("/truth/bodies")
    if table is None or "number" not in table.columns:
        return {}
    meshes = read_bodies(recording.entities)
    numbers = np.asarray(table.values("number"), dtype=np.int64)
    bodies = {}
    for number in np.unique(numbers).tolist():
        pose = _poses(table, np.flatnonzero(numbers == number), lead.seconds)
        if pose is not None:
            bodies[number] = DriftingBody(pose, meshes.get(number, ()))
    return bodies


def _stream(lead: PlacedLog, field: str) -> HeldValues | None:
    table = lead.log.tables.get("/environment")
    if table is None or field not in table.columns:
        return None
    return HeldValues(lead.seconds(table.stamp_ns), np.asarray(table.values(field), dtype=np.float64))


class _Seas:
    """Waves that an operator changed. Each sea holds from its own time on. Before all of them, the first sea holds."""

    def __init__(self, seconds: Array, table: Table, first: SceneWaves | None) -> None:
        self._seconds, self._table, self._first = seconds, table, first or NO_WAVES
        self._read = lru_cache(maxsize=8)(self._sea)

    def at(self, time_s: float) -> SceneWaves:
        """Return the waves at a time. The object stays the same until the waves change."""
        row = int(np.searchsorted(self._seconds, time_s, side="right")) - 1
        waves: SceneWaves = self._first if row < 0 else self._read(row)
        return waves

    def _sea(self, row: int) -> SceneWaves:
        components = np.array(
            [self._table.values(field.name, np.array([row]))[0] for field in fields(SeaComponents)], dtype=np.float64
        )
        # The table pads a sea that has fewer components than another sea.
        amplitude, north, east, frequency, phase = components[:, np.isfinite(components[0])]
        return SceneWaves(amplitude, np.stack([east, north], axis=-1), frequency, phase)


def _seas(lead: PlacedLog, first: SceneWaves | None) -> _Seas | None:
    table = lead.log.tables.get("/environment/waves")
    if table is None or not {field.name for field in fields(SeaComponents)} <= set(table.columns):
        return None
    return _Seas(lead.seconds(table.stamp_ns), table, first)


def _flow(stream: HeldValues | None, time_s: float) -> tuple[float, float]:
    """Return the velocity of a stream, east and north."""
    ned = None if stream is None else stream.at(time_s)
    return (0.0, 0.0) if ned is None or not np.isfinite(ned).all() else (float(ned[1]), float(ned[0]))


def _events(vessel: PlacedLog) -> Iterator[ViewEvent]:
    who = f"{vessel.name}: " if vessel.name else ""
    for text in signals.texts(vessel.log):
        severity = MAV_SEVERITY_INFO if text.severity is None else text.severity
        yield ViewEvent(vessel.second(text.at_ns), severity, who + text.text.strip())


def _moments(log: Log) -> Iterator[tuple[int, str]]:
    """Yield stamps and texts of faults and errors, of the starts of contacts, and of operator actions."""
    for moment in moments(log):
        if moment.kind in _MARKED:
            yield moment.at_ns, moment.text
    contacts = log.tables.get("/contacts")
    if contacts is not None and {"what", "began"} <= set(contacts.columns):
        for row in np.flatnonzero(np.asarray(contacts.values("began"))).tolist():
            yield int(contacts.stamp_ns[row]), f"contact with {contacts.values('what', np.array([row]))[0]}"
    actions = log.tables.get("/operator/action")
    if actions is not None and "action" in actions.columns:
        for at_ns, text in zip(actions.stamp_ns.tolist(), actions.values("action"), strict=True):
            yield at_ns, f"by hand: {action_text(str(text))}"


def action_text(text: str) -> str:
    """Return an action as words, such as `wind mean_mps 6`. Other text stays unchanged."""
    try:
        action = dict(json.loads(text))
    except (ValueError, TypeError, RecursionError):
        return text
    words = [str(action.pop("action", "?")), *(f"{key} {value}" for key, value in action.items() if value != "")]
    return " ".join(words)
