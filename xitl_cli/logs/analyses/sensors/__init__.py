"""Inertial units, magnetometers, barometers and the rest: rates, gaps, values that stick or saturate, health, noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.sensors.agreement import agreement
from xitl_cli.logs.analyses.sensors.noise import noise
from xitl_cli.logs.analyses.sensors.trouble import trouble
from xitl_cli.logs.gaps import Gap, Gaps, Regularity, gaps, regularity
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.sensing.columns import seconds, some, told
from xitl_cli.logs.sensing.holding import Holding, holding
from xitl_cli.logs.sensing.inertial import Inertial, units
from xitl_cli.logs.sensing.pauses import covered, pauses
from xitl_cli.logs.sensing.plain import Plain, sensors
from xitl_cli.logs.sensing.rest import Rest, rest
from xitl_cli.logs.sensing.settings import armed_rows, settings, simulated

_MISSING_NOTICE = 0.01
_MISSING_WARNING = 0.05
_LONG_S = 0.5
_RATE_APART = 0.05
_TITLE = "Sensors"


@dataclass(frozen=True, slots=True)
class Sensor:
    """What every kind of sensor is judged by. values: (N, k). gaps: those that are not pauses of the whole log."""

    name: str
    sort: str
    message: str
    field: str
    stamp_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    regularity: Regularity
    gaps: Gaps
    holding: Holding
    healthy: NDArray[np.bool_] | None
    temperature_degc: NDArray[np.float64] | None
    sensor_rate_hz: float | None


def analyse(log: Log) -> Section | None:
    """None where the log holds no sensor at all and is none of a vehicle's."""
    inertial, plain = units(log), sensors(log)
    if not inertial and not plain:
        if log.format == "mcap":
            return None
        return Section(
            "sensors", _TITLE, lacks=("No sensor is logged; set the bits IMU, COMPASS and RCIN of LOG_BITMASK.",)
        )
    pause = pauses(log)
    still = rest(log, inertial)
    every: list[Inertial | Plain] = [*inertial, *plain]
    found = [sensor for each in every if (sensor := _sensor(each, pause)) is not None]
    armed = {sensor.name: armed_rows(log, sensor.stamp_ns) for sensor in found}
    parts = (
        _timing(found),
        trouble(log, found, inertial, armed),
        agreement(inertial, plain),
        noise(inertial, plain, still, settings(log), simulated(log)),
    )
    return Section(
        "sensors",
        _TITLE,
        facts=(*_facts(found, still, pause), *(fact for part in parts for fact in part.facts)),
        findings=(*_pauses(log, pause), *(finding for part in parts for finding in part.findings)),
        grids=(_grid(found), *(grid for part in parts for grid in part.grids)),
        plots=tuple(plot for part in parts for plot in part.plots),
        lacks=(*_lacks(log, inertial, plain), *(lack for part in parts for lack in part.lacks)),
    )


def _sensor(each: Inertial | Plain, pause: NDArray[np.int64]) -> Sensor | None:
    found = regularity(each.sample_ns)
    if found is None:
        return None
    if isinstance(each, Inertial):
        parts = [part for part in (each.gyro_radps, each.accel_mps2) if part is not None]
        sort, message, field = "inertial unit", each.table.name, (each.gyro_fields or each.accel_fields)[0]
        values, rate_hz = np.concatenate(parts, axis=1), each.gyro_rate_hz or each.accel_rate_hz
    else:
        sort, message, field = each.sort, each.message, each.fields[0]
        values, rate_hz = each.values, None
    return Sensor(
        name=each.name,
        sort=sort,
        message=message,
        field=field,
        stamp_ns=each.stamp_ns,
        values=values,
        regularity=found,
        gaps=_own_gaps(each.stamp_ns, each.sample_ns, found, pause),
        holding=holding(values, found.period_s),
        healthy=each.healthy,
        temperature_degc=each.temperature_degc,
        sensor_rate_hz=rate_hz,
    )


def _own_gaps(
    stamp_ns: NDArray[np.int64], sample_ns: NDArray[np.int64], found: Regularity, pause: NDArray[np.int64]
) -> Gaps:
    """On the log's time, without those in which everything paused."""
    each = gaps(sample_ns, found.period_s)
    from_ns = stamp_ns[each.row]
    until_ns = from_ns + (each.until_ns - each.from_ns)
    own = covered(from_ns, until_ns, pause) < 0.5
    return Gaps(each.row[own], from_ns[own], until_ns[own], each.missing[own])


def _timing(found: list[Sensor]) -> Section:
    """Gaps, stamps that go wrong, instances of one message at different rates."""
    findings: list[Finding] = []
    for sensor in found:
        findings += _gaps(sensor)
        regular = sensor.regularity
        if regular.backward:
            findings.append(
                Finding(
                    "sensors.time_backward",
                    Severity.WARNING,
                    f"{sensor.name}: {regular.backward} stamps go back, by up to {regular.back_s:.3g} s",
                    (Evidence(sensor.message, sensor.field, int(sensor.stamp_ns[0]), int(sensor.stamp_ns[-1])),),
                    "Look for a clock that was set during the run, or a damaged part of the log.",
                )
            )
    by_message: dict[str, list[Sensor]] = {}
    for sensor in found:
        by_message.setdefault(sensor.message, []).append(sensor)
    for message, group in by_message.items():
        rates = [sensor.regularity.rate_hz for sensor in group]
        if len(group) > 1 and max(rates) > min(rates) * (1.0 + _RATE_APART):
            told_rates = ", ".join(f"{s.name} {s.regularity.rate_hz:.4g} Hz" for s in group)
            findings.append(
                Finding(
                    "sensors.rates_differ",
                    Severity.NOTICE,
                    f"Instances of {message} are logged at different rates: {told_rates}",
                    tuple(Evidence(message, s.field, int(s.stamp_ns[0])) for s in group),
                    "Check that each of them is set to the rate it should have.",
                )
            )
    return Section("sensors", _TITLE, findings=tuple(findings), plots=_gap_plot(found))


def _gaps(sensor: Sensor) -> list[Finding]:
    """A gap that is far longer than the period, or a share of samples missing that matters."""
    regular = sensor.regularity
    long = [gap for gap in sensor.gaps.longest(100) if gap.duration_s > max(_LONG_S, 5.0 * regular.period_s)]
    if long:
        whole_s = sum(gap.duration_s for gap in long)
        times = some([f"{seconds(gap.from_ns)} for {gap.duration_s:.2f} s" for gap in sorted(long, key=_begin)])
        noun = "gap" if len(long) == 1 else "gaps"
        sentence = (
            f"{sensor.name} is missing for {whole_s:.2f} s in {len(long)} {noun} "
            f"(period {regular.period_s * 1e3:.4g} ms): at {times}"
        )
        evidence = tuple(Evidence(sensor.message, sensor.field, gap.from_ns, gap.until_ns) for gap in long[:8])
        severity = Severity.WARNING if long[0].duration_s >= 1.0 else Severity.NOTICE
        return [Finding("sensors.gap", severity, sentence, evidence, _GAP_STEP)]
    # Not more than the whole record lacks at this rate: stamps that come unevenly have long steps and short ones.
    lacking = round((regular.rows - 1) * (regular.mean_period_s / regular.period_s - 1.0))
    missing = min(int(sensor.gaps.missing.sum()), lacking)
    share = missing / (regular.rows + missing) if missing > 0 else 0.0
    if share < _MISSING_NOTICE:
        return []
    longest_s = sensor.gaps.longest(1)[0].duration_s
    return [
        Finding(
            "sensors.missing",
            Severity.WARNING if share >= _MISSING_WARNING else Severity.NOTICE,
            f"{sensor.name}: {100.0 * share:.1f} % of the samples that {regular.rate_hz:.4g} Hz ask for are missing, "
            f"in {len(sensor.gaps)} gaps of up to {longest_s:.3g} s",
            (Evidence(sensor.message, sensor.field, int(sensor.gaps.from_ns[0]), int(sensor.gaps.until_ns[-1])),),
            _GAP_STEP,
        )
    ]


_GAP_STEP = (
    "Compare with the links and the scheduler at that time; if the sensor itself fell out, check its bus and supply."
)


def _begin(gap: Gap) -> int:
    return gap.from_ns


def _gap_plot(found: list[Sensor]) -> tuple[Plot, ...]:
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


def _pauses(log: Log, pause: NDArray[np.int64]) -> tuple[Finding, ...]:
    """One finding for all in which the whole log stood still for a noticeable time."""
    long = pause[(pause[:, 1] - pause[:, 0]) >= int(_LONG_S * 1e9)]
    if not len(long):
        return ()
    lengths_s = (long[:, 1] - long[:, 0]) * 1e-9
    armed = armed_rows(log, long[:, 0])
    times = some([f"{seconds(int(a))} for {d:.2f} s" for (a, _), d in zip(long, lengths_s, strict=True)])
    sailing = armed is None or bool(armed.any())
    return (
        Finding(
            "sensors.recording_pauses",
            Severity.WARNING if sailing and lengths_s.max() >= 1.0 else Severity.NOTICE,
            f"Nothing at all was logged for {lengths_s.sum():.2f} s in {len(long)} pauses: at {times}",
            tuple(Evidence("all messages", None, int(a), int(b)) for a, b in long[:8]),
            "Look at DSF.Dp and the storage (a card that is slow or full), at logging that was stopped, and at the "
            "scheduler: the processor may have stood still.",
        ),
    )


def _facts(found: list[Sensor], still: Rest, pause: NDArray[np.int64]) -> tuple[Fact, ...]:
    paused_s = float((pause[:, 1] - pause[:, 0]).sum()) * 1e-9
    return (
        Fact("sensors", "Sensors", len(found)),
        Fact("longest_rest_s", "Longest stretch at rest", told(still.longest_s), "s"),
        Fact("recording_paused_s", "Nothing logged at all", told(paused_s), "s"),
    )


def _grid(found: list[Sensor]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for sensor in found:
        regular = sensor.regularity
        unwell = None if sensor.healthy is None else int(np.count_nonzero(~sensor.healthy))
        coldest, warmest = _span(sensor.temperature_degc)
        rows.append(
            (
                sensor.name,
                sensor.sort,
                regular.rows,
                told(regular.rate_hz),
                told(sensor.sensor_rate_hz),
                told(regular.jitter_s * 1e3, 3),
                regular.gaps,
                regular.long_gaps,
                told(regular.longest_gap_s, 3),
                told(100.0 * sensor.holding.repeated, 3),
                unwell,
                coldest,
                warmest,
            )
        )
    columns = (
        "sensor", "sort", "rows", "logged Hz", "sampled Hz", "jitter ms", "gaps", "long gaps", "longest s",
        "repeated %", "unhealthy rows", "from °C", "to °C",
    )  # fmt: skip
    return Grid("sensors", "Rates, gaps, health", columns, tuple(rows))


def _span(temperature_degc: NDArray[np.float64] | None) -> tuple[float | None, float | None]:
    if temperature_degc is None:
        return None, None
    known = temperature_degc[np.isfinite(temperature_degc) & (np.abs(temperature_degc) < 300.0)]
    return (told(float(known.min())), told(float(known.max()))) if len(known) and known.any() else (None, None)


def _lacks(log: Log, inertial: list[Inertial], plain: list[Plain]) -> tuple[str, ...]:
    sorts = {each.sort for each in plain}
    missing: list[str] = []
    if log.format != "dataflash":
        return ()  # which sensors a recording or telemetry carries is its own choice
    if not inertial:
        missing.append("No inertial unit is logged; set the bit IMU of LOG_BITMASK.")
    if "magnetometer" not in sorts:
        missing.append("No magnetometer is logged; set the bit COMPASS of LOG_BITMASK if there is one.")
    if "barometer" not in sorts:
        missing.append("No barometer is logged.")
    return tuple(missing)
