"""Sensor faults: gaps, wrong stamps, stuck or saturated values, rows that the autopilot marks as unhealthy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.fit import clock_relations
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Finding, Mark, Plot, Section, Severity, Trace
from xitl_cli.logs.model.table import Flags, Floats, Stamps
from xitl_cli.logs.model.text import plural
from xitl_cli.logs.signals import Series, ground_speed, yaw_rate
from xitl_cli.logs.signals import armed as log_armed
from xitl_cli.logs.signals.gaps import Gap, Gaps, Regularity, gaps, regularity
from xitl_cli.logs.signals.sensors import InertialUnit, SensorSeries
from xitl_cli.logs.signals.series import listed, numbers
from xitl_cli.logs.signals.spans import HeldRows, HoldStatistics, covered_share, find_holds, inside, runs, spells
from xitl_cli.logs.signals.states import armed_rows
from xitl_cli.plugins.logs.analyses.arming import shut_down


@dataclass(frozen=True, slots=True)
class JudgedSensor:
    """Properties by which any sensor is judged."""

    name: str
    sort: str
    message: str
    field: str
    stamp_ns: Stamps
    values: Floats
    """(N, k)"""
    regularity: Regularity
    gaps: Gaps
    """Without pauses of the whole log."""
    clock_jumps: tuple[tuple[int, float], ...]
    """Of the sensor's own clock (`SampleTimes.jumps`)."""
    holding: HoldStatistics
    healthy: Flags | None
    temperature_degc: Floats | None
    sensor_rate_hz: float | None


def judged_sensor(each: InertialUnit | SensorSeries, pause: Stamps, log: Log) -> JudgedSensor | None:
    found = regularity(each.sample_ns)
    if found is None:
        return None
    if isinstance(each, InertialUnit):
        parts = [part for part in (each.gyro_radps, each.accel_mps2) if part is not None]
        sort, message, field = "inertial unit", each.table.name, (each.gyro_fields or each.accel_fields)[0]
        values, rate_hz = np.concatenate(parts, axis=1), each.gyro_rate_hz or each.accel_rate_hz
    else:
        sort, message, field = each.sort, each.message, each.fields[0]
        values, rate_hz = each.values, None
    # The mean of equal pressures in single precision is that number or one of its neighbours.
    resolution = 4.0 * float(np.spacing(np.float32(np.nanmedian(np.abs(values))))) if sort == "barometer" else 0.0
    return JudgedSensor(
        name=each.name,
        sort=sort,
        message=message,
        field=field,
        stamp_ns=each.stamp_ns,
        values=values,
        regularity=found,
        gaps=_own_gaps(log, each.stamp_ns, each.sample_ns, found, pause),
        clock_jumps=each.times.jumps,
        holding=find_holds(values, found.period_s, resolution=resolution),
        healthy=each.healthy,
        temperature_degc=each.temperature_degc,
        sensor_rate_hz=rate_hz,
    )


def _own_gaps(log: Log, stamp_ns: Stamps, sample_ns: Stamps, found: Regularity, pause: Stamps) -> Gaps:
    """Gaps on the log's time, without times in which everything paused or logging was off."""
    each = gaps(sample_ns, found.period_s, bursts=found.bursts)
    from_ns = stamp_ns[each.row]
    until_ns = from_ns + (each.until_ns - each.from_ns)
    own = covered_share(from_ns, until_ns, pause) < 0.5
    long = own & (until_ns - from_ns > round(_LONG_S * 1e9))
    own[long] = ~switched_off(log, np.stack([from_ns[long], until_ns[long]], axis=1))
    return Gaps(each.row[own], from_ns[own], until_ns[own], each.missing[own])


_MISSING_NOTICE = 0.01
_FEWEST_MISSING = 5
_MISSING_WARNING = 0.05
_SAME_NS = 100_000_000
_LONG_S = 0.5
_MANY = 20
_LEAPT = 0.8
_RATE_APART = 0.05
_GAP_STEP = (
    "Compare with the links and the scheduler at that time; if the sensor itself failed, check its bus and supply."
)


def timing_section(found: list[JudgedSensor], clock: LogClock, *, telemetry: bool) -> Section:
    """Gaps, wrong stamps, and different rates of instances of one message."""
    # Telemetry is thinned out as its link allows; the links section reports losses.
    # One finding for all sensors on the clock that was set, because no sample is missing.
    clock_jumps: list[Finding] = []
    jumped = [sensor for sensor in found if sensor.clock_jumps]
    if jumped:
        at_ns, size_s = max(jumped[0].clock_jumps, key=lambda jump: abs(jump[1]))
        many = len(jumped[0].clock_jumps)
        again = "" if many == 1 else f", the largest of {many}"
        *names, last = (sensor.name for sensor in jumped)
        clock_jumps.append(
            Finding.notice(
                "sensors.clock_step",
                f"The clock that stamps {', '.join(names)}{' and ' if names else ''}{last} jumped by "
                f"{size_s:+.4g} s at {clock.text(at_ns)}{again}; no sample is missing there",
                tuple(
                    Evidence(sensor.message, None, jump[0], None, f"{jump[1]:+.4g} s")
                    for sensor in jumped[:4]
                    for jump in sensor.clock_jumps[:4]
                ),
                "Use the log's own stamps for times across it. A restart, GPS or a ground station sets a clock.",
            )
        )
    findings = (
        *_gaps(found, clock),
        *(one for sensor in found for one in _stamp_findings(sensor, telemetry)),
        *clock_jumps,
        *_rates(found),
    )
    return Section("sensors", "Sensors", findings=findings, plots=_gap_plot(found))


def _stamp_findings(sensor: JudgedSensor, telemetry: bool) -> Iterator[Finding]:
    if not telemetry:
        yield from _missing(sensor)
    regular = sensor.regularity
    if regular.backward:
        yield Finding.warning(
            "sensors.time_backward",
            f"{sensor.name}: {regular.backward} stamps go back, by up to {regular.back_s:.3g} s",
            (Evidence(sensor.message, sensor.field, int(sensor.stamp_ns[0]), int(sensor.stamp_ns[-1])),),
            "Look for a clock that was set during the run, or for a damaged part of the log.",
        )


def _rates(found: list[JudgedSensor]) -> Iterator[Finding]:
    by_message: dict[str, list[JudgedSensor]] = {}
    for sensor in found:
        by_message.setdefault(sensor.message, []).append(sensor)
    for message, group in by_message.items():
        rates = [sensor.regularity.rate_hz for sensor in group]
        if len(group) > 1 and max(rates) > min(rates) * (1.0 + _RATE_APART):
            told_rates = ", ".join(f"{s.name} {s.regularity.rate_hz:.4g} Hz" for s in group)
            yield Finding.notice(
                "sensors.rates_differ",
                f"Instances of {message} are logged at different rates: {told_rates}",
                tuple(Evidence(message, s.field, int(s.stamp_ns[0])) for s in group),
                "Check that each of them is set to the rate it should have.",
            )


def recording_pauses(log: Log, pause: Stamps, clock: LogClock) -> tuple[Finding, ...]:
    """One finding for all noticeable pauses of the whole log."""
    long = pause[(pause[:, 1] - pause[:, 0]) >= int(_LONG_S * 1e9)]
    leapt = [step for relation in clock_relations(log) for step in relation.steps if step.size_s >= _LONG_S]
    # A clock that jumped makes no pause.
    long = long[
        [
            not any(
                begin_ns <= step.at_ns <= end_ns + round(_LONG_S * 1e9)
                and step.size_s > _LEAPT * (end_ns - begin_ns) * 1e-9
                for step in leapt
            )
            for begin_ns, end_ns in long.tolist()
        ]
    ]
    long = long[~switched_off(log, long)]
    lengths_s = (long[:, 1] - long[:, 0]) * 1e-9
    whole_s = 0.0 if log.span_ns is None else (log.span_ns[1] - log.span_ns[0]) * 1e-9
    if len(long) >= _MANY and lengths_s.sum() > 0.5 * whole_s:  # a log with bursts always pauses
        apart = lengths_s > 3.0 * float(np.median(lengths_s))
        long, lengths_s = long[apart], lengths_s[apart]
    if not len(long):
        return ()
    armed = armed_rows(log, long[:, 0])
    times = listed([f"{clock.text(int(a))} for {d:.2f} s" for (a, _), d in zip(long, lengths_s, strict=True)])
    sailing = armed is None or bool(armed.any())
    noun = "pause" if len(long) == 1 else "pauses"
    verb, step = (
        "logged",
        (
            "Look at DSF.Dp and the storage (a card that is slow or full), at logging that was stopped, and at the "
            "scheduler: the processor may have stopped. ArduPilot's main loop also waits for an IMU that sends nothing."
        ),
    )
    if log.format == "tlog":
        verb, step = "received", "Look at the link then, and at both of its ends."
    return (
        Finding(
            "sensors.recording_pauses",
            Severity.WARNING if sailing and lengths_s.max() >= 1.0 else Severity.NOTICE,
            f"Nothing was {verb} for {lengths_s.sum():.2f} s in {len(long)} {noun}: at {times}",
            tuple(Evidence("all messages", None, int(a), int(b)) for a, b in long[:8]),
            step,
        ),
    )


_STOPS_AFTER_NS = 20_000_000_000  # LOG_DISARMED 0: fifteen seconds after disarming (HAL_LOGGER_ARM_PERSIST)
_STARTS_BEFORE_NS = 5_000_000_000
_LATEST_STAMP_NS = 1_000_000_000
_FARTHEST_NS = 1 << 61  # seventy years, so that no difference overflows


def switched_off(log: Log, pause: Stamps) -> Flags:
    """(N,) True for pauses (N, 2) that began with disarming and ended with arming: logging was off in between."""
    spans = [] if log.format != "dataflash" else log_armed(log)
    begin, end = np.clip(pause, -_FARTHEST_NS, _FARTHEST_NS).T
    disarmed, at_end, at_begin, between, twice = np.zeros((5, len(pause)), dtype=np.bool_)
    ends = {span.until_ns for span in spans}
    for span in spans:
        from_ns, until_ns = min(span.from_ns, _FARTHEST_NS), min(span.until_ns, _FARTHEST_NS)
        disarmed |= (begin - _STOPS_AFTER_NS <= until_ns) & (until_ns <= begin + _LATEST_STAMP_NS)
        near_end = np.abs(from_ns - end) <= _STARTS_BEFORE_NS
        at_end |= near_end
        # Events without a time get the stamp of the previous row, and so does the arming that ends a pause.
        armed = (until_ns > begin + _LATEST_STAMP_NS) & (from_ns < end)
        near_begin = np.abs(from_ns - begin) <= _LATEST_STAMP_NS
        at_begin |= armed & near_begin
        between |= armed & ~near_begin & (from_ns < end - _STARTS_BEFORE_NS)
        # If the disarming was not logged, a second arming implies it.
        if span.from_ns in ends:
            twice |= near_end
    return twice | (disarmed & (at_end | at_begin) & ~between)


def _long_gaps(sensor: JudgedSensor) -> tuple[Gap, ...]:
    """Gaps far longer than the period, in order of time."""
    least_s = max(_LONG_S, 5.0 * sensor.regularity.period_s)
    return tuple(
        sorted((gap for gap in sensor.gaps.longest(100) if gap.duration_s > least_s), key=lambda gap: gap.from_ns)
    )


def _gaps(sensors: Sequence[JudgedSensor], clock: LogClock) -> Iterator[Finding]:
    """One finding for sensors that are missing at the same times, because none of them is the cause."""
    groups: list[tuple[list[JudgedSensor], tuple[Gap, ...]]] = []
    for sensor in sensors:
        if not (long := _long_gaps(sensor)):
            continue
        for group, common in groups:
            if len(common) == len(long) and all(
                abs(gap.from_ns - own.from_ns) < _SAME_NS and abs(gap.until_ns - own.until_ns) < _SAME_NS
                for gap, own in zip(common, long, strict=True)
            ):
                group.append(sensor)
                break
        else:
            groups.append(([sensor], long))
    for group, common in groups:
        *names, last = (sensor.name for sensor in group)
        who = f"{', '.join(names)} and {last} are missing together" if names else f"{last} is missing"
        times = listed([f"{clock.text(gap.from_ns)} for {gap.duration_s:.2f} s" for gap in common])
        lengths_s = [gap.duration_s for gap in common]
        yield Finding(
            "sensors.gap",
            Severity.WARNING if max(lengths_s) >= 1.0 else Severity.NOTICE,
            f"{who} for {sum(lengths_s):.2f} s in {plural(len(common), 'gap')}: at {times}",
            tuple(
                Evidence(sensor.message, sensor.field, gap.from_ns, gap.until_ns)
                for sensor in group
                for gap in common[:8]
            ),
            _GAP_STEP,
        )


def _missing(sensor: JudgedSensor) -> Iterator[Finding]:
    """A relevant share of missing samples, if no long gap reports it."""
    regular = sensor.regularity
    if _long_gaps(sensor):
        return
    missing = int(sensor.gaps.missing.sum())
    share = missing / (regular.rows + missing) if missing > 0 else 0.0
    if share < _MISSING_NOTICE or missing < _FEWEST_MISSING:
        return
    longest_s = sensor.gaps.longest(1)[0].duration_s
    yield Finding(
        "sensors.missing",
        Severity.WARNING if share >= _MISSING_WARNING else Severity.NOTICE,
        f"{sensor.name}: {100.0 * share:.1f} % of the samples that {regular.rate_hz:.4g} Hz need are "
        f"missing, in {len(sensor.gaps)} gaps of up to {longest_s:.3g} s",
        tuple(
            Evidence(sensor.message, sensor.field, begin_ns, end_ns) for begin_ns, end_ns in _gap_spells(sensor.gaps)
        ),
        _GAP_STEP,
    )


def _gap_spells(found: Gaps) -> list[tuple[int, int]]:
    """Spells of gaps that are less than two seconds apart: up to eight, the longest, in order of time."""
    apart = np.flatnonzero(found.from_ns[1:] - found.until_ns[:-1] > _SPELL_NS)
    begins, ends = found.from_ns[np.append(0, apart + 1)].tolist(), found.until_ns[np.append(apart, -1)].tolist()
    return sorted(sorted(zip(begins, ends, strict=True), key=lambda span: span[0] - span[1])[:8])


def _gap_plot(found: list[JudgedSensor]) -> tuple[Plot, ...]:
    """Steps between samples of the sensors that have gaps, on a common axis."""
    traces, marks = [], []
    for sensor in found:
        longest = sensor.gaps.longest()
        if not longest or longest[0].duration_s < 3.0 * sensor.regularity.period_s:
            continue
        steps_ms = np.diff(np.maximum.accumulate(sensor.stamp_ns)).astype(np.float64) * 1e-6
        traces.append(Trace(sensor.name, sensor.stamp_ns[1:], steps_ms, "points"))
        marks += [
            Mark(gap.from_ns, f"{sensor.name} missing", gap.until_ns, Severity.WARNING)
            for gap in longest
            if gap.duration_s >= 1.0
        ]
    if not traces:
        return ()
    return (Plot("sensor_steps", "Time from one sample to the next", "ms", tuple(traces[:8]), marks=tuple(marks[:40])),)


_STICKS = {"inertial unit", "magnetometer", "barometer"}
_TURN_DEG = 5.0
_FAST_TURN_DEGPS = 3.0
_MOVING_MPS = 0.3
_UNEXPLAINED_S = 5.0
_USUAL = 1.5
"""Mean length of the runs of equal rows of a sensor with noise."""
_GYRO_LEAST_RADPS = 2.0  # 115 deg/s: the smallest range on the market is 125
_ACCEL_LEAST_MPS2 = 18.0  # the smallest range is 2 g
_RATE_DROP = 0.8
_AT_ONCE_NS = 1_000_000_000
_STUCK = "sensors.stuck"
_SPELL_NS = 2_000_000_000


def trouble_section(
    log: Log,
    found: Sequence[JudgedSensor],
    inertial: Sequence[InertialUnit],
    armed: Mapping[str, Flags | None],
    clock: LogClock,
) -> Section:
    turning, speed = yaw_rate(log), ground_speed(log)
    by_sensor: dict[str, list[Finding]] = {}
    for sensor in found:
        stuck = _stuck(log, sensor, [each for each in found if each is not sensor], turning, speed, clock)
        by_sensor[sensor.name] = _with_health(stuck, sensor, armed.get(sensor.name), clock)
    units = [finding for unit in inertial for finding in (*_saturated(unit, clock), *_unit_errors(unit, clock))]
    # All findings. Sensors that stopped within a second share one finding, because none of them is the cause.
    every = tuple(finding for findings in by_sensor.values() for finding in findings)
    stopped = {name: stuck for name, findings in by_sensor.items() for stuck in findings if stuck.key == _STUCK}
    begins = [
        min((evidence.at_ns for evidence in stuck.evidence if evidence.at_ns is not None), default=0)
        for stuck in stopped.values()
    ]
    if len(stopped) < 2 or max(begins) - min(begins) > _AT_ONCE_NS:
        together = every
    else:
        *names, last = stopped
        one = Finding(
            "sensors.stopped_together",
            max(finding.severity for finding in stopped.values()),
            f"{', '.join(names)} and {last} stopped together at {clock.text(min(begins))}, while the vehicle moved: "
            "each repeats one value from then on",
            tuple(evidence for finding in stopped.values() for evidence in finding.evidence),
            "Look at their common source: a link, a bus or a process.",
        )
        together = (one, *(finding for finding in every if finding.key != _STUCK))
    return Section("sensors", "Sensors", findings=(*together, *units))


def _with_health(stuck: list[Finding], sensor: JudgedSensor, armed: Flags | None, clock: LogClock) -> list[Finding]:
    """Findings on a sensor that stopped, and on its health flag. Unhealthy spells during the stop belong to the
    stop."""
    if sensor.healthy is None or sensor.healthy.all():
        return stuck
    bad = ~sensor.healthy
    if not (stuck and stuck[0].key == _STUCK):
        return [*stuck, *_unwell(sensor, bad, armed, clock)]
    stopped = [
        (one.at_ns, one.until_ns) for one in stuck[0].evidence if one.at_ns is not None and one.until_ns is not None
    ]
    while_stopped = inside(sensor.stamp_ns, [(begin, end + _AT_ONCE_NS) for begin, end in stopped])
    # A flag that was set before the sensor stopped has another reason.
    spans = spells(sensor.stamp_ns, bad)
    before = [span for span in spans if not any(begin <= span[0] <= end + _AT_ONCE_NS for begin, end in stopped)]
    elsewhere = bad & inside(sensor.stamp_ns, before)
    then = bad & while_stopped & ~elsewhere
    if not then.any():
        return [*stuck, *_unwell(sensor, bad, armed, clock)]
    sentence = f"{stuck[0].sentence}; the autopilot reported it as unhealthy then"
    evidence = (*stuck[0].evidence, *_health_evidence(sensor, then))
    one = replace(stuck[0], sentence=sentence, evidence=evidence)
    return [one, *stuck[1:], *_unwell(sensor, elsewhere, armed, clock)]


def _stuck(
    log: Log,
    sensor: JudgedSensor,
    others: Sequence[JudgedSensor],
    turning: Series | None,
    speed: Series | None,
    clock: LogClock,
) -> list[Finding]:
    """Constant values for long are a fault if the vehicle moved in that time, or if the sensor usually shows noise."""
    if sensor.sort not in _STICKS or not sensor.holding.holds:
        return []
    certain: list[tuple[HeldRows, str]] = []
    doubtful: list[HeldRows] = []
    for hold in sensor.holding.holds:
        from_ns, until_ns = (int(sensor.stamp_ns[row]) for row in (hold.first, hold.last))
        if _shared(sensor, from_ns, until_ns, others) or shut_down(log, from_ns, until_ns):
            continue
        why = _moved(sensor, from_ns, until_ns, turning, speed)
        if why:
            certain.append((hold, why))
        elif (
            sensor.sort == "inertial unit"
            and until_ns - from_ns >= _UNEXPLAINED_S * 1e9
            and sensor.holding.usual < _USUAL
        ):
            doubtful.append(hold)
    findings = []
    if certain:
        findings.append(
            Finding.warning(
                _STUCK,
                f"{sensor.name} shows one and the same value {_when(sensor, [hold for hold, _ in certain], clock)}, "
                f"while {certain[0][1]}",
                _evidence(sensor, [hold for hold, _ in certain]),
                "Check the sensor's bus and driver: a device that no longer answers may leave its last value.",
            )
        )
    if doubtful:
        findings.append(
            Finding.notice(
                "sensors.still",
                f"{sensor.name} shows one and the same value {_when(sensor, doubtful, clock)}, but at other "
                "times no two samples are equal",
                _evidence(sensor, doubtful),
                "This is normal for a simulated sensor without noise at rest. A real one is stuck.",
            )
        )
    return findings


def _shared(sensor: JudgedSensor, from_ns: int, until_ns: int, others: Sequence[JudgedSensor]) -> bool:
    """Whether all other sensors of the sort were constant too for most of this time: then nothing moved."""
    alike = [each for each in others if each.sort == sensor.sort == "magnetometer"]
    for each in alike:
        spans = ((int(each.stamp_ns[hold.first]), int(each.stamp_ns[hold.last])) for hold in each.holding.holds)
        if not any(min(b, until_ns) - max(a, from_ns) > 0.8 * (until_ns - from_ns) for a, b in spans):
            return False
    return bool(alike)


def _moved(sensor: JudgedSensor, from_ns: int, until_ns: int, turning: Series | None, speed: Series | None) -> str:
    """Motion that contradicts a constant value, as the end of a sentence; "" if there is none.

    Motion does not change the value of a barometer, but its noise does: one that never repeats a value does not repeat
    it for seconds. A simulated one without noise does at rest.

    Turns are those of the gyroscope, because a heading changes without a turn while the estimator searches for it.
    """
    if turning is not None and sensor.sort == "magnetometer":
        # Range of the heading (deg), from the rate without its median. A slow median may be a bias; a fast
        # one is kept.
        inside = (turning.stamp_ns >= from_ns) & (turning.stamp_ns <= until_ns)
        if np.count_nonzero(inside) < 3:
            turned_deg = 0.0
        else:
            rates, stamps = turning.values[inside], turning.stamp_ns[inside]
            usual = float(np.median(rates))
            if abs(usual) < _FAST_TURN_DEGPS:
                rates = rates - usual
            turned_deg = float(np.ptp(np.cumsum(rates[1:] * np.diff(stamps) * 1e-9)))
        if turned_deg > _TURN_DEG:
            return f"the vehicle turned by {turned_deg:.0f}°"
    noisy = sensor.sort == "barometer" and sensor.holding.usual < _USUAL and until_ns - from_ns >= _UNEXPLAINED_S * 1e9
    if speed is not None and (sensor.sort == "inertial unit" or noisy):
        inside = (speed.stamp_ns >= from_ns) & (speed.stamp_ns <= until_ns)
        if inside.any() and (fast := float(np.median(speed.values[inside]))) > _MOVING_MPS:
            return f"the vehicle made {fast:.2g} m/s"
    return ""


def _when(sensor: JudgedSensor, holds: list[HeldRows], clock: LogClock) -> str:
    spans = [
        f"from {clock.text(int(sensor.stamp_ns[hold.first]))} for "
        f"{(int(sensor.stamp_ns[hold.last]) - int(sensor.stamp_ns[hold.first])) * 1e-9:.1f} s"
        for hold in holds
    ]
    return listed(spans)


def _evidence(sensor: JudgedSensor, holds: list[HeldRows]) -> tuple[Evidence, ...]:
    return tuple(
        Evidence(sensor.message, sensor.field, int(sensor.stamp_ns[hold.first]), int(sensor.stamp_ns[hold.last]))
        for hold in holds[:8]
    )


def _health_evidence(sensor: JudgedSensor, bad: Flags) -> tuple[Evidence, ...]:
    return tuple(Evidence(sensor.message, "health", a, b, "0") for a, b in spells(sensor.stamp_ns, bad))


def _unwell(sensor: JudgedSensor, bad: Flags, armed: Flags | None, clock: LogClock) -> list[Finding]:
    """Spells in which the autopilot's own flag is unhealthy. bad: (N,)."""
    if not bad.any():
        return []
    count, whole = int(np.count_nonzero(bad)), len(bad)
    times = listed([f"{clock.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b in spells(sensor.stamp_ns, bad)])
    sailing = bad if armed is None else bad & armed
    when = "in every row" if count == whole else f"in {count} of {whole} rows, at {times}"
    return [
        Finding(
            "sensors.unhealthy",
            Severity.WARNING if sailing.any() else Severity.NOTICE,
            f"{sensor.name} was unhealthy according to the autopilot {when}"
            + ("" if sailing.any() or armed is None else ", only while disarmed"),
            _health_evidence(sensor, bad),
            "Look for errors and gaps at this time. Disable a sensor that is not fitted.",
        )
    ]


def _saturated(unit: InertialUnit, clock: LogClock) -> Iterator[Finding]:
    for values, fields, least, what, measure in (
        (unit.gyro_radps, unit.gyro_fields, _GYRO_LEAST_RADPS, "gyroscope", "rad/s"),
        (unit.accel_mps2, unit.accel_fields, _ACCEL_LEAST_MPS2, "accelerometer", "m/s²"),
    ):
        if values is None:
            continue
        for axis in range(3):
            found = saturation(values[:, axis], least)
            if found is None:
                continue
            at_ns, until_ns = int(unit.stamp_ns[found.first]), int(unit.stamp_ns[found.last])
            field = fields[axis] if len(fields) == 3 else f"{fields[0]}[{axis}]"
            yield Finding.warning(
                "sensors.saturated",
                f"{unit.name}: the {what} is at the end of its range, {found.limit:.4g} {measure} on {field}, in "
                f"{found.rows} samples, longest from {clock.text(at_ns)} for {(until_ns - at_ns) * 1e-9:.3g} s",
                (Evidence(unit.table.name, field, at_ns, until_ns, f"{found.limit:.4g}"),),
                "Damp the mounting or choose a larger range: the estimator does not get values beyond the range.",
            )


def _unit_errors(unit: InertialUnit, clock: LogClock) -> Iterator[Finding]:
    """Error counters that increase, and a measurement rate that falls."""
    for field, what in (("EG", "gyroscope"), ("EA", "accelerometer")):
        counts = numbers(unit.table, field, raw=True)
        if counts is None or len(counts) < 2:
            continue
        rises = np.flatnonzero(np.diff(counts) > 0)
        if len(rises):
            grown = int(counts[rises + 1].sum() - counts[rises].sum())
            yield Finding.warning(
                "sensors.errors",
                f"{unit.name}: the {what} driver counted {grown} errors, the first at "
                f"{clock.text(int(unit.stamp_ns[rises[0] + 1]))}",
                (Evidence(unit.table.name, field, int(unit.stamp_ns[rises[0] + 1]), None, str(grown)),),
                "Check the bus of the sensor (wiring, clock rate, supply).",
            )
    for field in ("GHz", "AHz"):
        rates = numbers(unit.table, field)
        if rates is None or not (rates > 0.0).any():
            continue
        usual = float(np.median(rates[rates > 0.0]))
        low = np.flatnonzero(rates < _RATE_DROP * usual)
        low = low[unit.stamp_ns[low] > unit.stamp_ns[0] + 5_000_000_000]  # the rate is measured since the start
        if len(low):
            at_ns = int(unit.stamp_ns[low[int(np.argmin(rates[low]))]])
            yield Finding.warning(
                "sensors.slow",
                f"{unit.name}: the measurement rate fell from {usual:.0f} Hz to {rates[low].min():.0f} Hz at "
                f"{clock.text(at_ns)}",
                (Evidence(unit.table.name, field, at_ns, None, f"{rates[low].min():.0f}"),),
                "The sensor's thread did not run, or its bus was blocked. Look at the scheduler then.",
            )


@dataclass(frozen=True, slots=True)
class Saturation:
    """A limit that a signal does not exceed."""

    limit: float
    rows: int
    """Number of rows at the limit."""
    first: int
    """First row of the longest run at the limit."""
    last: int
    """Last row of that run."""


def saturation(values: Floats, least: float) -> Saturation | None:
    """Saturation of a signal (N,): it repeatedly stops at one largest magnitude, for three consecutive rows.

    least: smaller magnitudes are not the end of a range.
    """
    magnitude = np.abs(values)
    if not len(magnitude) or not np.isfinite(magnitude).any():
        return None
    limit = float(np.nanmax(magnitude))
    if limit < least:
        return None
    # A range may differ by one step of the converter between both sides.
    at_limit = magnitude >= limit * (1.0 - 1e-4)
    count = int(np.count_nonzero(at_limit))
    begin, after = max(runs(at_limit), key=lambda run: run[1] - run[0])
    if after - begin < 3 or count > 0.9 * len(magnitude):
        return None
    return Saturation(limit, count, begin, after - 1)
