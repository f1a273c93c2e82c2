"""Control: setpoints against the vehicle's response, and losses of control.

Rover logs its setpoints in NTUN, THR and STER, Copter and Plane in ATT and RATE. Recordings of xitl contain the heading
and the error of speed that the autopilot reports over MAVLink. A setpoint that is always 0 is ignored.

Response to a setpoint: its delay, and rise, overshoot and settling after each step.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import HEADING_HELD, VehicleKind
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace
from xitl_cli.logs.model.table import Flags, Floats, Stamps
from xitl_cli.logs.model.text import plural
from xitl_cli.logs.signals.series import column_series, first_instance, numbers, significant
from xitl_cli.logs.signals.spans import inside, length_s, spans_where
from xitl_cli.logs.signals.states import armed_rows, parameter_values, vehicle_kind
from xitl_cli.plugins.logs.analyses.attitude import free_attitude_spans
from xitl_cli.plugins.logs.analyses.outputs import driven_outputs

LONGEST_PAUSE_S = 2.0  # between rows: values in a longer pause are unknown
LONGEST_DELAY_S = 10.0
_RESPONDS = 0.1  # share of the setpoint's variation, less than which is no response
_FINER = 0.8  # share of the error without a shift, required for a delay
_SHIFT_S, _MOST_ROWS = 0.05, 20_000
_STEP_WITHIN_S, _BEGINS_SHARE = 1.0, 0.1
_HOLD_S, _HOLD_SHARE = 4.0, 0.15
_HELD_ROWS = 256  # compared first; four times as many in each further step
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

    demanded, achieved: (N,) without turns. least: least change of the setpoint that allows a result. None also if the
    response hardly varies, or if no shift brings the two clearly nearer to each other.
    """
    parts = [part for part in unbroken(stamp_ns) if part.stop - part.start >= _LEAST_ROWS]
    varies, responds = (
        max((float(np.std(every[part])) for part in parts), default=0.0) for every in (demanded, achieved)
    )
    if varies < least or responds < _RESPONDS * varies:
        return None
    shifts_s = np.arange(0.0, LONGEST_DELAY_S, _SHIFT_S)
    errors = _squares_apart(stamp_ns, demanded, achieved, parts, shifts_s)
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


def _squares_apart(
    stamp_ns: Stamps, demanded: Floats, achieved: Floats, parts: Sequence[slice], shifts_s: Floats
) -> Floats:
    """(S,) mean square difference at each shift, over the rows that every shift has, so that all use the same rows."""
    squares: list[list[Floats]] = [[] for _ in shifts_s]
    for part in parts:
        seconds, there = (stamp_ns[part] - stamp_ns[part.start]) * 1e-9, achieved[part]
        reach_s = min(LONGEST_DELAY_S, 0.25 * seconds[-1])
        kept = seconds <= seconds[-1] - reach_s
        some = np.flatnonzero(kept)[:: max(1, len(stamp_ns) // _MOST_ROWS)]
        at_s, wanted = seconds[some], demanded[part][some]
        for apart, shift_s in zip(squares, shifts_s, strict=True):
            later = np.interp(at_s + min(shift_s, reach_s), seconds, there)
            apart.append((later - wanted) ** 2)
    return np.array([float(np.mean(np.concatenate(apart))) for apart in squares])


def step_responses(stamp_ns: Stamps, demanded: Floats, achieved: Floats, least: float) -> list[StepResponse]:
    """Responses to steps of at least `least`: a change within a second to a value that is then held for at least four.

    demanded, achieved: (N,) without turns. A step is from the vessel's value to the setpoint at its end.
    """
    return [step for part in unbroken(stamp_ns) for step in _responses(stamp_ns, demanded, achieved, part, least)]


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
        end = _held_until(wanted, settled_at, _HOLD_SHARE * abs(step))
        if seconds[end - 1] - seconds[settled_at] < _HOLD_S:
            continue
        response = _answered(stamp_ns[part][at:end], wanted[at:end], there[at:end], settled_at - at, least)
        if response is not None:
            yield response
        done = end - 1


def _held_until(values: Floats, row: int, most: float) -> int:
    """First row from this one on that differs from it by more than `most`; the number of rows if there is none."""
    begin, many = row, _HELD_ROWS
    while begin < len(values):  # most values are held only briefly
        moved = np.abs(values[begin : begin + many] - values[row]) > most
        if moved.any():
            return begin + int(np.argmax(moved))
        begin, many = begin + many, 4 * many
    return len(values)


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
_LATE_S = 0.5


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
    """Limit of an error, and the finding for an error over it: over `least` and over `share` of the setpoint, for
    `lasting_s` at a time."""

    key: str
    doing: str
    """What the vehicle did, for the sentence."""
    step: str
    least: float
    share: float
    lasting_s: float
    severity: Severity = Severity.WARNING
    moved: float = 0.0
    """Least response in that time: a pilot also moves the sticks on the ground, where nothing follows."""
    side: int = 0
    """1 for achieved over demanded, -1 for under, 0 for both."""


_MOST_OFF = 0.25
"""Share of the time over a limit up to which a vehicle followed its setpoints."""
_LOST_STEP = "Look at motors and propellers (outputs at their ends), vibration and battery just before."
# A boat turns by half a circle in 10 to 15 s and gathers way in 10 s. ArduCopter's crash check treats 30 deg for two
# seconds as lost control.
_LIMITS: Mapping[str, tuple[TrackingLimit, ...]] = {
    "heading": (
        TrackingLimit(
            "heading_off", "was off the demanded heading",
            "Look at steering and thrusters then (outputs), at current and wind, and at the compass; a vessel too slow "
            "to steer does the same.",
            30.0, 0.0, 15.0,
        ),
    ),
    "speed": (
        TrackingLimit(
            "too_slow", "stayed below the demanded speed",
            "Look at throttle (outputs), battery, hull and propellers, and at current and wind.",
            0.5, 0.3, 15.0, side=-1,
        ),
        TrackingLimit(
            "too_fast", "went faster than demanded",
            "Look at current and wind from behind, at CRUISE_THROTTLE and the gains of the speed loop (ATC_SPEED_…).",
            0.75, 0.5, 10.0, side=1,
        ),
    ),
    "turn_rate": (
        TrackingLimit(
            "turn_rate_off", "did not turn as demanded",
            "Look at steering outputs and their range, and at the gains of the turn rate (ATC_STR_RAT_…).",
            20.0, 0.5, 3.0,
        ),
    ),
    **{
        name: (
            TrackingLimit(
                "attitude_lost", f"lost control: its {name} was off the demanded one", _LOST_STEP,
                30.0, 0.0, 2.0, Severity.CRITICAL, moved=30.0,
            ),
        )
        for name in ("roll", "pitch")
    },
    **{
        f"{axis}_rate": (
            TrackingLimit(
                "rate_lost", f"did not follow its demanded {axis} rate", _LOST_STEP, 60.0, 1.0, 1.0, moved=60.0
            ),
        )
        for axis in ("roll", "pitch", "yaw")
    },
}  # fmt: skip
"""Limits of each tracking, by its key."""


def analyse(log: Log) -> Section | None:
    """Section on control; None for a recording without setpoints."""
    clock, kind = LogClock(log), vehicle_kind(log)
    trackings = [tracking for tracking in _trackings(log, kind) if len(tracking.stamp_ns) >= _FEWEST_ROWS]
    if not trackings:
        if log.format != "dataflash":
            return None
        lack = "No setpoints are logged: no NTUN, THR or STER of Rover, no desired attitude (ATT), no RATE."
        return Section("control", _TITLE, lacks=(lack,))
    by_key: dict[str, Finding] = {}
    for tracking in trackings:
        for limit in _LIMITS[tracking.key]:
            finding = _off(tracking, limit, clock)
            if finding is not None:  # roll and pitch that were lost together are one loss
                first = by_key.get(finding.key)
                evidence = () if first is None else first.evidence
                by_key[finding.key] = replace(first or finding, evidence=(*evidence, *finding.evidence))
    # Many errors that are too short for a finding are no good tracking either.
    if not by_key and clock.armed and all(_within_limits(tracking) for tracking in trackings):
        followed = Finding.ok("control.followed", f"It followed its setpoints: {', '.join(map(_followed, trackings))}")
        by_key = {followed.key: followed}
    facts: list[Fact] = []
    for tracking in trackings:
        suffix = {"deg/s": "degps", "m/s": "mps"}.get(tracking.unit, tracking.unit)
        label = tracking.label.capitalize()
        largest = float(np.abs(tracking.error).max())
        facts += (
            Fact(f"{tracking.key}_error_rms_{suffix}", f"{label}, error RMS", _digits(_rms(tracking)), tracking.unit),
            Fact(f"{tracking.key}_error_max_{suffix}", f"{label}, largest error", _digits(largest), tracking.unit),
        )
    grids: list[Grid] = []
    for tracking in trackings:
        label = tracking.label.capitalize()
        response = (tracking.stamp_ns, *_unturned(tracking))
        delay_s = _delay_s(tracking)
        if delay_s is not None:
            facts.append(Fact(f"{tracking.key}_delay_s", f"{label}, delay behind the demand", _digits(delay_s), "s"))
        steps = step_responses(*response, _STEPS[tracking.unit])
        if steps:
            overshoot = max(step.overshoot_percent for step in steps)
            title = f"{label}, largest overshoot of {plural(len(steps), 'step')}"
            facts.append(Fact(f"{tracking.key}_overshoot_percent", title, _digits(overshoot), "%"))
            grids.append(_step_grid(tracking, steps, clock))
    # Setpoints that a rover did not get, or did not log.
    lacks: list[str] = []
    if kind in ("rover", "unknown"):
        there = {tracking.key for tracking in trackings}
        if "turn_rate" not in there:
            lacks.append(
                "No demanded turn rate is logged (STER.DesTurnRate), so it cannot be compared with the achieved one."
            )
        if "heading" not in there and log.format == "dataflash":
            lacks.append("No heading was demanded (NTUN.DesYaw and ATT.DesYaw are 0): it was steered by turn rate.")
        if "speed" not in there:
            lacks.append("No demanded speed is logged (THR.DesSpeed), so it cannot be compared with the achieved one.")
    plots = tuple(map(_plot, trackings))
    return Section("control", _TITLE, tuple(facts), tuple(by_key.values()), tuple(grids), plots, tuple(lacks))


def _digits(value: float | None) -> float | None:
    return significant(value, 3)


def _trackings(log: Log, kind: VehicleKind) -> Iterator[Tracking]:
    if kind in ("rover", "unknown"):
        yield from _heading(log)
        yield from _speed(log)
        for tracking in _columns(log, "turn_rate", "turn rate", "deg/s", "STER", "DesTurnRate", "TurnRate"):
            yield _rows(tracking, _under_way(log, tracking.stamp_ns))
        return
    for name in ("roll", "pitch"):
        demanded, achieved = f"Des{name.capitalize()}", name.capitalize()
        for tracking in _columns(log, name, name, "deg", "ATT", demanded, achieved, turns=True):
            yield _rows(tracking, ~inside(tracking.stamp_ns, free_attitude_spans(log)))
    for axis, achieved in (("roll", "R"), ("pitch", "P"), ("yaw", "Y")):
        table = log.tables.get("RATE")  # hundredths of a degree in old logs, without a unit
        if table is not None and achieved in table.columns and table.columns[achieved].unit == "deg/s":
            yield from _columns(log, f"{axis}_rate", f"{axis} rate", "deg/s", "RATE", f"{achieved}Des", achieved)


def _armed(log: Log, stamp_ns: Stamps) -> Flags:
    armed = armed_rows(log, stamp_ns)
    return np.ones(len(stamp_ns), dtype=np.bool_) if armed is None else armed


def _heading(log: Log) -> Iterator[Tracking]:
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


_UNDER_WAY_MPS, _RUNNING = 0.2, 0.1


def _under_way(log: Log, stamp_ns: Stamps) -> Flags:
    """(N,) True if the setpoint of the speed is ahead or not logged, or if a motor runs, as in a turn on the spot.

    A vessel at rest does not steer.
    """
    speed = column_series(log, "THR", "DesSpeed", "m/s")
    if speed is None or not (speed.values >= _UNDER_WAY_MPS).any():
        return np.ones(len(stamp_ns), dtype=np.bool_)
    ahead: Flags = ~(speed.interpolated(stamp_ns) < _UNDER_WAY_MPS)
    for output in driven_outputs(log, parameter_values(log)):
        if output.drives:
            row = np.searchsorted(output.series.stamp_ns, stamp_ns, side="right") - 1
            ahead |= (row >= 0) & (np.abs(np.nan_to_num(output.command))[np.maximum(row, 0)] > _RUNNING)
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


def _rows(tracking: Tracking, chosen: Flags) -> Tracking:
    return replace(
        tracking,
        stamp_ns=tracking.stamp_ns[chosen],
        demanded=tracking.demanded[chosen],
        achieved=tracking.achieved[chosen],
    )


def _speed(log: Log) -> Iterator[Tracking]:
    """Speed with a setpoint. 0 in a mode without a setpoint is ignored."""
    logged = [*_columns(log, "speed", "speed", "m/s", "THR", "DesSpeed", "Speed")]
    for tracking in logged or _speed_from_telemetry(log):
        moving = _rows(tracking, np.abs(tracking.demanded) >= _UNDER_WAY_MPS)
        sign = np.sign(moving.demanded)  # backwards counts as ahead
        yield replace(moving, demanded=sign * moving.demanded, achieved=sign * moving.achieved)


_NAVIGATION = "NAV_CONTROLLER_OUTPUT"


def _speed_from_telemetry(log: Log) -> Iterator[Tracking]:
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


def _within_limits(tracking: Tracking) -> bool:
    """Whether the error is within each limit for most of the time: turns and accelerations take a part of it."""
    error, demanded = np.abs(tracking.error), np.abs(tracking.demanded)
    return all(
        np.mean(error > np.maximum(limit.least, limit.share * demanded)) < _MOST_OFF for limit in _LIMITS[tracking.key]
    )


def _off(tracking: Tracking, limit: TrackingLimit, clock: LogClock) -> Finding | None:
    """One finding for all spans with too large an error for too long."""
    stamp_ns, unit = tracking.stamp_ns, tracking.unit
    error = limit.side * tracking.error if limit.side else np.abs(tracking.error)
    least = np.maximum(limit.least, limit.share * np.abs(tracking.demanded))
    spans: list[tuple[int, int]] = []
    for begin, end in spans_where(stamp_ns, error > least, _JOIN_S):
        # Split at missing rows, because nothing is known between them.
        within = np.flatnonzero((stamp_ns >= begin) & (stamp_ns <= end))
        for part in unbroken(stamp_ns[within]):
            rows = within[part]
            lasted_s = (stamp_ns[rows[-1]] - stamp_ns[rows[0]]) * 1e-9
            if lasted_s >= limit.lasting_s and np.abs(tracking.achieved[rows]).max() >= limit.moved:
                spans.append((int(stamp_ns[rows[0]]), int(stamp_ns[rows[-1]])))
    if not spans:
        return None
    begin, end = max(spans, key=lambda span: span[1] - span[0])
    rows = np.flatnonzero((stamp_ns >= begin) & (stamp_ns <= end))
    worst = int(rows[np.argmax(error[rows])])
    again = "" if len(spans) == 1 else f" ({len(spans)} times, {length_s(spans):.0f} s in all)"
    figures = (
        f"{tracking.achieved[worst]:.3g} {unit} for {tracking.demanded[worst]:.3g} {unit} at "
        f"{clock.text(int(stamp_ns[worst]))}"
    )
    return Finding(
        f"control.{limit.key}",
        limit.severity,
        f"It {limit.doing} by up to {error[worst]:.3g} {unit}, for {(end - begin) * 1e-9:.1f} s from "
        f"{clock.text(begin)}{again}: {figures}",
        tuple(
            Evidence(tracking.message, tracking.field, from_ns, until_ns, f"{error[worst]:.3g} {unit}")
            for from_ns, until_ns in spans[:_MOST_EVIDENCE]
        ),
        limit.step,
    )


def _followed(tracking: Tracking) -> str:
    """Error of a setpoint that was followed. If the response is late, it is the error after the delay."""
    rms, delay_s = _rms(tracking), _delay_s(tracking)
    late = ""
    if delay_s is not None and delay_s >= _LATE_S:
        demanded, achieved = _unturned(tracking)
        seconds = (tracking.stamp_ns - tracking.stamp_ns[0]) * 1e-9
        before = seconds >= delay_s
        rms = float(np.sqrt(np.mean((achieved - np.interp(seconds - delay_s, seconds, demanded))[before] ** 2)))
        late = f" after a delay of {delay_s:.1f} s"
    return f"{tracking.label} within {rms:.2g} {tracking.unit} RMS{late}"


def _delay_s(tracking: Tracking) -> float | None:
    return response_delay_s(tracking.stamp_ns, *_unturned(tracking), _VARIES[tracking.unit])


def _rms(tracking: Tracking) -> float:
    return float(np.sqrt(np.mean(tracking.error**2)))


# Changes of a setpoint that are distinguishable from the effect of waves and gusts.
_VARIES = {"deg": 3.0, "m/s": 0.15, "deg/s": 3.0}
_STEPS = {"deg": 20.0, "m/s": 1.0, "deg/s": 10.0}


def _unturned(tracking: Tracking) -> tuple[Floats, Floats]:
    """Setpoint and response as numbers without the step from 360 to 0."""
    if not tracking.turns:
        return tracking.demanded, tracking.achieved
    demanded = np.unwrap(tracking.demanded, period=360.0)
    return demanded, demanded + tracking.error


def _step_grid(tracking: Tracking, steps: Sequence[StepResponse], clock: LogClock) -> Grid:
    ends = [(step.begin, step.end) for step in steps]
    if tracking.key == "heading":
        ends = [(begin % 360.0, end % 360.0) for begin, end in ends]
    columns = (
        "at (s)",
        f"from ({tracking.unit})",
        f"to ({tracking.unit})",
        "rise 10 to 90 % (s)",
        "overshoot (%)",
        "within 10 % after (s)",
    )
    rows = [
        (
            clock.second(step.at_ns),
            significant(begin),
            significant(end),
            _digits(step.rise_s),
            _digits(step.overshoot_percent),
            _digits(step.settled_s),
        )
        for step, (begin, end) in zip(steps, ends, strict=True)
    ]
    title = f"{tracking.label.capitalize()}, steps of the demand"
    return Grid.limited(f"{tracking.key}_steps", title, columns, rows)


def _plot(tracking: Tracking) -> Plot:
    heading = tracking.key == "heading"
    demanded, achieved = _unturned(tracking) if heading else (tracking.demanded, tracking.achieved)
    traces = (
        Trace("demanded", tracking.stamp_ns, demanded.astype(np.float64), "steps"),
        Trace("achieved", tracking.stamp_ns, achieved.astype(np.float64)),
        Trace("error", tracking.stamp_ns, tracking.error.astype(np.float64)),
    )
    title = f"{tracking.label.capitalize()}, demanded and achieved"
    return Plot(f"tracking.{tracking.key}", title, tracking.unit, traces)
