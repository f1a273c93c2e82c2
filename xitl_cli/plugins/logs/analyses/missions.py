"""The mission: loaded items, its legs, cross-track errors, and its completion."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from sim_core.geodesy import LocalFrame
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import (
    ALTITUDE_FRAMES,
    OPERATOR_ARMING_METHODS,
    OPERATOR_REASONS,
    arming_method_name,
    command_name,
)
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Section, Severity
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.model.text import length_text
from xitl_cli.logs.signals.missions import LoggedMissionItem, MissionVersion, mission_versions
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.states import autopilot_messages
from xitl_cli.plugins.logs.analyses.arming import disarming_method
from xitl_cli.plugins.logs.analyses.modes import ModeSpan, mode_spans


@dataclass(frozen=True, slots=True)
class MissionLeg:
    """The way to item `seq`."""

    seq: int
    from_ns: int
    until_ns: int
    """Instant at which it was reached, or left."""
    reached: bool
    """Whether it was reached."""


@dataclass(frozen=True, slots=True)
class LegTrack:
    """Track of one leg."""

    way_m: float | None = None
    """Length of the path."""
    length_m: float | None = None
    """Straight length."""
    cross_rms_m: float | None = None
    """Root mean square of the distance from its line."""
    cross_max_m: float | None = None
    """Largest distance from its line."""


def length_m(plan: MissionVersion) -> float:
    """Length along the straight lines between waypoints."""
    places = plan.places
    if len(places) < 2:
        return 0.0
    path = _path(places, places[0])
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _path(places: list[LoggedMissionItem], origin: LoggedMissionItem) -> NDArray[Any]:
    """(N, 2) north and east in m."""
    frame = LocalFrame(origin.latitude_deg, origin.longitude_deg, 0.0)
    latitudes, longitudes = (
        np.array([getattr(item, name) for item in places]) for name in ("latitude_deg", "longitude_deg")
    )
    return np.asarray(frame.ned(latitudes, longitudes, np.zeros(len(places))))[:, :2]


def leg_tracks(log: Log, plan: MissionVersion | None, legs: list[MissionLeg]) -> list[LegTrack]:
    """Path of each leg against its line, which begins at the previous waypoint, or at the start of the first leg."""
    geodetic = signals.position_geodetic(log)
    if plan is None or geodetic is None or not legs:
        return [LegTrack()] * len(legs)
    items = {item.seq: item for item in plan.places}
    found: list[LegTrack] = []
    before: LoggedMissionItem | None = None
    for leg in legs:
        item = items.get(leg.seq)
        first = int(np.searchsorted(geodetic.stamp_ns, leg.from_ns))
        after = int(np.searchsorted(geodetic.stamp_ns, leg.until_ns, side="right"))
        if item is None or after - first < 2:
            found.append(LegTrack())
            before = item or before
            continue
        frame = LocalFrame(item.latitude_deg, item.longitude_deg, 0.0)
        latitude_deg, longitude_deg = geodetic.values[first:after, :2].T
        way = np.asarray(frame.ned(latitude_deg, longitude_deg, np.zeros(after - first)))[:, :2]
        start = way[0] if before is None else _path([before], item)[0]
        # Track of a leg. `way`: path relative to the waypoint at (0, 0). `start`: beginning of the line to
        # it.
        length_m = float(np.hypot(*start))
        way_m = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
        if length_m < 0.1:
            against = LegTrack(way_m, length_m)
        else:
            across = np.abs(way @ np.array([start[1], -start[0]])) / length_m
            against = LegTrack(way_m, length_m, float(np.sqrt(np.mean(across**2))), float(across.max()))
        found.append(against)
        before = item
    return found


def overall_rms_m(legs: list[MissionLeg], sailed: list[LegTrack]) -> float | None:
    """Root mean square over time: each leg is weighted by its duration."""
    known = [
        ((leg.until_ns - leg.from_ns) * 1e-9, one.cross_rms_m)
        for leg, one in zip(legs, sailed, strict=True)
        if one.cross_rms_m is not None
    ]
    total_s = sum(seconds for seconds, _ in known)
    if total_s <= 0.0:
        return None
    return rounded(np.sqrt(sum(seconds * rms**2 for seconds, rms in known) / total_s))


def largest_m(sailed: list[LegTrack]) -> float | None:
    return rounded(max((one.cross_max_m for one in sailed if one.cross_max_m is not None), default=None))


_REACHED = re.compile(r"^Reached (?:waypoint|command) #?(\d+)", re.I)
_COMPLETE = re.compile(r"^Mission complete\b", re.I)
_COMPLETE_STATE = 5  # MISSION_STATE_COMPLETE
_AUTO = "AUTO"
_MOST_LEGS = 2000
_REPEATED_NS = 5_000_000_000
_HEARD_LATE_NS = 1_500_000_000  # MISSION_CURRENT arrives once a second


def analyse(log: Log) -> Section | None:
    loaded, taken_up, reached = mission_versions(log), executed_items(log), reached_at(log)
    if not loaded and not taken_up and not reached:
        return None
    clock, modes = LogClock(log), mode_spans(log)
    legs = _legs(log, taken_up, reached, modes, clock)
    said = [text.at_ns for text in signals.texts(log) if _COMPLETE.match(text.text)]
    table = autopilot_messages(log, "MISSION_CURRENT")
    if table is not None and "mission_state" in table.columns:
        said += table.stamp_ns[np.asarray(table.values("mission_state", raw=True)) == _COMPLETE_STATE].tolist()
    complete_ns = min(said, default=None)
    plan = _plan_in_force(loaded, legs)
    sailed = leg_tracks(log, plan, legs)
    wanted = len(plan.places) if plan else _last_item(log) or None
    done = len({leg.seq for leg in legs if leg.reached})
    last = max((item.seq for item in plan.places), default=0) if plan else _last_item(log)
    complete = complete_ns is not None or (bool(last) and any(leg.reached and leg.seq == last for leg in legs))
    complete |= bool(wanted) and done >= (wanted or 0)
    lacks = []
    if legs and not reached:
        lacks.append("The log does not show when waypoints were reached, only when the next one was started.")
    if not legs and any(span.name == _AUTO for span in modes):
        lacks.append("The log does not show which items were executed: it has no MISE and no MISSION_CURRENT.")
    facts = (
        Fact("waypoints", "Waypoints", wanted),
        Fact("waypoints_reached", "Waypoints reached", done if legs else None),
        Fact("mission_completed", "Completed", complete if legs or complete_ns is not None else None),
        Fact("mission_length_m", "Length", None if plan is None else rounded(length_m(plan), 1), "m"),
        Fact("mission_time_s", "Time", rounded((legs[-1].until_ns - legs[0].from_ns) * 1e-9, 1) if legs else None, "s"),
        Fact("cross_track_rms_m", "Cross track, RMS", overall_rms_m(legs, sailed), "m"),
        Fact("cross_track_max_m", "Cross track, largest", largest_m(sailed), "m"),
    )
    findings = [*_unfinished(log, legs, complete, done, wanted, modes, clock), *_changed(log, loaded, legs, clock)]
    grids = [found for found in (_leg_table(plan, legs, sailed, clock), _plan_table(plan)) if found is not None]
    known = tuple(fact for fact in facts if fact.value is not None)
    return Section("missions", "Mission", known, tuple(findings), tuple(grids), (), tuple(lacks))


def executed_items(log: Log) -> list[tuple[int, int]]:
    """(stamp, number) of each item started, in order of time."""
    table = log.tables.get("MISE")
    if table is not None and "CNum" in table.columns:
        return _sequence(table, "CNum", changes_only=False)
    table = autopilot_messages(log, "MISSION_CURRENT")
    return [] if table is None or "seq" not in table.columns else _sequence(table, "seq", changes_only=True)


def _sequence(table: Table, column: str, changes_only: bool) -> list[tuple[int, int]]:
    order = np.argsort(table.stamp_ns, kind="stable")
    numbers = np.asarray(table.values(column, raw=True))[order].astype(np.int64)
    stamps = table.stamp_ns[order]
    if changes_only and len(numbers):
        new = np.concatenate(([True], np.diff(numbers) != 0))
        numbers, stamps = numbers[new], stamps[new]
    return [(at_ns, seq) for at_ns, seq in zip(stamps.tolist(), numbers.tolist(), strict=True) if seq > 0]


def reached_at(log: Log) -> list[tuple[int, int]]:
    """(stamp, number) of each waypoint that the autopilot reported as reached, each once, in order of time."""
    found = [
        (text.at_ns, int(match.group(1)))
        for text in signals.texts(log)
        if (match := _REACHED.match(text.text)) and len(match.group(1)) < 6
    ]
    table = autopilot_messages(log, "MISSION_ITEM_REACHED")
    if table is not None and "seq" in table.columns:
        found += list(zip(table.stamp_ns.tolist(), table.values("seq", raw=True).tolist(), strict=True))
    once: list[tuple[int, int]] = []
    for at_ns, seq in sorted(found):
        if not any(other == seq and at_ns - when <= _REPEATED_NS for when, other in once[-3:]):
            once.append((at_ns, seq))
    return once


def _last_item(log: Log) -> int:
    """Number of the last item by MISSION_CURRENT, for logs without the items themselves; 0 if unknown."""
    table = autopilot_messages(log, "MISSION_CURRENT")
    if table is None or "total" not in table.columns:
        return 0
    total = int(table.values("total", raw=True)[-1])
    return total if 0 < total < 65_535 else 0


def _legs(
    log: Log, taken_up: list[tuple[int, int]], reached: list[tuple[int, int]], modes: list[ModeSpan], clock: LogClock
) -> list[MissionLeg]:
    """Legs from each started item until it was reached, the next item started, or the mode changed."""
    if not taken_up and reached:
        starts = [(span.from_ns, reached[0][1]) for span in modes if span.name == _AUTO][:1]
        taken_up = starts + [(at_ns, seq) for (at_ns, _), (_, seq) in itertools.pairwise(reached)]
    # Item 1 can be current long before the vessel moves: a leg begins in AUTO.
    auto = [(span.from_ns, span.until_ns) for span in modes if span.name == _AUTO]
    armed = [(span.from_ns, span.until_ns) for span in signals.armed(log)]
    legs: list[MissionLeg] = []
    for place, (at_ns, seq) in enumerate(taken_up[:_MOST_LEGS]):
        next_ns = taken_up[place + 1][0] if place + 1 < len(taken_up) else clock.end_ns
        window = next(((begin, end) for begin, end in auto if begin < next_ns and end > at_ns), None)
        if modes and window is None:
            continue
        from_ns = at_ns if window is None else max(at_ns, window[0])
        begun = [begin for begin, end in armed if begin < next_ns and end > from_ns]
        from_ns = max(from_ns, min(begun)) if begun else from_ns
        last = legs[-1] if legs else None
        if last is not None and last.reached and last.seq < seq and 0 <= from_ns - last.until_ns <= _HEARD_LATE_NS:
            from_ns = last.until_ns
        # In real time, the text is logged just after the next item.
        latest_ns = next_ns + _HEARD_LATE_NS
        there = next(
            (min(when, next_ns) for when, which in reached if which == seq and from_ns <= when <= latest_ns), None
        )
        ends = [next_ns] if window is None else [next_ns, window[1]]
        ends += [end for begin, end in armed if begin <= from_ns < end]
        legs.append(MissionLeg(seq, from_ns, min(ends) if there is None else there, there is not None))
    return legs


def _plan_in_force(loaded: list[MissionVersion], legs: list[MissionLeg]) -> MissionVersion | None:
    """The last mission loaded before the end of its first leg, else the last mission."""
    if not loaded:
        return None
    if not legs:
        return loaded[-1]
    before = [version for version in loaded if version.at_ns <= legs[-1].from_ns]
    return before[-1] if before else loaded[0]


def _leg_table(
    plan: MissionVersion | None, legs: list[MissionLeg], sailed: list[LegTrack], clock: LogClock
) -> Grid | None:
    if not legs:
        return None
    items = {} if plan is None else plan.items
    rows = []
    for leg, one in zip(legs, sailed, strict=True):
        length_of_leg_s = (leg.until_ns - leg.from_ns) * 1e-9
        speed = None if one.way_m is None or length_of_leg_s <= 0.0 else one.way_m / length_of_leg_s
        rows.append(
            (
                leg.seq,
                command_name(items[leg.seq].command) if leg.seq in items else None,
                clock.second(leg.from_ns),
                clock.second(leg.until_ns) if leg.reached else None,
                rounded(length_of_leg_s, 1),
                rounded(one.length_m, 1),
                rounded(one.way_m, 1),
                rounded(speed, 2),
                rounded(one.cross_rms_m, 2),
                rounded(one.cross_max_m, 2),
            )
        )
    columns = ("item", "command", "begun (s)", "reached (s)", "took (s)", "leg (m)", "way (m)", "mean speed (m/s)",
               "cross track RMS (m)", "cross track max (m)")  # fmt: skip
    return Grid.limited("legs", "Legs", columns, rows)


def _plan_table(plan: MissionVersion | None) -> Grid | None:
    if plan is None:
        return None
    rows = [
        (
            item.seq,
            "HOME" if item.seq == 0 else command_name(item.command),
            rounded(item.latitude_deg, 7),
            rounded(item.longitude_deg, 7),
            rounded(item.altitude_m, 2),
            ALTITUDE_FRAMES.get(item.frame, f"frame {item.frame}"),
        )
        for _, item in sorted(plan.items.items())
    ]
    return Grid.limited(
        "mission", "Mission", ("item", "command", "latitude", "longitude", "altitude (m)", "frame"), rows
    )


def _unfinished(
    log: Log,
    legs: list[MissionLeg],
    complete: bool,
    done: int,
    wanted: int | None,
    modes: list[ModeSpan],
    clock: LogClock,
) -> Iterator[Finding]:
    if not legs or complete:
        return
    last = legs[-1]
    auto = [span for span in modes if span.name == _AUTO]
    armed = signals.armed(log)
    left = next((span for span in modes if auto and span.from_ns == auto[-1].until_ns), None)
    disarmed = next((span for span in armed if last.from_ns <= span.until_ns < clock.end_ns), None)
    key, severity, at_ns = "missions.unfinished", Severity.WARNING, last.until_ns
    if disarmed is not None and (left is None or disarmed.until_ns <= left.from_ns):
        at_ns = disarmed.until_ns
        method = disarming_method(log, at_ns)
        by = "" if method is None else f" ({arming_method_name(method)})"
        why = f"it was disarmed at {clock.text(at_ns)}{by}"
        severity = Severity.NOTICE if method in OPERATOR_ARMING_METHODS else severity
    elif left is not None:
        at_ns = left.from_ns
        why = f"the mode became {left.name} at {clock.text(left.from_ns)}" + (f" ({left.cause})" if left.cause else "")
        severity = Severity.NOTICE if left.reason in OPERATOR_REASONS else severity
    else:
        key, severity, at_ns = "missions.log_ended", Severity.NOTICE, clock.end_ns
        why = f"the log ends at {clock.text(clock.end_ns)}, under way to item {last.seq}"
    of = "" if wanted is None else f" of {wanted}"
    yield Finding(
        key,
        severity,
        f"The mission was not completed: {done}{of} waypoints reached; {why}",
        (Evidence("MISE" if "MISE" in log.tables else "MISSION_CURRENT", None, at_ns),),
        "Use a log that continues to the end of the mission."
        if key == "missions.log_ended"
        else "Look at modes, arming and events at that time.",
    )


def _changed(log: Log, loaded: list[MissionVersion], legs: list[MissionLeg], clock: LogClock) -> Iterator[Finding]:
    if not legs:
        return
    during = [version for version in loaded[1:] if legs[0].from_ns < version.at_ns < legs[-1].until_ns]
    if not during:
        return
    after_s = length_text((during[0].at_ns - legs[0].from_ns) * 1e-9)
    yield Finding.notice(
        "missions.changed",
        f"The mission was changed {len(during)} times while it was carried out, first {after_s} after it began",
        tuple(Evidence("CMD", None, version.at_ns, value=f"{len(version.items)} items") for version in during[:20]),
        f"Legs and cross track here are of the mission that was active at {clock.text(legs[-1].from_ns)}.",
    )
