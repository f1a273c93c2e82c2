"""Control: setpoints against the vehicle's response, and losses of control.

Rover logs its setpoints in NTUN, THR and STER, Copter and Plane in ATT and RATE. Recordings of xitl contain the heading
and the error of speed that the autopilot reports over MAVLink. A setpoint that is always 0 is ignored.

Response to a setpoint: its delay, and rise, overshoot and settling after each step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

import xitl_cli.logs.signals as signals
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import HEADING_HELD, VehicleKind
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace
from xitl_cli.logs.model.table import Flags, Floats, Stamps
from xitl_cli.logs.model.text import plural
from xitl_cli.logs.signals.series import column_series, first_instance, numbers, significant
from xitl_cli.logs.signals.spans import inside, length_s, spans_where
from xitl_cli.logs.signals.states import armed_rows, vehicle_kind
from xitl_cli.plugins.logs.analyses.attitude import free_attitude_spans

LONGEST_PAUSE_S = 2.0  # between rows: values in a longer pause are unknown
LONGEST_DELAY_S = 10.0
_FINER = 0.8  # share of the error without a shift, required for a delay
_SHIFT_S, _MOST_ROWS = 0.05, 20_000
_STEP_WITHIN_S, _BEGINS_SHARE = 1.0, 0.1
_HOLD_S, _HOLD_SHARE = 4.0, 0.15
_SETTLED_SHARE = 0.1
_ANSWER_S = 20.0  # after a step; later changes are effects of water and wind
_LEAST_ROWS = 20


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Response to a step of the setpoint from `begin` to `end`, held until until_ns. All figures are within twenty
    seconds."""

    at_ns: int
    until_ns: int
    begin: float
    end: float
    rise_s: float | None
    """From 10 to 90 % of the step; None if it was not reached."""
    overshoot_percent: float
    """Of the step, beyond its end."""
    settled_s: float | None
    """From the step until the response stayed within a tenth of it; None if it did not."""


def response_delay_s(stamp_ns: Stamps, demanded: Floats, achieved: Floats, least: float) -> float | None:
    """Delay at which the response is nearest to the setpoint, by least squares.

    demanded, achieved: (N,) without turns. least: least change of the setpoint that allows a result. None also if no
    shift brings the two clearly nearer to each other.
    """
    parts = [part for part in unbroken(stamp_ns) if part.stop - part.start >= _LEAST_ROWS]
    if not parts or max(float(np.std(demanded[part])) for part in parts) < least:
        return None
    shifts_s = np.arange(0.0, LONGEST_DELAY_S, _SHIFT_S)
    errors = np.array([_apart(stamp_ns, demanded, achieved, parts, shift_s) for shift_s in shifts_s])
    best = int(np.nanargmin(errors))
    if best == len(errors) - 1 or errors[0] == 0.0:
        return None if best else 0.0
    if best == 0:
        return 0.0
    if errors[best] > _FINER**2 * errors[0]:
        return None
    before, there, after = errors[best - 1 : best + 2]
    curve = before - 2.0 * there + after
    between = 0.5 * (before - after) / curve if curve > 0.0 else 0.0
    return float(shifts_s[best] + between * (shifts_s[1] - shifts_s[0]))


def _apart(stamp_ns: Stamps, demanded: Floats, achieved: Floats, parts: Sequence[slice], shift_s: float) -> float:
    """Mean square difference, over the rows that every shift has, so that all shifts use the same rows."""
    squares: list[Floats] = []
    for part in parts:
        seconds = (stamp_ns[part] - stamp_ns[part.start]) * 1e-9
        reach_s = min(LONGEST_DELAY_S, 0.25 * seconds[-1])
        kept = seconds <= seconds[-1] - reach_s
        some = np.flatnonzero(kept)[:: max(1, len(stamp_ns) // _MOST_ROWS)]
        later = np.interp(seconds[some] + min(shift_s, reach_s), seconds, achieved[part])
        squares.append((later - demanded[part][some]) ** 2)
    return float(np.mean(np.concatenate(squares)))


def step_responses(stamp_ns: Stamps, demanded: Floats, achieved: Floats, least: float) -> list[StepResponse]:
    """Responses to steps of at least `least`: a change within a second to a value that is then held for at least four.

    demanded, achieved: (N,) without turns. A step is from the vessel's value to the setpoint at its end.
    """
    return [found for part in unbroken(stamp_ns) for found in _responses(stamp_ns, demanded, achieved, part, least)]


def _responses(
    stamp_ns: Stamps, demanded: Floats, achieved: Floats, part: slice, least: float
) -> Iterator[StepResponse]:
    seconds = (stamp_ns[part] - stamp_ns[part.start]) * 1e-9
    wanted, there = demanded[part], achieved[part]
    done = 0
    for at in np.flatnonzero(np.abs(np.diff(wanted)) >= _BEGINS_SHARE * least).tolist():
        after = int(np.searchsorted(seconds, seconds[at] + _STEP_WITHIN_S, "right")) - 1
        change = np.abs(wanted[at + 1 : after + 1] - wanted[at])
        if at < done or not len(change) or change.max() < least:
            continue
        settled_at = at + 1 + int(np.argmax(change))
        step = wanted[settled_at] - wanted[at]
        moved = np.flatnonzero(np.abs(wanted[settled_at:] - wanted[settled_at]) > _HOLD_SHARE * abs(step))
        end = settled_at + int(moved[0]) if len(moved) else len(seconds)
        if seconds[end - 1] - seconds[settled_at] < _HOLD_S:
            continue
        found = _answered(stamp_ns[part][at:end], wanted[at:end], there[at:end], settled_at - at, least)
        if found is not None:
            yield found
        done = end - 1


def _answered(
    stamp_ns: Stamps, wanted: Floats, there: Floats, reached: int, least: float
) -> StepResponse | None:  # fmt: skip
    """Response to one step.

    reached: the row from which the setpoint is held. If the setpoint then drifts, the response is relative to it.
    """
    final, begin = float(wanted[reached]), float(there[0])
    if abs(final - begin) < least:
        return None
    seconds = (stamp_ns - stamp_ns[0]) * 1e-9
    held = np.where(np.arange(len(wanted)) < reached, final, wanted)
    way = 1.0 + (there - held) / (final - begin)
    first = seconds <= _ANSWER_S
    rise_s = None
    if (way[first] >= 0.9).any():
        rise_s = _crossing(seconds, way, 0.9) - _crossing(seconds, way, 0.1)
    outside = np.flatnonzero(np.abs(way[first] - 1.0) > _SETTLED_SHARE)
    settled = len(outside) == 0 or outside[-1] < first.sum() - 1
    settled_s = float(seconds[outside[-1] + 1]) if settled and len(outside) else None
    overshoot = 100.0 * max(float(way[first].max()) - 1.0, 0.0)
    return StepResponse(int(stamp_ns[0]), int(stamp_ns[-1]), begin, final, rise_s, overshoot, settled_s)


def _crossing(seconds: Floats, way: Floats, level: float) -> float:
    """First time (s) at which `way` reached the level, interpolated between rows."""
    row = int(np.flatnonzero(way >= level)[0])
    if row == 0:
        return float(seconds[0])
    share = (level - way[row - 1]) / (way[row] - way[row - 1])
    return float(seconds[row - 1] + share * (seconds[row] - seconds[row - 1]))


def unbroken(stamp_ns: Stamps) -> list[slice]:
    """Parts of the rows without a pause."""
    breaks = np.flatnonzero(np.diff(stamp_ns) > LONGEST_PAUSE_S * 1e9) + 1
    ends = [0, *breaks.tolist(), len(stamp_ns)]
    return [slice(first, after) for first, after in pairwise(ends) if after > first]


_TITLE = "Control"
_MOST_EVIDENCE = 8
_JOIN_S = 0.5
_FEWEST_ROWS = 10


@dataclass(frozen=True, slots=True)
class Tracking:
    """Setpoint and response (N,) in `unit`, in rows with an active setpoint. error: achieved minus demanded."""

    key: str
    label: str
    unit: str
    stamp_ns: Stamps
    demanded: Floats
    achieved: Floats
    message: str
    """Message of the setpoint."""
    field: str
    """Field of the setpoint."""
    turns: bool = False
    """An angle of 360 degrees."""

    @property
    def error(self) -> Floats:
        apart = self.achieved - self.demanded
        return np.mod(apart + 180.0, 360.0) - 180.0 if self.turns else apart


@dataclass(frozen=True, slots=True)
class TrackingLimit:
    """Limit of an error: over `least` and over `share` of the setpoint, for `lasting_s` at a time, it has
    `severity`."""

    least: float
    share: float
    lasting_s: float
    severity: Severity = Severity.WARNING
    moved: float = 0.0
    """Least response in that time: a pilot also moves the sticks on the ground, where nothing follows."""


# A boat turns by half a circle in 10 to 15 s and gathers way in 10 s. ArduCopter's crash check treats 30 deg for two
# seconds as lost control.
_HEADING = TrackingLimit(30.0, 0.0, 15.0)
_SLOW = TrackingLimit(0.5, 0.3, 15.0)
_FAST = TrackingLimit(0.75, 0.5, 10.0)
_TURN_RATE = TrackingLimit(20.0, 0.5, 3.0)
_ATTITUDE = TrackingLimit(30.0, 0.0, 2.0, Severity.CRITICAL, moved=30.0)
_RATE = TrackingLimit(60.0, 1.0, 1.0, moved=60.0)


def analyse(log: Log) -> Section | None:
    """Section on control; None for a recording without setpoints."""
    clock, kind = LogClock(log), vehicle_kind(log)
    found = [each for each in _trackings(log, kind) if len(each.stamp_ns) >= _FEWEST_ROWS]
    if not found:
        if log.format != "dataflash":
            return None
        lack = "What was demanded is not logged: no NTUN, THR or STER of Rover, no desired attitude (ATT), no RATE."
        return Section("control", _TITLE, lacks=(lack,))
    findings = _as_one([finding for each in found for finding in _judged(each, clock)])
    if not findings and clock.armed:
        findings = [Finding.ok("control.followed", f"It followed what was demanded: {_named(found)}")]
    answers: list[Fact] = []
    for each in found:
        label = each.label.capitalize()
        delay_s = response_delay_s(each.stamp_ns, *_unturned(each), _VARIES[each.unit])
        if delay_s is not None:
            answers.append(
                Fact(f"{each.key}_delay_s", f"{label}, delay behind the demand", significant(delay_s, 3), "s")
            )
        steps = step_responses(each.stamp_ns, *_unturned(each), _STEPS[each.unit])
        if steps:
            largest = max(step.overshoot_percent for step in steps)
            title = f"{label}, largest overshoot of {plural(len(steps), 'step')}"
            answers.append(Fact(f"{each.key}_overshoot_percent", title, significant(largest, 3), "%"))
    facts, grids = (*_facts(found), *answers), tuple(_steps(found, clock))
    # Setpoints that a rover did not get, or did not log.
    lacks: list[str] = []
    if kind in ("rover", "unknown"):
        there = {each.key for each in found}
        if "turn_rate" not in there:
            lacks.append(
                "No demanded turn rate is logged (STER.DesTurnRate), so that it cannot be held against the one "
                "achieved."
            )
        if "heading" not in there and log.format == "dataflash":
            lacks.append("No heading was demanded (NTUN.DesYaw and ATT.DesYaw are 0): it was steered by turn rate.")
        if "speed" not in there:
            lacks.append(
                "No demanded speed is logged (THR.DesSpeed), so that it cannot be held against the one achieved."
            )
    return Section("control", _TITLE, facts, tuple(findings), grids, tuple(_plots(found)), tuple(lacks))


def _as_one(findings: Sequence[Finding]) -> list[Finding]:
    """Join findings: roll and pitch that were lost together are one loss."""
    by_key: dict[str, Finding] = {}
    for finding in findings:
        before = by_key.setdefault(finding.key, finding)
        if before is not finding:
            by_key[finding.key] = replace(before, evidence=(*before.evidence, *finding.evidence))
    return list(by_key.values())


def _trackings(log: Log, kind: VehicleKind) -> Iterator[Tracking]:
    readers = (_heading, _speed, _turn_rate) if kind in ("rover", "unknown") else (_roll, _pitch, _rates)
    for read in readers:
        yield from read(log, kind)


def _armed(log: Log, stamp_ns: Stamps) -> Flags:
    armed = armed_rows(log, stamp_ns)
    return np.ones(len(stamp_ns), dtype=np.bool_) if armed is None else armed


def _heading(log: Log, kind: VehicleKind) -> Iterator[Tracking]:
    """Heading of a vessel under way in a mode that holds a heading. Going backwards, it points the other way."""
    demand, yaw = signals.yaw_desired(log), signals.yaw(log)
    if demand is None or yaw is None:
        return
    own = column_series(log, "NTUN", "Yaw", "deg", turns=True)
    if demand.source.startswith("NTUN") and own is not None:
        yaw = own
    # (N,) True in these modes; True throughout if modes are not logged.
    modes = signals.modes(log)
    in_modes = (
        np.ones(len(demand.stamp_ns), dtype=np.bool_)
        if not modes
        else inside(demand.stamp_ns, [(span.from_ns, span.until_ns) for span in modes if span.text in HEADING_HELD])
    )
    rows = _armed(log, demand.stamp_ns) & in_modes
    rows &= _under_way(log, demand.stamp_ns)
    there = yaw.interpolated(demand.stamp_ns)
    rows &= np.isfinite(there)
    message, _, field = demand.source.partition(".")
    yield Tracking(
        "heading", "heading", "deg", demand.stamp_ns[rows], demand.values[rows], there[rows], message, field, turns=True
    )


_UNDER_WAY_MPS = 0.2


def _under_way(log: Log, stamp_ns: Stamps) -> Flags:
    """(N,) True if the setpoint of the speed is ahead, or is not logged: a vessel at rest does not steer."""
    speed = column_series(log, "THR", "DesSpeed", "m/s")
    if speed is None or not (speed.values >= _UNDER_WAY_MPS).any():
        return np.ones(len(stamp_ns), dtype=np.bool_)
    ahead: Flags = ~(speed.interpolated(stamp_ns) < _UNDER_WAY_MPS)
    return ahead


def _columns(
    log: Log, key: str, label: str, unit: str, message: str, demanded: str, achieved: str, *, turns: bool = False
) -> Iterator[Tracking]:
    """Tracking of two columns of a message while armed, if any setpoint is not 0."""
    table = first_instance(log, message)
    wanted = None if table is None else numbers(table, demanded)
    there = None if table is None else numbers(table, achieved)
    if table is None or wanted is None or there is None or wanted.ndim != 1 or not np.nan_to_num(wanted).any():
        return
    rows = _armed(log, table.stamp_ns) & np.isfinite(wanted) & np.isfinite(there)
    yield Tracking(key, label, unit, table.stamp_ns[rows], wanted[rows], there[rows], message, demanded, turns)


def _rows(each: Tracking, chosen: Flags) -> Tracking:
    return replace(each, stamp_ns=each.stamp_ns[chosen], demanded=each.demanded[chosen], achieved=each.achieved[chosen])


def _speed(log: Log, kind: VehicleKind) -> Iterator[Tracking]:
    """Speed with a setpoint. 0 in a mode without a setpoint is ignored."""
    logged = [*_columns(log, "speed", "speed", "m/s", "THR", "DesSpeed", "Speed")]
    for each in logged or _told_speed(log):
        asked = _rows(each, np.abs(each.demanded) >= _UNDER_WAY_MPS)
        sign = np.sign(asked.demanded)  # backwards counts as ahead
        yield replace(asked, demanded=sign * asked.demanded, achieved=sign * asked.achieved)


_NAVIGATION = "NAV_CONTROLLER_OUTPUT"


def _told_speed(log: Log) -> Iterator[Tracking]:
    """Speed from MAVLink, which has only the error, demanded minus achieved; ArduRover leaves it at 0."""
    achieved = signals.ground_speed(log)
    for message in (_NAVIGATION, f"/link/agent/rx:{_NAVIGATION}"):
        error = column_series(log, message, "aspd_error", "m/s")
        if achieved is None or error is None or not error.values.any():
            continue
        there = achieved.interpolated(error.stamp_ns)
        rows = _armed(log, error.stamp_ns) & (error.values != 0.0) & np.isfinite(there)
        stamps, there = error.stamp_ns[rows], there[rows]
        yield Tracking("speed", "speed", "m/s", stamps, there + error.values[rows], there, message, "aspd_error")
        return


def _turn_rate(log: Log, kind: VehicleKind) -> Iterator[Tracking]:
    for each in _columns(log, "turn_rate", "turn rate", "deg/s", "STER", "DesTurnRate", "TurnRate"):
        yield _rows(each, _under_way(log, each.stamp_ns))


def _roll(log: Log, kind: VehicleKind) -> Iterator[Tracking]:
    yield from _steered(log, "roll", "DesRoll", "Roll")


def _pitch(log: Log, kind: VehicleKind) -> Iterator[Tracking]:
    yield from _steered(log, "pitch", "DesPitch", "Pitch")


def _steered(log: Log, name: str, demanded: str, achieved: str) -> Iterator[Tracking]:
    """Attitude or rate, without modes that have no attitude setpoint."""
    for each in _columns(log, name, name, "deg", "ATT", demanded, achieved, turns=True):
        yield _rows(each, ~inside(each.stamp_ns, free_attitude_spans(log)))


def _rates(log: Log, kind: VehicleKind) -> Iterator[Tracking]:
    for key, label, demanded, achieved in (
        ("roll_rate", "roll rate", "RDes", "R"),
        ("pitch_rate", "pitch rate", "PDes", "P"),
        ("yaw_rate", "yaw rate", "YDes", "Y"),
    ):
        table = log.tables.get("RATE")  # hundredths of a degree in old logs, without a unit
        if table is not None and achieved in table.columns and table.columns[achieved].unit == "deg/s":
            yield from _columns(log, key, label, "deg/s", "RATE", demanded, achieved)


def _judged(each: Tracking, clock: LogClock) -> Iterator[Finding]:
    """One finding for all spans with too large an error for too long."""
    error = each.error
    if each.key == "heading":
        yield from _off(
            each, np.abs(error), _HEADING, "heading_off", "was off the heading demanded", _HEADING_STEP, clock
        )
    elif each.key == "speed":
        yield from _off(each, -error, _SLOW, "too_slow", "stayed under the speed demanded", _SLOW_STEP, clock)
        yield from _off(each, error, _FAST, "too_fast", "went faster than demanded", _FAST_STEP, clock)
    elif each.key == "turn_rate":
        doing = "did not turn as demanded"
        yield from _off(each, np.abs(error), _TURN_RATE, "turn_rate_off", doing, _TURN_STEP, clock)
    elif each.key in ("roll", "pitch"):
        doing = f"lost control: its {each.label} was off the one demanded"
        yield from _off(each, np.abs(error), _ATTITUDE, "attitude_lost", doing, _LOST_STEP, clock)
    else:
        doing = f"did not follow its {each.label} demanded"
        yield from _off(each, np.abs(error), _RATE, "rate_lost", doing, _LOST_STEP, clock)


_HEADING_STEP = (
    "Look at steering and thrusters then (outputs), at current and wind, and at the compass; a vessel too slow to "
    "steer does the same."
)
_SLOW_STEP = "Look at throttle (outputs), battery, hull and propellers, and at current and wind."
_FAST_STEP = "Look at current and wind from behind, at CRUISE_THROTTLE and the gains of the speed loop (ATC_SPEED_…)."
_TURN_STEP = "Look at steering outputs and their range, and at the gains of the turn rate (ATC_STR_RAT_…)."
_LOST_STEP = "Look at motors and propellers (outputs at their ends), vibration and battery just before."


def _off(
    each: Tracking, error: Floats, limit: TrackingLimit, key: str, doing: str, step: str, clock: LogClock
) -> Iterator[Finding]:
    least = np.maximum(limit.least, limit.share * np.abs(each.demanded))
    wide = spans_where(each.stamp_ns, error > least, _JOIN_S)
    spans = [span for span in _unbroken(each.stamp_ns, wide) if (span[1] - span[0]) * 1e-9 >= limit.lasting_s]
    spans = [span for span in spans if np.abs(each.achieved[inside(each.stamp_ns, [span])]).max() >= limit.moved]
    if not spans:
        return
    begin, end = max(spans, key=lambda span: span[1] - span[0])
    rows = np.flatnonzero((each.stamp_ns >= begin) & (each.stamp_ns <= end))
    worst = int(rows[np.argmax(error[rows])])
    again = "" if len(spans) == 1 else f" ({len(spans)} times, {length_s(spans):.0f} s in all)"
    figures = (
        f"{each.achieved[worst]:.3g} {each.unit} for {each.demanded[worst]:.3g} {each.unit} at "
        f"{clock.text(int(each.stamp_ns[worst]))}"
    )
    yield Finding(
        f"control.{key}",
        limit.severity,
        f"It {doing} by up to {error[worst]:.3g} {each.unit}, for {(end - begin) * 1e-9:.1f} s from "
        f"{clock.text(begin)}{again}: {figures}",
        tuple(
            Evidence(each.message, each.field, from_ns, until_ns, f"{error[worst]:.3g} {each.unit}")
            for from_ns, until_ns in spans[:_MOST_EVIDENCE]
        ),
        step,
    )


def _unbroken(stamp_ns: Stamps, spans: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Spans split at missing rows, because nothing is known between them."""
    for begin, end in spans:
        within = stamp_ns[(stamp_ns >= begin) & (stamp_ns <= end)]
        for part in unbroken(within):
            yield int(within[part][0]), int(within[part][-1])


def _named(found: Sequence[Tracking]) -> str:
    parts = [f"{each.label} within {_rms(each):.2g} {each.unit} RMS" for each in found]
    return ", ".join(parts)


def _rms(each: Tracking) -> float:
    return float(np.sqrt(np.mean(each.error**2)))


def _facts(found: Sequence[Tracking]) -> Iterator[Fact]:
    for each in found:
        unit = "degps" if each.unit == "deg/s" else "mps" if each.unit == "m/s" else each.unit
        label = each.label.capitalize()
        yield Fact(f"{each.key}_error_rms_{unit}", f"{label}, error RMS", significant(_rms(each), 3), each.unit)
        largest = float(np.abs(each.error).max())
        yield Fact(f"{each.key}_error_max_{unit}", f"{label}, largest error", significant(largest, 3), each.unit)


# Changes of a setpoint that are distinguishable from the effect of waves and gusts.
_VARIES = {"deg": 3.0, "m/s": 0.15, "deg/s": 3.0}
_STEPS = {"deg": 20.0, "m/s": 1.0, "deg/s": 10.0}


def _unturned(each: Tracking) -> tuple[Floats, Floats]:
    """Setpoint and response as numbers without the step from 360 to 0."""
    if not each.turns:
        return each.demanded, each.achieved
    demanded = np.unwrap(each.demanded, period=360.0)
    return demanded, demanded + each.error


def _steps(found: Sequence[Tracking], clock: LogClock) -> Iterator[Grid]:
    for each in found:
        steps = step_responses(each.stamp_ns, *_unturned(each), _STEPS[each.unit])
        if not steps:
            continue
        turn = 360.0 if each.key == "heading" else 0.0
        rows = [
            (
                clock.second(step.at_ns),
                *(significant(value % turn if turn else value) for value in (step.begin, step.end)),
                significant(step.rise_s, 3),
                significant(step.overshoot_percent, 3),
                significant(step.settled_s, 3),
            )
            for step in steps
        ]
        columns = (
            "at (s)",
            f"from ({each.unit})",
            f"to ({each.unit})",
            "rise 10 to 90 % (s)",
            "overshoot (%)",
            "within 10 % after (s)",
        )
        yield Grid.limited(f"{each.key}_steps", f"{each.label.capitalize()}, steps of the demand", columns, rows)


def _plots(found: Sequence[Tracking]) -> Iterator[Plot]:
    for each in found:
        demanded, achieved = _unturned(each) if each.key == "heading" else (each.demanded, each.achieved)
        traces = (
            Trace("demanded", each.stamp_ns, demanded.astype(np.float64), "steps"),
            Trace("achieved", each.stamp_ns, achieved.astype(np.float64)),
            Trace("error", each.stamp_ns, each.error.astype(np.float64)),
        )
        yield Plot(f"tracking.{each.key}", f"{each.label.capitalize()}, demanded and achieved", each.unit, traces)
