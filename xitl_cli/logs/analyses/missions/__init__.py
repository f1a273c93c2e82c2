"""The mission: what was loaded, what was sailed, how close to its lines, and whether it was completed."""

from __future__ import annotations

import itertools
import re

import numpy as np

from xitl_cli.logs import signals
from xitl_cli.logs.analyses.instants import Instants, grid, number
from xitl_cli.logs.analyses.missions.items import Version, executed, versions
from xitl_cli.logs.analyses.missions.track import Leg, Sailed, largest_m, length_m, overall_rms_m, sailed_legs
from xitl_cli.logs.analyses.modes import ModeSpan, mode_spans
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Section, Severity
from xitl_cli.logs.text import length_text
from xitl_cli.logs.words.heard import heard
from xitl_cli.logs.words.missions import FRAMES, command_name

_REACHED = re.compile(r"^Reached (?:waypoint|command) #?(\d+)", re.I)
_COMPLETE = re.compile(r"^Mission complete\b", re.I)
_COMPLETE_STATE = 5  # MISSION_STATE_COMPLETE
_AUTO = "AUTO"
_MOST_LEGS = 2000
_REPEATED_NS = 5_000_000_000
_HEARD_LATE_NS = 1_500_000_000  # MISSION_CURRENT comes once a second


def analyse(log: Log) -> Section | None:
    loaded, taken_up, reached = versions(log), executed(log), reached_at(log)
    if not loaded and not taken_up and not reached:
        return None
    instants, modes = Instants(log), mode_spans(log)
    legs = _legs(log, taken_up, reached, modes, instants)
    complete_ns = _complete_ns(log)
    plan = _plan_in_force(loaded, legs)
    sailed = sailed_legs(log, plan, legs)
    wanted = len(plan.places) if plan else _last_item(log) or None
    done = len({leg.seq for leg in legs if leg.reached})
    last = max((item.seq for item in plan.places), default=0) if plan else _last_item(log)
    complete = complete_ns is not None or (bool(last) and any(leg.reached and leg.seq == last for leg in legs))
    lacks = []
    if legs and not reached:
        lacks.append("When waypoints were reached is not logged; only that the next one was taken up.")
    if not legs and any(span.name == _AUTO for span in modes):
        lacks.append("Which items of the mission were carried out is not logged: no MISE, no MISSION_CURRENT.")
    facts = (
        Fact("waypoints", "Waypoints", wanted),
        Fact("waypoints_reached", "Waypoints reached", done if legs else None),
        Fact("mission_completed", "Completed", complete if legs or complete_ns is not None else None),
        Fact("mission_length_m", "Length", None if plan is None else number(length_m(plan), 1), "m"),
        Fact("mission_time_s", "Time", number((legs[-1].until_ns - legs[0].from_ns) * 1e-9, 1) if legs else None, "s"),
        Fact("cross_track_rms_m", "Cross track, RMS", overall_rms_m(legs, sailed), "m"),
        Fact("cross_track_max_m", "Cross track, largest", largest_m(sailed), "m"),
    )
    findings = [
        *_unfinished(log, legs, complete, done, wanted, modes, instants),
        *_changed(log, loaded, legs, instants),
    ]
    grids = [found for found in (_leg_table(plan, legs, sailed, instants), _plan_table(plan)) if found is not None]
    known = tuple(fact for fact in facts if fact.value is not None)
    return Section("missions", "Mission", known, tuple(findings), tuple(grids), (), tuple(lacks))


def reached_at(log: Log) -> list[tuple[int, int]]:
    """(stamp, number) of each waypoint that the autopilot said it reached, each once, in the order of time."""
    found = [
        (text.at_ns, int(match.group(1)))
        for text in signals.texts(log)
        if (match := _REACHED.match(text.text)) and len(match.group(1)) < 6
    ]
    table = heard(log, "MISSION_ITEM_REACHED")
    if table is not None and "seq" in table.columns:
        found += list(zip(table.stamp_ns.tolist(), table.values("seq", raw=True).tolist(), strict=True))
    once: list[tuple[int, int]] = []
    for at_ns, seq in sorted(found):
        if not any(other == seq and at_ns - when <= _REPEATED_NS for when, other in once[-3:]):
            once.append((at_ns, seq))
    return once


def _complete_ns(log: Log) -> int | None:
    said = [text.at_ns for text in signals.texts(log) if _COMPLETE.match(text.text)]
    table = heard(log, "MISSION_CURRENT")
    if table is not None and "mission_state" in table.columns:
        said += table.stamp_ns[np.asarray(table.values("mission_state", raw=True)) == _COMPLETE_STATE].tolist()
    return min(said, default=None)


def _last_item(log: Log) -> int:
    """As MISSION_CURRENT says, where the items themselves were not heard; 0 when it does not."""
    table = heard(log, "MISSION_CURRENT")
    if table is None or "total" not in table.columns:
        return 0
    total = int(table.values("total", raw=True)[-1])
    return total if 0 < total < 65_535 else 0


def _legs(
    log: Log,
    taken_up: list[tuple[int, int]],
    reached: list[tuple[int, int]],
    modes: list[ModeSpan],
    instants: Instants,
) -> list[Leg]:
    """From each item taken up to where it was reached, the next one was, or the mode was left."""
    if not taken_up and reached:
        starts = [(span.from_ns, reached[0][1]) for span in modes if span.name == _AUTO][:1]
        taken_up = starts + [(at_ns, seq) for (at_ns, _), (_, seq) in itertools.pairwise(reached)]
    # Item 1 can be current long before anything is sailed: a leg begins in AUTO.
    auto = [(span.from_ns, span.until_ns) for span in modes if span.name == _AUTO]
    armed = [(span.from_ns, span.until_ns) for span in signals.armed(log)]
    legs: list[Leg] = []
    for place, (at_ns, seq) in enumerate(taken_up[:_MOST_LEGS]):
        next_ns = taken_up[place + 1][0] if place + 1 < len(taken_up) else instants.end_ns
        window = next(((begin, end) for begin, end in auto if begin < next_ns and end > at_ns), None)
        if modes and window is None:
            continue
        from_ns = at_ns if window is None else max(at_ns, window[0])
        begun = [begin for begin, end in armed if begin < next_ns and end > from_ns]
        from_ns = max(from_ns, min(begun)) if begun else from_ns
        last = legs[-1] if legs else None
        if last is not None and last.reached and last.seq < seq and 0 <= from_ns - last.until_ns <= _HEARD_LATE_NS:
            from_ns = last.until_ns
        # In real time the sentence is logged just after the next item.
        latest_ns = next_ns + _HEARD_LATE_NS
        there = next(
            (min(when, next_ns) for when, which in reached if which == seq and from_ns <= when <= latest_ns), None
        )
        ends = [next_ns] if window is None else [next_ns, window[1]]
        ends += [end for begin, end in armed if begin <= from_ns < end]
        legs.append(Leg(seq, from_ns, min(ends) if there is None else there, there is not None))
    return legs


def _plan_in_force(loaded: list[Version], legs: list[Leg]) -> Version | None:
    """The last mission loaded before its first leg was over, else the last one."""
    if not loaded:
        return None
    if not legs:
        return loaded[-1]
    before = [version for version in loaded if version.at_ns <= legs[-1].from_ns]
    return before[-1] if before else loaded[0]


def _leg_table(plan: Version | None, legs: list[Leg], sailed: list[Sailed], instants: Instants) -> Grid | None:
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
                instants.second(leg.from_ns),
                instants.second(leg.until_ns) if leg.reached else None,
                number(length_of_leg_s, 1),
                number(one.length_m, 1),
                number(one.way_m, 1),
                number(speed, 2),
                number(one.cross_rms_m, 2),
                number(one.cross_max_m, 2),
            )
        )
    columns = ("item", "command", "begun (s)", "reached (s)", "took (s)", "leg (m)", "way (m)", "mean speed (m/s)",
               "cross track RMS (m)", "cross track max (m)")  # fmt: skip
    return grid("legs", "Legs", columns, rows)


def _plan_table(plan: Version | None) -> Grid | None:
    if plan is None:
        return None
    rows = [
        (
            item.seq,
            "HOME" if item.seq == 0 else command_name(item.command),
            number(item.latitude_deg, 7),
            number(item.longitude_deg, 7),
            number(item.altitude_m, 2),
            FRAMES.get(item.frame, f"frame {item.frame}"),
        )
        for _, item in sorted(plan.items.items())
    ]
    return grid("mission", "Mission", ("item", "command", "latitude", "longitude", "altitude (m)", "frame"), rows)


def _unfinished(
    log: Log,
    legs: list[Leg],
    complete: bool,
    done: int,
    wanted: int | None,
    modes: list[ModeSpan],
    instants: Instants,
) -> list[Finding]:
    if not legs or complete:
        return []
    last = legs[-1]
    auto = [span for span in modes if span.name == _AUTO]
    armed = signals.armed(log)
    left = next((span for span in modes if auto and span.from_ns == auto[-1].until_ns), None)
    disarmed = next((span for span in armed if last.from_ns <= span.until_ns < instants.end_ns), None)
    severity = Severity.WARNING
    if disarmed is not None and (left is None or disarmed.until_ns <= left.from_ns):
        why = f"it was disarmed at {instants.text(disarmed.until_ns)}"
    elif left is not None:
        why = f"the mode became {left.name} at {instants.text(left.from_ns)}" + (
            f" ({left.cause})" if left.cause else ""
        )
    else:
        severity = Severity.NOTICE
        why = f"the log ends at {instants.text(instants.end_ns)}, under way to item {last.seq}"
    of = "" if wanted is None else f" of {wanted}"
    return [
        Finding(
            "missions.unfinished",
            severity,
            f"The mission was not completed: {done}{of} waypoints reached; {why}",
            (Evidence("MISE" if "MISE" in log.tables else "MISSION_CURRENT", None, last.from_ns, last.until_ns),),
            "Look at modes, arming and events at that instant.",
        )
    ]


def _changed(log: Log, loaded: list[Version], legs: list[Leg], instants: Instants) -> list[Finding]:
    if not legs:
        return []
    during = [version for version in loaded[1:] if legs[0].from_ns < version.at_ns < legs[-1].until_ns]
    if not during:
        return []
    after_s = length_text((during[0].at_ns - legs[0].from_ns) * 1e-9)
    return [
        Finding(
            "missions.changed",
            Severity.NOTICE,
            f"The mission was changed {len(during)} times while it was carried out, first {after_s} after it began",
            tuple(Evidence("CMD", None, version.at_ns, value=f"{len(version.items)} items") for version in during[:20]),
            f"Legs and cross track here are of the mission in force at {instants.text(legs[-1].from_ns)}.",
        )
    ]
