"""Remote control and outputs: failsafes, signal strength, function of each output, and saturation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import (
    CONTROLS,
    ERR_RC_FAILSAFE,
    PORT_THROTTLE,
    STARBOARD_THROTTLE,
)
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Flags, Stamps
from xitl_cli.logs.signals import Series, outputs, rc_inputs
from xitl_cli.logs.signals.series import listed, numbers, significant, tables_of
from xitl_cli.logs.signals.spans import find_holds, held_spans, runs, spells
from xitl_cli.logs.signals.states import armed_rows, error_rows, parameter_values
from xitl_cli.plugins.logs.analyses.outputs import THROTTLES, OutputChannel, driven_outputs

_IN_FAILSAFE = 2  # RCI2.Flags
_HELD_S = 5.0
_WEAK, _WEAK_SHARE = 0.3, 0.05
_INPUT_TITLE = "Remote control"
_NO_RSSI = 255


def input_section(
    log: Log, channels: Mapping[int, Series], parameters: Mapping[str, float], clock: LogClock
) -> Section:
    held = _held(channels, clock) if channels else ()
    lacks = []
    if not channels:
        lacks.append("No remote control input is logged: none is connected, or the bit RCIN of LOG_BITMASK is not set.")
    # Plots of the channels that move.
    traces = [
        Trace(f"channel {channel}", each.stamp_ns, each.values, "steps")
        for channel, each in channels.items()
        if np.ptp(each.values) > 0.0
    ]
    # Share of the time with a weak signal; 255 in telemetry means unknown.
    strength: list[Finding] = []
    for table in tables_of(log, ("RSSI", "RC_CHANNELS")):
        for field, scale, what in (("RXRSSI", 1.0, "signal strength"), ("RXLQ", 100.0, "link quality"),
                                   ("rssi", 254.0, "signal strength")):  # fmt: skip
            values = numbers(table, field, raw=True)
            if values is None:
                continue
            known = np.isfinite(values) & (values >= 0.0) & (values != _NO_RSSI if field == "rssi" else True)
            level, stamps = values[known] / scale, table.stamp_ns[known]
            if len(level) < 5 or not level.any():
                continue
            weak = level < _WEAK
            if float(weak.mean()) > _WEAK_SHARE:
                strength.append(
                    Finding.notice(
                        "radio.weak",
                        f"The {what} of the remote control was under {100.0 * _WEAK:.0f} % for "
                        f"{100.0 * float(weak.mean()):.0f} % of the time, at least {100.0 * float(level.min()):.0f} %",
                        tuple(Evidence(table.name, field, begin, end) for begin, end in spells(stamps, weak)),
                        "Check antennas and range before the link is lost.",
                    )
                )
    return Section(
        "radio",
        _INPUT_TITLE,
        facts=(Fact("input_channels", "Input channels in use", len(channels)),),
        findings=(*_failsafe(log, channels, parameters, clock), *held, *strength),
        grids=(_input_grid(channels),) if channels else (),
        plots=((Plot("inputs", "Remote control", "µs", tuple(traces[:8])),) if traces else ()),
        lacks=tuple(lacks),
    )


def _failsafe(
    log: Log, channels: Mapping[int, Series], parameters: Mapping[str, float], clock: LogClock
) -> Iterator[Finding]:
    """Failsafes from the receiver's flag, the throttle channel under FS_THR_VALUE, or the logged error."""
    for stamps, lost, message, field in _losses(log, channels, parameters):
        if not lost.any():
            continue
        spans = held_spans(stamps, lost)
        armed = armed_rows(log, stamps)
        sailing = lost if armed is None else lost & armed
        if lost.all():
            yield Finding.notice(
                "radio.none",
                "No remote control was received in this log",
                (Evidence(message, field, spans[0][0], spans[0][1]),),
                "This is normal without a transmitter. Otherwise, switch it on and check the receiver.",
            )
            return
        times = listed([f"{clock.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b in spans])
        yield Finding(
            "radio.failsafe",
            Severity.WARNING if sailing.any() else Severity.NOTICE,
            f"Remote control was lost {'once' if len(spans) == 1 else f'{len(spans)} times'}: at {times}"
            + ("" if sailing.any() else ", only while disarmed"),
            tuple(Evidence(message, field, a, b) for a, b in spans[:8]),
            "Check range, antennas and FS_THR_VALUE. The modes section shows the reaction of the failsafe.",
        )
        return
    return


def _losses(
    log: Log, channels: Mapping[int, Series], parameters: Mapping[str, float]
) -> list[tuple[Stamps, Flags, str, str]]:
    """Stamps, whether the remote control was lost at each, message and field; the most reliable source first."""
    found: list[tuple[Stamps, Flags, str, str]] = []
    table = log.tables.get("RCI2")
    flags = None if table is None else numbers(table, "Flags", raw=True)
    if table is not None and flags is not None:
        found.append((table.stamp_ns, (np.nan_to_num(flags).astype(np.int64) & _IN_FAILSAFE) != 0, "RCI2", "Flags"))
    rows = [(at_ns, code > 0) for at_ns, subsystem, code in error_rows(log) if subsystem == ERR_RC_FAILSAFE]
    if rows:
        stamps, failed = zip(*rows, strict=True)
        found.append((np.array(stamps, dtype=np.int64), np.array(failed), "ERR", "ECode"))
    throttle = channels.get(int(parameters.get("RCMAP_THROTTLE", 3)))
    limit = parameters.get("FS_THR_VALUE", 0.0)
    if throttle is not None and limit > 0.0 and parameters.get("FS_THR_ENABLE", 1.0) > 0.0:
        message, _, field = throttle.source.rpartition(".")
        found.append((throttle.stamp_ns, throttle.values < limit, message, field))
    return found


def _held(channels: Mapping[int, Series], clock: LogClock) -> Iterator[Finding]:
    """Channels that otherwise always vary, and then all stop: the receiver holds its last values."""
    shortest = min(len(each.values) for each in channels.values())
    first = next(iter(channels.values()))
    rows = np.stack([each.values[:shortest] for each in channels.values()], axis=1)
    steps = np.diff(first.stamp_ns[:shortest])
    if shortest < 20 or not (steps > 0).any():
        return
    found = find_holds(rows, float(np.median(steps)) * 1e-9, shortest_s=_HELD_S)
    if found.usual >= 1.5 or not found.holds or found.repeated > 0.8:
        return
    message = first.source.rpartition(".")[0]
    spans = [(int(first.stamp_ns[hold.first]), int(first.stamp_ns[hold.last])) for hold in found.holds]
    times = listed([f"from {clock.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b in spans])
    yield Finding.notice(
        "radio.held",
        f"All channels of the remote control were constant {times}, but they have noise at other times",
        tuple(Evidence(message, None, a, b) for a, b in spans[:8]),
        "A receiver that holds its last values hides a lost link. Set it to send no pulses, so that the failsafe acts.",
    )


def _input_grid(channels: Mapping[int, Series]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for channel, each in channels.items():
        low, high = float(each.values.min()), float(each.values.max())
        moves = "constant" if low == high else f"{100.0 * float((np.diff(each.values) != 0.0).mean()):.0f} % of rows"
        rows.append((channel, significant(low), significant(float(np.median(each.values))), significant(high), moves))
    return Grid("inputs", "Remote control, µs", ("channel", "least", "median", "most", "changes"), tuple(rows))


_OUTPUT_TITLE = "Outputs"
_AT_LIMIT = 0.995  # of the range from trim to the end
_NOTICE_SHARE, _NOTICE_S = 0.05, 3.0
_WARNING_SHARE, _WARNING_S = 0.25, 10.0
_UNEVEN = 0.15
_SHORT_MPS, _SHORT_S = 0.3, 5.0
_SWING, _SWINGS_HZ = 0.2, 1.2
_STEERING_END = 4500.0


def output_section(log: Log, driven: Mapping[int, Series], parameters: Mapping[str, float], clock: LogClock) -> Section:
    if not driven:
        lack = "No outputs are logged; set the bit RCOUT of LOG_BITMASK."
        return Section("radio", _OUTPUT_TITLE, lacks=(lack,))
    found = driven_outputs(log, parameters)
    single = (finding for output in found for finding in (*_saturated(output, clock), *_swinging(output)))
    findings = (*single, *_uneven(found), *_too_slow(log, found, clock))
    lacks = []
    if any(output.series.unit == "us" for output in found) and not any(output.function for output in found):
        lacks.append(
            "What the outputs drive is not known: the log has no SERVOn_FUNCTION; their ends are taken as 1100 and "
            "1900 µs, or 1000 and 2000 µs where pulses go beyond."
        )
    marks = tuple(
        Mark(each.at_ns, finding.key, each.until_ns, finding.severity)
        for finding in findings
        if finding.key in ("radio.saturated", "radio.too_slow")
        for each in finding.evidence
        if each.at_ns is not None
    )
    traces = [Trace(output.name, output.series.stamp_ns, 100.0 * output.command, "steps") for output in found[:8]]
    # Share of the rows in which the steering controller demands its maximum, and in which its integrator is
    # frozen.
    facts: list[Fact] = []
    table = log.tables.get("STER")
    out = None if table is None else numbers(table, "SteerOut")
    if out is not None and len(out):
        share = 100.0 * float((np.abs(np.nan_to_num(out)) >= _STEERING_END - 1.0).mean())
        facts.append(Fact("steering_at_limit_percent", "Steering at its end", significant(share, 3), "%"))
    table = log.tables.get("PIDS")
    flags = None if table is None else numbers(table, "Flags", raw=True)
    if flags is not None and len(flags):
        share = 100.0 * float(((np.nan_to_num(flags).astype(np.int64) & 1) != 0).mean())
        facts.append(
            Fact("steering_integrator_held_percent", "Steering rate controller limited", significant(share, 3), "%")
        )
    return Section(
        "radio",
        _OUTPUT_TITLE,
        facts=(Fact("outputs", "Outputs in use", len(found)), *tuple(facts)),
        findings=findings,
        grids=(_output_grid(found),) if found else (),
        plots=((Plot("outputs", "Outputs", "% of the way from trim", tuple(traces), marks=marks),) if traces else ()),
        lacks=tuple(lacks),
    )


def _longest(output: OutputChannel, on: Flags) -> tuple[int, int]:
    """Begin and end (ns) of the longest span; a row lasts until the next row."""
    spans = held_spans(output.series.stamp_ns, on)
    return max(spans, key=lambda span: span[1] - span[0], default=(0, 0))


def _at_limit(output: OutputChannel) -> Flags:
    limit: Flags = output.armed & (np.abs(np.nan_to_num(output.command)) >= _AT_LIMIT)
    return limit


def _share(output: OutputChannel, on: Flags) -> float:
    armed = int(np.count_nonzero(output.armed))
    return float(np.count_nonzero(on)) / armed if armed else 0.0


def _saturated(output: OutputChannel, clock: LogClock) -> Iterator[Finding]:
    """Saturation of outputs that steer or drive. If the log does not identify them, it is only a notice."""
    if output.function is not None and output.function not in CONTROLS:
        return
    limit = _at_limit(output)
    share, (from_ns, until_ns) = _share(output, limit), _longest(output, limit)
    longest_s = (until_ns - from_ns) * 1e-9
    if share < _NOTICE_SHARE or longest_s < _NOTICE_S:
        return
    message, _, field = output.series.source.rpartition(".")
    yield Finding(
        "radio.saturated",
        Severity.WARNING if output.known and share >= _WARNING_SHARE and longest_s >= _WARNING_S else Severity.NOTICE,
        f"{output.name} was at the end of its range for {100.0 * share:.0f} % of the "
        f"{'armed time' if output.arming_known else 'time'}, longest from "
        f"{clock.text(from_ns)} for {longest_s:.1f} s",
        (Evidence(message, field, from_ns, until_ns),),
        "Demand less speed or turn rate, or find the resistance. A saturated output no longer controls.",
    )


def _swinging(output: OutputChannel) -> Iterator[Finding]:
    """Changes of direction by more than a fifth of the range, too frequent to be useful."""
    reversals = _reversals(output)
    if reversals is None or reversals < _SWINGS_HZ:
        return
    message, _, field = output.series.source.rpartition(".")
    stamps = output.series.stamp_ns[output.armed]
    yield Finding.notice(
        "radio.oscillation",
        f"{output.name} swings to and fro {reversals / 2.0:.1f} times a second by more than "
        f"{100.0 * _SWING:.0f} % of its range",
        (Evidence(message, field, int(stamps[0]), int(stamps[-1])),),
        "Lower the gains of its control loop, or filter its setpoint.",
    )


def _reversals(output: OutputChannel) -> float | None:
    """Changes of direction per second while armed, of swings larger than a fifth of the range; None for a short
    record."""
    command = output.command[output.armed]
    stamps = output.series.stamp_ns[output.armed]
    known = np.isfinite(command)
    command, stamps = command[known], stamps[known]
    if len(command) < 50:
        return None
    span_s = float(stamps[-1] - stamps[0]) * 1e-9
    # Keep only turning points: a monotonic run is one move, and repeated values are none.
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


def _uneven(found: list[OutputChannel]) -> Iterator[Finding]:
    """Port and starboard throttle of a vessel that steers with them."""
    pairs = {output.function: output for output in found}
    port, starboard = pairs.get(PORT_THROTTLE), pairs.get(STARBOARD_THROTTLE)
    if port is None or starboard is None:
        motors = [output for output in found if output.series.unit == "" and output.drives]
        if len(motors) != 2:
            return
        port, starboard = motors
    if not np.array_equal(port.series.stamp_ns, starboard.series.stamp_ns):
        return
    working = port.armed & (np.abs(port.command) + np.abs(starboard.command) > 0.1)
    working &= np.isfinite(port.command) & np.isfinite(starboard.command)
    if np.count_nonzero(working) < 100:
        return
    left, right = float(port.command[working].mean()), float(starboard.command[working].mean())
    if abs(left - right) < _UNEVEN:
        return
    message, _, field = port.series.source.rpartition(".")
    stamps = port.series.stamp_ns[working]
    yield Finding.notice(
        "radio.uneven",
        f"{port.name} worked at {100.0 * left:.0f} % and {starboard.name} at {100.0 * right:.0f} % on average",
        (Evidence(message, field, int(stamps[0]), int(stamps[-1])),),
        "Wind or current from one side causes this, and so does a fouled or weaker propeller. Compare another run.",
    )


def _too_slow(log: Log, found: list[OutputChannel], clock: LogClock) -> Iterator[Finding]:
    """Throttle at its end while the speed remains below the setpoint."""
    table = log.tables.get("THR")
    if table is None:
        return
    wanted, speed, out = numbers(table, "DesSpeed"), numbers(table, "Speed"), numbers(table, "ThrOut")
    if wanted is None or speed is None:
        return
    if out is not None:
        full = np.abs(np.nan_to_num(out)) >= 99.0
    else:
        thrusters = [each for each in found if each.function in THROTTLES]
        if not thrusters:
            return
        full = np.ones(len(table), dtype=np.bool_)
        for each in thrusters:
            row = np.searchsorted(each.series.stamp_ns, table.stamp_ns, side="right") - 1
            full &= (row >= 0) & _at_limit(each)[np.maximum(row, 0)]
    with np.errstate(invalid="ignore"):
        short = full & (np.abs(wanted) - np.abs(speed) > _SHORT_MPS)
    spans = zip(held_spans(table.stamp_ns, short), runs(short), strict=True)
    long = [(*span, *rows) for span, rows in spans if (span[1] - span[0]) * 1e-9 >= _SHORT_S]
    if not long:
        return
    worst = max(long, key=lambda span: span[1] - span[0])
    lag = float(np.nanmean(np.abs(wanted[worst[2] : worst[3]]) - np.abs(speed[worst[2] : worst[3]])))
    yield Finding.warning(
        "radio.too_slow",
        f"At full throttle the vessel stayed {lag:.1f} m/s below the demanded speed, longest from "
        f"{clock.text(worst[0])} for {(worst[1] - worst[0]) * 1e-9:.1f} s",
        tuple(Evidence("THR", "DesSpeed", a, b) for a, b, _, _ in long[:8]),
        "Set WP_SPEED and CRUISE_SPEED to what it reaches in this current, or look at hull and propellers.",
    )


def _output_grid(found: list[OutputChannel]) -> Grid:
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
                significant(100.0 * float(command.min()), 3) if len(command) else None,
                significant(100.0 * float(command.mean()), 3) if len(command) else None,
                significant(100.0 * float(command.max()), 3) if len(command) else None,
                significant(100.0 * _share(output, limit), 3),
                significant((until_ns - from_ns) * 1e-9, 3),
                None if reversals is None else significant(reversals / 2.0, 2),
            )
        )
    columns = ("output", "least %", "mean %", "most %", "at the end %", "longest s", "swings a second")
    when = " while armed" if all(output.arming_known for output in found) else ""
    return Grid("outputs", f"Outputs{when}, % of the way from trim to the end", columns, tuple(rows))


def analyse(log: Log) -> Section | None:
    """Section on inputs and outputs; None for a recording without them."""
    clock = LogClock(log)
    channels, driven = rc_inputs(log), outputs(log)
    if not channels and not driven and log.of_topics:
        return None
    parameters = parameter_values(log)
    parts = (input_section(log, channels, parameters, clock), output_section(log, driven, parameters, clock))
    return Section.joined("radio", "Remote control and outputs", parts)
