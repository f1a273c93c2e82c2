"""Attitude and impacts: capsized vessels, vehicles on their back, collisions.

Normal values depend on the class of the vehicle (`model/codes.py`), its own limits (ANGLE_MAX, ROLL_LIMIT_DEG) and
the mode: a loop flown in ACRO gives no warning.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import BOAT_FRAME, FREE_ATTITUDE, MOTION_LIMITS, SURFACE_BOAT, MotionLimits, VehicleKind
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Mark, Plot, Section, Severity, Trace
from xitl_cli.logs.model.table import Flags, Floats, Stamps
from xitl_cli.logs.signals.sensors import STANDARD_GRAVITY_MPS2, InertialUnit, inertial_units, injected_units
from xitl_cli.logs.signals.series import first_instance, significant
from xitl_cli.logs.signals.spans import inside, length_s, spans_where
from xitl_cli.logs.signals.states import autopilot_heartbeats, firmware_text, parameter_values, vehicle_kind
from xitl_cli.plugins.logs.analyses.outputs import driven_outputs

_TITLE = "Attitude and impacts"
_SOURCES: tuple[signals.SignalSource, ...] = ("estimate", "truth")
_JOIN_S = 1.0
_OVERTURNED_S = 0.5
_FREE_S = 5.0  # a flip, a roll or a loop is over by then
_AFTER_DISARM_NS = 10_000_000_000
_RUNNING = 0.05
_MOST_EVIDENCE = 8


@dataclass(frozen=True, slots=True)
class TiltSeries:
    """Roll and pitch (N,) in deg."""

    stamp_ns: Stamps
    roll_deg: Floats
    pitch_deg: Floats
    tilt_deg: Floats
    """(N,) angle between the vertical axis and the vertical."""
    source: str
    """The message."""
    field: str | None


def tilt_series(log: Log, of: signals.SignalSource = "estimate") -> TiltSeries | None:
    """Tilt of the vehicle; None without an attitude."""
    roll, pitch = signals.roll(log, of), signals.pitch(log, of)
    if roll is None or pitch is None:
        return None
    pitch_deg = pitch.interpolated(roll.stamp_ns)
    known = np.isfinite(pitch_deg)
    if not known.any():
        return None
    stamps, roll_deg, pitch_deg = roll.stamp_ns[known], roll.values[known], pitch_deg[known]
    roll_deg, pitch_deg = (np.mod(angle + 180.0, 360.0) - 180.0 for angle in (roll_deg, pitch_deg))
    upright = np.cos(np.radians(roll_deg)) * np.cos(np.radians(pitch_deg))
    message, _, field = roll.source.partition(".")
    return TiltSeries(stamps, roll_deg, pitch_deg, np.degrees(np.arccos(upright)), message, field or None)


def analyse(log: Log) -> Section | None:
    every = [found for of in _SOURCES if (found := tilt_series(log, of)) is not None]
    inertial = inertial_units(log)
    if not every and not inertial:
        if log.of_topics:
            return None
        return Section("attitude", _TITLE, lacks=("No attitude is logged; set the bit ATTITUDE of LOG_BITMASK.",))
    clock, kind, parameters = LogClock(log), vehicle_kind(log), parameter_values(log)
    limits = vehicle_limits(kind, parameters)
    free = free_attitude_spans(log)
    overturned: list[tuple[int, int]] = []
    findings: list[Finding] = []
    # Use the truth if there is no estimate.
    tilt = max(every, key=lambda found: len(_overturned_spans(found, limits, free)), default=None)
    if tilt is not None:
        overturned = _overturned_spans(tilt, limits, free)
        accelerometers = inertial or injected_units(log)
        findings += _overturned(log, tilt, overturned, accelerometers, kind, parameters, clock)
        findings += _leaning(log, tilt, limits, [*overturned, *free], clock)
    shocks = find_shocks(inertial, limits)
    if kind == "rover" and _is_boat(log, parameters):
        bumps = (bump for unit in inertial for bump in find_bumps(unit) if clock.was_armed(bump.at_ns))
        shocks = _distinct([*shocks, *bumps])
    findings += _impacts(log, shocks, overturned, clock)
    findings += _contacts(log, clock)
    if tilt is not None and not findings:
        steepest = float(tilt.tilt_deg.max())
        shock = ", and felt no shock" if inertial or log.of_topics else ""
        findings.append(Finding.ok("attitude.upright", f"It kept upright, to {steepest:.0f}°{shock}"))
    if tilt is not None and kind == "rover" and _is_boat(log, parameters):
        findings += _rolling(tilt, overturned, clock)
    facts: list[Fact] = []
    if tilt is not None:
        on: Flags = inside(tilt.stamp_ns, clock.armed) if clock.armed else np.ones(len(tilt.stamp_ns), dtype=np.bool_)
        if on.any():
            for key, label, values in (
                ("roll_max_deg", "Roll, largest", np.abs(tilt.roll_deg)),
                ("pitch_max_deg", "Pitch, largest", np.abs(tilt.pitch_deg)),
            ):
                facts.append(Fact(key, label, significant(float(values[on].max()), 3), "deg"))
    facts.append(Fact("shocks", "Shocks", len(shocks)))
    if shocks:
        largest = max(shock.size_mps2 for shock in shocks)
        facts.append(Fact("largest_shock_mps2", "Largest shock", significant(largest, 3), "m/s²"))
    return Section("attitude", _TITLE, tuple(facts), tuple(findings), plots=tuple(_plots(tilt, findings)))


def vehicle_limits(kind: VehicleKind, parameters: Mapping[str, float]) -> MotionLimits:
    """Limits of its class, with the lean that its parameters allow, plus 20 deg for gusts."""
    limits = MOTION_LIMITS[kind]
    allowed = {
        "copter": (parameters.get("ATC_ANGLE_MAX", 0.0), parameters.get("ANGLE_MAX", 0.0) * 0.01),
        "plane": (parameters.get("ROLL_LIMIT_DEG", 0.0), parameters.get("LIM_ROLL_CD", 0.0) * 0.01),
    }.get(kind, ())
    own = max(allowed, default=0.0)
    lean = limits.lean_deg if own <= 0.0 or limits.lean_deg is None else own + _GUST_DEG
    return MotionLimits(lean, limits.lean_s, limits.overturned_deg, limits.shock_mps2)


_GUST_DEG = 20.0


def free_attitude_spans(log: Log) -> list[tuple[int, int]]:
    """Spans in modes in which the pilot may command any attitude."""
    names = FREE_ATTITUDE.get(vehicle_kind(log), frozenset())
    return [(span.from_ns, span.until_ns) for span in signals.modes(log) if span.text in names]


def _overturned_spans(tilt: TiltSeries, limits: MotionLimits, free: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    spans = spans_where(tilt.stamp_ns, tilt.tilt_deg > limits.overturned_deg, _JOIN_S)
    found = []
    for begin, end in spans:
        least_s = _FREE_S if any(a <= begin and end <= b + _AFTER_DISARM_NS for a, b in free) else _OVERTURNED_S
        if (end - begin) * 1e-9 >= least_s:
            found.append((begin, end))
    return found


def _sailing(log: Log, clock: LogClock, span: tuple[int, int]) -> str:
    """State at the beginning of a span: "armed", "just disarmed", "disarmed", or "" if unknown."""
    if not clock.armed and not any(name in log.tables for name in ("ARM", "EV", "HEARTBEAT", "/actuators")):
        return ""
    if any(begin <= span[1] and end >= span[0] for begin, end in clock.armed):
        return "armed"
    return "just disarmed" if any(0 <= span[0] - end <= _AFTER_DISARM_NS for _, end in clock.armed) else "disarmed"


def _overturned(
    log: Log,
    tilt: TiltSeries,
    spans: list[tuple[int, int]],
    inertial: Sequence[InertialUnit],
    kind: VehicleKind,
    parameters: Mapping[str, float],
    clock: LogClock,
) -> Iterator[Finding]:
    """One finding for each state, about its longest span."""
    for state, severity in _SEVERITIES.items():
        these = [span for span in spans if _sailing(log, clock, span) == state]
        if not these:
            continue
        begin, end = max(these, key=lambda span: span[1] - span[0])
        rows = (tilt.stamp_ns >= begin) & (tilt.stamp_ns <= end)
        worst = int(np.flatnonzero(rows)[np.argmax(tilt.tilt_deg[rows])])
        again = "" if len(these) == 1 else f" ({len(these)} times, {length_s(these):.1f} s in all)"
        running = _running(log, these, parameters) if state != "disarmed" else None
        motors = "" if running is None else f", with its motors running at up to {100.0 * running:.0f} %"
        while_ = f", {state}" if state else ""
        # A camera's bag in a hand turns over too: without a known vehicle it is no capsize.
        if not state and running is None and not parameters and not firmware_text(log) and log.of_topics:
            severity = Severity.CRITICAL if "/truth/state" in log.tables else Severity.NOTICE
        evidence = tuple(
            Evidence(tilt.source, tilt.field, a, b, f"{tilt.tilt_deg[worst]:.0f}°") for a, b in these[:_MOST_EVIDENCE]
        )
        if kind == "rover" and _stands_upright(inertial, begin, end):
            yield Finding.warning(
                "attitude.doubtful",
                f"By the estimate it lay at {_angles(tilt, worst)} for {(end - begin) * 1e-9:.1f} s from "
                f"{clock.text(begin)}{while_}, where its accelerometers show it upright",
                evidence,
                "Look at the estimator then, and at AHRS_ORIENTATION: one of the two is wrong.",
            )
            continue
        yield Finding(
            "attitude.overturned",
            severity,
            f"It {_word(log, kind, parameters)}: at {_angles(tilt, worst)} for {(end - begin) * 1e-9:.1f} s from "
            f"{clock.text(begin)}{again}{while_}{motors}",
            evidence,
            "Look at the time just before (impacts, control, modes); let the autopilot stop its motors "
            "(FS_CRASH_CHECK, CRASH_ANGLE)."
            if state != "disarmed"
            else "This is normal if it was carried or calibrated. Otherwise, it lay like this.",
        )


_SEVERITIES = {
    "armed": Severity.CRITICAL,
    "just disarmed": Severity.CRITICAL,
    "": Severity.CRITICAL,
    "disarmed": Severity.NOTICE,
}


def _word(log: Log, kind: VehicleKind, parameters: Mapping[str, float]) -> str:
    if kind in ("copter", "plane"):
        return "was inverted"
    return "capsized" if _is_boat(log, parameters) else "overturned"


def _is_boat(log: Log, parameters: Mapping[str, float]) -> bool:
    beats = autopilot_heartbeats(log)
    return (
        parameters.get("FRAME_CLASS") == BOAT_FRAME
        or (firmware_text(log) or "").startswith("xitl ")
        or (beats is not None and int(beats.values("type", raw=True)[0]) == SURFACE_BOAT)
        or "/truth/state" in log.tables
    )


def _angles(tilt: TiltSeries, row: int) -> str:
    """Roll, and pitch if that causes the tilt."""
    roll, pitch = tilt.roll_deg[row], tilt.pitch_deg[row]
    return f"roll {roll:.0f}°" if abs(roll) >= abs(pitch) else f"pitch {pitch:.0f}° and roll {roll:.0f}°"


def _running(log: Log, spans: Sequence[tuple[int, int]], parameters: Mapping[str, float]) -> float | None:
    """Largest command to a motor in these spans; None if none ran, or none is logged."""
    most = 0.0
    for output in driven_outputs(log, parameters):
        if output.drives:
            command = np.abs(output.command[inside(output.series.stamp_ns, spans) & output.armed])
            most = max(most, float(np.nanmax(command)) if np.isfinite(command).any() else 0.0)
    return most if most > _RUNNING else None


def _stands_upright(inertial: Sequence[InertialUnit], begin: int, end: int) -> bool:
    """Whether accelerometers contradict: a floating or rolling vehicle measures the support of its weight."""
    for unit in inertial:
        if unit.accel_mps2 is None:
            continue
        rows = (unit.stamp_ns >= begin) & (unit.stamp_ns <= end) & np.isfinite(unit.accel_mps2).all(axis=1)
        if np.count_nonzero(rows) < 5:
            continue
        mean = unit.accel_mps2[rows].mean(axis=0)
        size = float(np.linalg.norm(mean))
        return 0.8 < size / STANDARD_GRAVITY_MPS2 < 1.2 and -mean[2] > np.cos(np.radians(45.0)) * size
    return False


def _leaning(
    log: Log, tilt: TiltSeries, limits: MotionLimits, explained: Sequence[tuple[int, int]], clock: LogClock
) -> Iterator[Finding]:
    """Lean beyond the limit of the class, without overturning; only while armed."""
    if limits.lean_deg is None:
        return
    spans = spans_where(tilt.stamp_ns, tilt.tilt_deg > limits.lean_deg, 0.2)
    near = [(begin - 10**9, end + 10**9) for begin, end in explained]
    spans = [
        span
        for span in spans
        if (span[1] - span[0]) * 1e-9 >= limits.lean_s
        and not any(begin <= span[1] and end >= span[0] for begin, end in near)
        and _sailing(log, clock, span) not in ("disarmed", "just disarmed")
    ]
    if not spans:
        return
    rows = np.flatnonzero(inside(tilt.stamp_ns, spans))
    worst = int(rows[np.argmax(tilt.tilt_deg[rows])])
    again = "once" if len(spans) == 1 else f"{len(spans)} times"
    yield Finding.warning(
        "attitude.leaning",
        f"It leaned over by more than {limits.lean_deg:.0f}° {again}, for {length_s(spans):.1f} s in all, to "
        f"{_angles(tilt, worst)} at {clock.text(int(tilt.stamp_ns[worst]))}",
        tuple(Evidence(tilt.source, tilt.field, begin, end) for begin, end in spans[:_MOST_EVIDENCE]),
        "Look at waves, wind and turns then; more speed in a turn, or a higher centre of gravity, tips it over.",
    )


_ROLLING_DEG, _ROLLING_S = 8.0, 10.0
"""Root mean square of roll and pitch together, in a window: twice the roll in which a crew works (4 deg, NATO
STANAG 4154)."""


def _rolling(tilt: TiltSeries, overturned: Sequence[tuple[int, int]], clock: LogClock) -> Iterator[Finding]:
    """Roll and pitch in waves that are more than a boat is steered in; only while armed, without capsizes."""
    sailing = inside(tilt.stamp_ns, clock.armed) & ~inside(tilt.stamp_ns, overturned)
    stamps = tilt.stamp_ns[sailing]
    if not len(stamps):
        return
    angles = np.stack([tilt.roll_deg, tilt.pitch_deg], axis=1)[sailing]
    after = np.searchsorted(stamps, stamps + round(_ROLLING_S * 1e9))
    begins = np.flatnonzero(after < len(stamps))
    many = (after[begins] - begins)[:, None]
    sums, squares = (np.concatenate([np.zeros((1, 2)), np.cumsum(values, axis=0)]) for values in (angles, angles**2))
    mean = (sums[after[begins]] - sums[begins]) / many
    variance = (squares[after[begins]] - squares[begins]) / many - mean**2
    rms_deg = np.sqrt(np.maximum(variance, 0.0))
    rolling = np.hypot(*rms_deg.T)
    rough = np.flatnonzero(rolling > _ROLLING_DEG)
    if not len(rough):
        return
    worst = int(rough[np.argmax(rolling[rough])])
    roll_deg, pitch_deg = rms_deg[worst]
    spans = []
    for begin, end in spans_where(stamps[begins], rolling > _ROLLING_DEG, _ROLLING_S):
        first = (stamps >= begin) & (stamps <= begin + round(_ROLLING_S * 1e9))
        far = np.linalg.norm(angles[first] - np.median(angles[first], axis=0), axis=1) > _ROLLING_DEG
        spans.append((int(stamps[first][np.argmax(far)]), end + round(_ROLLING_S * 1e9)))
    yield Finding.notice(
        "attitude.rolling",
        f"It rolled by {roll_deg:.0f}° and pitched by {pitch_deg:.0f}° RMS in the ten seconds from "
        f"{clock.text(int(stamps[begins[worst]]))}",
        tuple(Evidence(tilt.source, tilt.field, begin, end) for begin, end in spans[:_MOST_EVIDENCE]),
        "Look at the waves: a vessel that moves like this does not follow its mission well. Wait for calmer water.",
    )


_CLUSTER_NS = 1_000_000_000
_BEFORE_NS = 3_000_000_000
_JUST_BEFORE_NS = 250_000_000
_VIBRATIONS = 6.0  # factor by which a peak must exceed the usual level
_NO_SENSOR_MPS2 = 420.0  # 43 g
_RANGES_G = (4, 8, 16, 24, 30, 32)
_FOLLOWS_NS = 5_000_000_000


@dataclass(frozen=True, slots=True)
class Shock:
    """A peak of acceleration."""

    at_ns: int
    size_mps2: float
    usual_mps2: float
    """Usual deviation from gravity just before."""
    range_g: int | None
    """Range of the sensor if it was reached, so that the true peak is higher."""
    unit: str
    message: str
    field: str


def find_shocks(inertial: Sequence[InertialUnit], limits: MotionLimits) -> list[Shock]:
    """Peaks beyond the normal for the class and the vibration, one per second, of the unit with the largest, by
    time."""
    found: list[Shock] = []
    for unit in inertial:
        if unit.accel_mps2 is not None:
            with np.errstate(invalid="ignore"):
                known = (np.abs(unit.accel_mps2) < _NO_SENSOR_MPS2).all(axis=1)  # larger values are damage, not motion
            stamps, accel = unit.stamp_ns[known], unit.accel_mps2[known]
            size = np.linalg.norm(accel, axis=1)
            shaken = np.abs(size - STANDARD_GRAVITY_MPS2)
            rows = np.flatnonzero(shaken > limits.shock_mps2)
            while len(rows):
                row = int(rows[np.argmax(shaken[rows])])
                at_ns = int(stamps[row])
                rows = rows[np.abs(stamps[rows] - at_ns) > _CLUSTER_NS]
                before = shaken[(stamps >= at_ns - _BEFORE_NS) & (stamps <= at_ns - _JUST_BEFORE_NS)]
                usual = float(np.median(before)) if len(before) else 0.0
                if shaken[row] > limits.shock_mps2 + _VIBRATIONS * usual:
                    axis = float(np.abs(accel[row]).max()) / STANDARD_GRAVITY_MPS2
                    ends = [end for end in _RANGES_G if 0.97 * end <= axis <= 1.04 * end]
                    field = (unit.accel_fields or unit.gyro_fields)[0]
                    found.append(
                        Shock(
                            at_ns, float(size[row]), usual, ends[0] if ends else None, unit.name, unit.table.name, field
                        )
                    )
    return _distinct(found)


_BUMP_MPS2, _BUMPS = 6.0, 20.0
"""Least horizontal shock of a boat, and its least ratio to the usual one. Its thrusters and waves cause less: half of
the gravity would be a wave with a slope of 30 degrees that comes within `_BUMP_S`."""
_BUMP_S = 0.5
_BUMP_HZ = 20.0


def find_bumps(unit: InertialUnit) -> list[Shock]:
    """Short horizontal forces on a boat, by time: waves and slamming act vertically, an obstacle stops it."""
    if unit.accel_mps2 is None or len(unit.stamp_ns) < 2:
        return []
    known = np.isfinite(unit.accel_mps2).all(axis=1)
    stamps, accel = unit.stamp_ns[known], unit.accel_mps2[known]
    rate_hz = 1e9 * len(stamps) / max(int(stamps[-1]) - int(stamps[0]), 1) if len(stamps) else 0.0
    half = round(_BUMP_S * rate_hz)
    if rate_hz < _BUMP_HZ or len(stamps) <= 2 * half:
        return []
    level = accel[:, :2]
    summed = np.concatenate([np.zeros((1, 2)), np.cumsum(level, axis=0)])
    first, after = np.maximum(np.arange(len(level)) - half, 0), np.minimum(np.arange(len(level)) + half + 1, len(level))
    apart = np.linalg.norm(level - (summed[after] - summed[first]) / (after - first)[:, None], axis=1)
    usual = float(np.median(apart))
    rows = np.flatnonzero(apart > max(_BUMP_MPS2, _BUMPS * usual))
    size = np.linalg.norm(accel, axis=1)
    field = (unit.accel_fields or unit.gyro_fields)[0]
    return _distinct(
        Shock(int(stamps[row]), float(size[row]), usual, None, unit.name, unit.table.name, field)
        for row in rows.tolist()
    )


def _distinct(shocks: Iterable[Shock]) -> list[Shock]:
    """The largest shock of each second, by time."""
    kept: list[Shock] = []
    for shock in sorted(shocks, key=lambda shock: -shock.size_mps2):
        if all(abs(shock.at_ns - other.at_ns) > _CLUSTER_NS for other in kept):
            kept.append(shock)
    return sorted(kept, key=lambda shock: shock.at_ns)


def _impacts(
    log: Log, shocks: list[Shock], overturned: Sequence[tuple[int, int]], clock: LogClock
) -> Iterator[Finding]:
    """One finding for all shocks while armed or just disarmed, another for those during handling."""
    states = [_sailing(log, clock, (shock.at_ns, shock.at_ns)) for shock in shocks]
    sailing = [shock for shock, state in zip(shocks, states, strict=True) if state != "disarmed"]
    handled = [shock for shock, state in zip(shocks, states, strict=True) if state == "disarmed"]
    for these, by_hand in ((sailing, False), (handled, True)):
        if not these:
            continue
        worst = max(these, key=lambda shock: shock.size_mps2)
        limit = MOTION_LIMITS[vehicle_kind(log)].shock_mps2
        after = [] if by_hand else _consequences(log, these, overturned)
        grave = not by_hand and (bool(after) or worst.size_mps2 > 2.0 * limit)
        ends = "" if worst.range_g is None else f", the end of its range of {worst.range_g} g: it may have been more"
        again = "" if len(these) == 1 else f" ({len(these)} times in all)"
        usual = f"; it shook by {worst.usual_mps2:.1f} m/s² before" if worst.usual_mps2 > 1.0 else ""
        yield Finding(
            "attitude.impact" if not by_hand else "attitude.knock",
            Severity.CRITICAL if grave else Severity.NOTICE if by_hand else Severity.WARNING,
            f"It hit something, or something hit it: {worst.unit} felt {worst.size_mps2:.0f} m/s² at "
            f"{clock.text(worst.at_ns)}{ends}{again}{usual}"
            + (f"; {', '.join(after)} followed" if after else "")
            + (", while disarmed" if by_hand else ""),
            tuple(
                Evidence(shock.message, shock.field, shock.at_ns, None, f"{shock.size_mps2:.0f} m/s²")
                for shock in these[:_MOST_EVIDENCE]
            ),
            "Look for an obstacle on the track. Check hull, mounts and propellers before the next run."
            if not by_hand
            else "This is normal ashore. Check the mounts if nobody moved it.",
        )


def _consequences(log: Log, shocks: Sequence[Shock], overturned: Sequence[tuple[int, int]]) -> list[str]:
    """Events that began within five seconds of a shock, in words."""
    speed = signals.ground_speed(log)
    after: dict[str, None] = {}
    for shock in shocks:
        if any(shock.at_ns - 10**9 <= begin <= shock.at_ns + _FOLLOWS_NS for begin, _ in overturned):
            after["turning over"] = None
        if speed is None:
            continue
        # The speed fell from over 1 m/s to a fifth within three seconds, and stayed there for two more.
        since_s = (speed.stamp_ns - shock.at_ns) * 1e-9
        moving = speed.values[(since_s > -2.0) & (since_s < 0.0)]
        still = speed.values[(since_s > 3.0) & (since_s < 5.0)]
        if len(moving) > 1 and len(still) > 1 and np.median(moving) > max(1.0, 5.0 * float(np.max(still))):
            after["a standstill"] = None
    return list(after)


def _contacts(log: Log, clock: LogClock) -> Iterator[Finding]:
    """Contacts of the vessel from an xitl recording."""
    table = first_instance(log, "/contacts")
    if table is None or not {"what", "speed_mps", "began"} <= set(table.columns):
        return
    begun = np.flatnonzero(np.asarray(table.values("began", raw=True)) != 0)
    if not len(begun):
        return
    speeds = np.asarray(table.values("speed_mps"), dtype=np.float64)[begun]
    what = [str(name) for name in np.asarray(table.values("what"))[begun]]
    hardest = int(np.argmax(speeds))
    at_ns = int(table.stamp_ns[begun[hardest]])
    again = "" if len(begun) == 1 else f", the hardest of {len(begun)} times"
    yield Finding.warning(
        "attitude.contact",
        f"The vessel touched {what[hardest]} at {clock.text(at_ns)} with {speeds[hardest]:.2f} m/s{again}",
        tuple(
            Evidence("/contacts", "speed_mps", int(table.stamp_ns[row]), None, f"{name}, {speed:.2f} m/s")
            for row, name, speed in zip(begun[:_MOST_EVIDENCE].tolist(), what, speeds.tolist(), strict=False)
        ),
        "Compare the track with the mission and the avoidance: it came too close.",
    )


def _plots(tilt: TiltSeries | None, findings: Sequence[Finding]) -> Iterator[Plot]:
    if tilt is None:
        return
    marks = tuple(
        Mark(each.at_ns, finding.key, each.until_ns, finding.severity)
        for finding in findings
        for each in finding.evidence
        if each.at_ns is not None
    )
    traces = (Trace("roll", tilt.stamp_ns, tilt.roll_deg), Trace("pitch", tilt.stamp_ns, tilt.pitch_deg))
    yield Plot("attitude", "Roll and pitch", "deg", traces, marks=marks)
