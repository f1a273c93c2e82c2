"""Whether samples come as they should: gaps, stamps that go wrong, times in which nothing was logged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.analyses.sensors.sensor import Sensor
from xitl_cli.logs.gaps import Gap
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Finding, Mark, Plot, Section, Severity, Trace
from xitl_cli.logs.sensing.columns import some
from xitl_cli.logs.sensing.settings import armed_rows
from xitl_cli.logs.timeline.relations import relations
from xitl_cli.logs.timeline.steps import Step

_MISSING_NOTICE = 0.01
_MISSING_WARNING = 0.05
_SAME_NS = 100_000_000
_LONG_S = 0.5
_LEAPT = 0.8
_RATE_APART = 0.05
_GAP_STEP = (
    "Compare with the links and the scheduler at that time; if the sensor itself fell out, check its bus and supply."
)


def timing(found: list[Sensor], instants: Instants) -> Section:
    """Gaps, stamps that go wrong, instances of one message at different rates."""
    findings = _gaps(found, instants)
    for sensor in found:
        findings += _missing(sensor)
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
    return Section("sensors", "Sensors", findings=tuple(findings), plots=_gap_plot(found))


def recording_pauses(log: Log, pause: NDArray[np.int64], instants: Instants) -> tuple[Finding, ...]:
    """One finding for all in which the whole log stood still for a noticeable time."""
    long = pause[(pause[:, 1] - pause[:, 0]) >= int(_LONG_S * 1e9)]
    leapt = [step for relation in relations(log) for step in relation.steps if step.size_s >= _LONG_S]
    long = long[[not any(_is_leap(begin, end, step) for step in leapt) for begin, end in long.tolist()]]
    if not len(long):
        return ()
    lengths_s = (long[:, 1] - long[:, 0]) * 1e-9
    armed = armed_rows(log, long[:, 0])
    times = some([f"{instants.text(int(a))} for {d:.2f} s" for (a, _), d in zip(long, lengths_s, strict=True)])
    sailing = armed is None or bool(armed.any())
    noun = "pause" if len(long) == 1 else "pauses"
    verb, step = (
        "logged",
        (
            "Look at DSF.Dp and the storage (a card that is slow or full), at logging that was stopped, and at the "
            "scheduler: the processor may have stood still."
        ),
    )
    if log.format == "tlog":
        verb, step = "received", "Look at the link then, and at both of its ends."
    return (
        Finding(
            "sensors.recording_pauses",
            Severity.WARNING if sailing and lengths_s.max() >= 1.0 else Severity.NOTICE,
            f"Nothing at all was {verb} for {lengths_s.sum():.2f} s in {len(long)} {noun}: at {times}",
            tuple(Evidence("all messages", None, int(a), int(b)) for a, b in long[:8]),
            step,
        ),
    )


def _long_gaps(sensor: Sensor) -> tuple[Gap, ...]:
    """Those far longer than the period, in the order of time."""
    least_s = max(_LONG_S, 5.0 * sensor.regularity.period_s)
    return tuple(sorted((gap for gap in sensor.gaps.longest(100) if gap.duration_s > least_s), key=_begin))


def _gaps(found: Sequence[Sensor], instants: Instants) -> list[Finding]:
    """One finding for sensors that are missing at the same times: the cause is none of them."""
    groups: list[tuple[list[Sensor], tuple[Gap, ...]]] = []
    for sensor in found:
        if not (long := _long_gaps(sensor)):
            continue
        for group, theirs in groups:
            if len(theirs) == len(long) and all(map(_same, theirs, long)):
                group.append(sensor)
                break
        else:
            groups.append(([sensor], long))
    return [_gap(group, theirs, instants) for group, theirs in groups]


def _gap(group: Sequence[Sensor], long: Sequence[Gap], instants: Instants) -> Finding:
    *names, last = (sensor.name for sensor in group)
    who = f"{', '.join(names)} and {last} are missing together" if names else f"{last} is missing"
    noun = "gap" if len(long) == 1 else "gaps"
    times = some([f"{instants.text(gap.from_ns)} for {gap.duration_s:.2f} s" for gap in long])
    lengths_s = [gap.duration_s for gap in long]
    return Finding(
        "sensors.gap",
        Severity.WARNING if max(lengths_s) >= 1.0 else Severity.NOTICE,
        f"{who} for {sum(lengths_s):.2f} s in {len(long)} {noun}: at {times}",
        tuple(Evidence(one.message, one.field, gap.from_ns, gap.until_ns) for one in group for gap in long[:8]),
        _GAP_STEP,
    )


def _same(one: Gap, other: Gap) -> bool:
    return abs(one.from_ns - other.from_ns) < _SAME_NS and abs(one.until_ns - other.until_ns) < _SAME_NS


def _missing(sensor: Sensor) -> list[Finding]:
    """A share of samples missing that matters, where no long gap tells of it."""
    regular = sensor.regularity
    if _long_gaps(sensor):
        return []
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


def _begin(gap: Gap) -> int:
    return gap.from_ns


def _is_leap(begin_ns: int, end_ns: int, step: Step) -> bool:
    """Whether it was the clock that leapt, and nothing paused."""
    inside = begin_ns <= step.at_ns <= end_ns + round(_LONG_S * 1e9)
    return inside and step.size_s > _LEAPT * (end_ns - begin_ns) * 1e-9


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
