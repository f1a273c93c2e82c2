"""Outputs: what each drives, how long it was at the end of its range, whether port and starboard share the work."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.analyses.radio.output import Output, output_of
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.sensing.columns import numbers, told
from xitl_cli.logs.signals import Series
from xitl_cli.logs.words.outputs import PORT_THROTTLE, STARBOARD_THROTTLE, THROTTLE

_TITLE = "Outputs"
_AT_LIMIT = 0.995  # of the way from trim to the end
_NOTICE_SHARE, _NOTICE_S = 0.05, 3.0
_WARNING_SHARE, _WARNING_S = 0.25, 10.0
_UNEVEN = 0.15
_SHORT_MPS, _SHORT_S = 0.3, 5.0
_SWING, _SWINGS_HZ = 0.2, 1.5
_STEERING_END = 4500.0


def drives(log: Log, driven: Mapping[int, Series], parameters: Mapping[str, float], instants: Instants) -> Section:
    if not driven:
        lack = "No outputs are logged; set the bit RCOUT of LOG_BITMASK."
        return Section("radio", _TITLE, lacks=(lack,))
    found = [
        output for channel, each in driven.items() if (output := output_of(log, channel, each, parameters)) is not None
    ]
    findings = [finding for output in found for finding in (*_saturated(output, instants), *_swinging(output))]
    findings += _uneven(found)
    findings += _too_slow(log, found, instants)
    lacks = []
    if any(output.series.unit == "us" for output in found) and not any(output.function for output in found):
        lacks.append(
            "What the outputs drive is not known: the log has no SERVOn_FUNCTION; their ends are taken as 1100 and "
            "1900 µs, or 1000 and 2000 µs where pulses go beyond."
        )
    return Section(
        "radio",
        _TITLE,
        facts=(Fact("outputs", "Outputs in use", len(found)), *_steering(log)),
        findings=tuple(findings),
        grids=(_grid(found),) if found else (),
        plots=_plots(found, findings),
        lacks=tuple(lacks),
    )


def _runs(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(np.int8)))
    return list(zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True))


def _longest(output: Output, on: NDArray[np.bool_]) -> tuple[int, int]:
    """From and until (ns) of the longest stretch; a row lasts until the next one."""
    stamps = output.series.stamp_ns
    spans = [(int(stamps[a]), int(stamps[min(b, len(stamps) - 1)])) for a, b in _runs(on)]
    return max(spans, key=lambda span: span[1] - span[0], default=(0, 0))


def _at_limit(output: Output) -> NDArray[np.bool_]:
    limit: NDArray[np.bool_] = output.armed & (np.abs(np.nan_to_num(output.command)) >= _AT_LIMIT)
    return limit


def _share(output: Output, on: NDArray[np.bool_]) -> float:
    armed = int(np.count_nonzero(output.armed))
    return float(np.count_nonzero(on)) / armed if armed else 0.0


def _saturated(output: Output, instants: Instants) -> list[Finding]:
    limit = _at_limit(output)
    share, (from_ns, until_ns) = _share(output, limit), _longest(output, limit)
    longest_s = (until_ns - from_ns) * 1e-9
    if share < _NOTICE_SHARE or longest_s < _NOTICE_S:
        return []
    message, _, field = output.series.source.rpartition(".")
    return [
        Finding(
            "radio.saturated",
            Severity.WARNING if share >= _WARNING_SHARE and longest_s >= _WARNING_S else Severity.NOTICE,
            f"{output.name} was at the end of its range for {100.0 * share:.0f} % of the armed time, longest from "
            f"{instants.text(from_ns)} for {longest_s:.1f} s",
            (Evidence(message, field, from_ns, until_ns),),
            "Ask for less speed or turn, or find what holds the vessel: a saturated output no longer controls.",
        )
    ]


def _swinging(output: Output) -> list[Finding]:
    """Changes of direction by more than a fifth of the way, too often to do any good."""
    reversals = _reversals(output)
    if reversals is None or reversals < _SWINGS_HZ:
        return []
    message, _, field = output.series.source.rpartition(".")
    stamps = output.series.stamp_ns[output.armed]
    return [
        Finding(
            "radio.oscillation",
            Severity.NOTICE,
            f"{output.name} swings to and fro {reversals / 2.0:.1f} times a second by more than "
            f"{100.0 * _SWING:.0f} % of its way",
            (Evidence(message, field, int(stamps[0]), int(stamps[-1])),),
            "Lower the gains of the loop behind it, or filter what it follows.",
        )
    ]


def _reversals(output: Output) -> float | None:
    """Changes of direction a second while armed, of swings larger than a fifth of the way; None for a short record."""
    command = output.command[output.armed]
    stamps = output.series.stamp_ns[output.armed]
    known = np.isfinite(command)
    command, stamps = command[known], stamps[known]
    if len(command) < 50:
        return None
    span_s = float(stamps[-1] - stamps[0]) * 1e-9
    # Only turning points matter: between them a monotonous run is one move, and what repeats is none.
    command = command[np.concatenate(([True], np.diff(command) != 0.0))]
    moves = np.diff(command)
    turning = np.flatnonzero(np.sign(moves[1:]) * np.sign(moves[:-1]) < 0) + 1
    points = command[np.concatenate(([0], turning, [len(command) - 1]))]
    count, direction, extreme = 0, 0, float(points[0])
    for point in points[1:].tolist():
        if (direction >= 0 and point > extreme) or (direction <= 0 and point < extreme):
            if direction == 0 and abs(point - extreme) >= _SWING:
                direction = 1 if point > extreme else -1
            if direction:
                extreme = point
        elif abs(point - extreme) >= _SWING:
            direction, extreme, count = -direction, point, count + 1
    return count / span_s if span_s > 5.0 else None


def _uneven(found: list[Output]) -> list[Finding]:
    """Port and starboard throttle of a vessel that steers by them."""
    pairs = {output.function: output for output in found}
    port, starboard = pairs.get(PORT_THROTTLE), pairs.get(STARBOARD_THROTTLE)
    if port is None or starboard is None:
        motors = [output for output in found if output.series.unit == ""]
        if len(motors) != 2:
            return []
        port, starboard = motors
    if not np.array_equal(port.series.stamp_ns, starboard.series.stamp_ns):
        return []
    working = port.armed & (np.abs(port.command) + np.abs(starboard.command) > 0.1)
    working &= np.isfinite(port.command) & np.isfinite(starboard.command)
    if np.count_nonzero(working) < 100:
        return []
    left, right = float(port.command[working].mean()), float(starboard.command[working].mean())
    if abs(left - right) < _UNEVEN:
        return []
    message, _, field = port.series.source.rpartition(".")
    stamps = port.series.stamp_ns[working]
    return [
        Finding(
            "radio.uneven",
            Severity.NOTICE,
            f"{port.name} worked at {100.0 * left:.0f} % and {starboard.name} at {100.0 * right:.0f} % on average",
            (Evidence(message, field, int(stamps[0]), int(stamps[-1])),),
            "Wind or current from one side does that, and so does a fouled or weaker propeller: compare another run.",
        )
    ]


def _too_slow(log: Log, found: list[Output], instants: Instants) -> list[Finding]:
    """Throttle at its end while the speed stays under what is asked for."""
    table = log.tables.get("THR")
    if table is None:
        return []
    wanted, speed, out = numbers(table, "DesSpeed"), numbers(table, "Speed"), numbers(table, "ThrOut")
    if wanted is None or speed is None:
        return []
    if out is not None:
        full = np.abs(np.nan_to_num(out)) >= 99.0
    else:
        thrusters = [each for each in found if each.function in (THROTTLE, PORT_THROTTLE, STARBOARD_THROTTLE)]
        if not thrusters:
            return []
        full = np.ones(len(table), dtype=np.bool_)
        for each in thrusters:
            row = np.searchsorted(each.series.stamp_ns, table.stamp_ns, side="right") - 1
            full &= (row >= 0) & _at_limit(each)[np.maximum(row, 0)]
    with np.errstate(invalid="ignore"):
        short = full & (np.abs(wanted) - np.abs(speed) > _SHORT_MPS)
    spans = [(int(table.stamp_ns[a]), int(table.stamp_ns[min(b, len(table) - 1)]), a, b) for a, b in _runs(short)]
    long = [span for span in spans if (span[1] - span[0]) * 1e-9 >= _SHORT_S]
    if not long:
        return []
    worst = max(long, key=lambda span: span[1] - span[0])
    lag = float(np.nanmean(np.abs(wanted[worst[2] : worst[3]]) - np.abs(speed[worst[2] : worst[3]])))
    return [
        Finding(
            "radio.too_slow",
            Severity.WARNING,
            f"At full throttle the vessel stayed {lag:.1f} m/s under the speed asked for, longest from "
            f"{instants.text(worst[0])} for {(worst[1] - worst[0]) * 1e-9:.1f} s",
            tuple(Evidence("THR", "DesSpeed", a, b) for a, b, _, _ in long[:8]),
            "Set WP_SPEED and CRUISE_SPEED to what it reaches in this current, or look at hull and propellers.",
        )
    ]


def _steering(log: Log) -> tuple[Fact, ...]:
    """Share of the rows in which the steering controller asks for all there is, and in which its integrator is held."""
    facts: list[Fact] = []
    table = log.tables.get("STER")
    out = None if table is None else numbers(table, "SteerOut")
    if out is not None and len(out):
        share = 100.0 * float((np.abs(np.nan_to_num(out)) >= _STEERING_END - 1.0).mean())
        facts.append(Fact("steering_at_limit_percent", "Steering at its end", told(share, 3), "%"))
    table = log.tables.get("PIDS")
    flags = None if table is None else numbers(table, "Flags", raw=True)
    if flags is not None and len(flags):
        share = 100.0 * float(((np.nan_to_num(flags).astype(np.int64) & 1) != 0).mean())
        facts.append(Fact("steering_integrator_held_percent", "Steering rate controller limited", told(share, 3), "%"))
    return tuple(facts)


def _grid(found: list[Output]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for output in found:
        command = output.command[output.armed]
        command = command[np.isfinite(command)]
        limit = _at_limit(output)
        from_ns, until_ns = _longest(output, limit)
        reversals = _reversals(output)
        rows.append(
            (
                output.name,
                told(100.0 * float(command.min()), 3) if len(command) else None,
                told(100.0 * float(command.mean()), 3) if len(command) else None,
                told(100.0 * float(command.max()), 3) if len(command) else None,
                told(100.0 * _share(output, limit), 3),
                told((until_ns - from_ns) * 1e-9, 3),
                None if reversals is None else told(reversals / 2.0, 2),
            )
        )
    columns = ("output", "least %", "mean %", "most %", "at the end %", "longest s", "swings a second")
    return Grid("outputs", "Outputs while armed, % of the way from trim to the end", columns, tuple(rows))


def _plots(found: list[Output], findings: list[Finding]) -> tuple[Plot, ...]:
    marks = tuple(
        Mark(each.at_ns, finding.key, each.until_ns, finding.severity)
        for finding in findings
        if finding.key in ("radio.saturated", "radio.too_slow")
        for each in finding.evidence
        if each.at_ns is not None
    )
    traces = [Trace(output.name, output.series.stamp_ns, 100.0 * output.command, "steps") for output in found[:8]]
    return (Plot("outputs", "Outputs", "% of the way from trim", tuple(traces), marks=marks),) if traces else ()
