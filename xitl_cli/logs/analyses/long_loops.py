"""Long loops of ArduPilot's main loop, by window of its PM record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Flags, Floats, Stamps
from xitl_cli.logs.signals.deadlines import LONG_AT, LoopWindows, simulated_clock_reason
from xitl_cli.logs.signals.moments import Moment, moments_near, moments_text
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.spans import spells
from xitl_cli.logs.signals.states import last_parameters

BESIDE_NS = 500_000_000  # around a loop with a known instant
PLACED = 0.7  # share of the longest loop's time that must be without a row of the loop
FAST_TABLES = ("ATT", "IMU", "RCOU", "XKF1", "NKF1", "GPS", "POS", "STER", "RATE")


@dataclass(frozen=True, slots=True)
class LongLoopWindow:
    """A window with long loops."""

    row: int
    placed: tuple[int, int] | None
    """Pause in the log during the longest loop; None if none was found."""
    happened: str
    armed: bool
    leapt: bool
    """It is long because the clock jumped ahead."""


def windows_with_long_loops(
    log: Log, windows: LoopWindows, happened: Sequence[Moment], clock: LogClock, period_s: float | None
) -> list[LongLoopWindow]:
    long = np.flatnonzero(np.nan_to_num(windows.long_loops) > 0.0)
    pauses = _pauses(log, period_s)
    found = []
    for row in long.tolist():
        from_ns, until_ns = int(windows.from_ns[row]), int(windows.until_ns[row])
        placed = _placed(pauses, from_ns, until_ns, float(windows.longest_us[row]) * 1e-6, log, period_s)
        begin, end = (from_ns, until_ns) if placed is None else placed
        beside = moments_near(happened, begin, end, 0 if placed is None else BESIDE_NS)
        on = any(since < end and begin < until for since, until in clock.armed)
        leapt = any(one.kind == "clock" for one in beside)
        found.append(LongLoopWindow(row, placed, moments_text(beside), on, leapt))
    return found


def _pauses(log: Log, period_s: float | None) -> list[Stamps]:
    """Stamps of messages that are logged in about every loop."""
    if period_s is None:
        return []
    found = []
    for name in FAST_TABLES:
        table = log.tables.get(name)
        if table is None or len(table) < 20:
            continue
        stamps = np.unique(table.stamp_ns)
        if len(stamps) > 2 and float(np.median(np.diff(stamps))) * 1e-9 < 2.5 * period_s:
            found.append(stamps)
    return found


def _placed(
    pauses: list[Stamps], from_ns: int, until_ns: int, longest_s: float, log: Log, period_s: float | None
) -> tuple[int, int] | None:
    """Span without any row of the loop for as long as the longest loop; before the log's first row at its start."""
    if not np.isfinite(longest_s) or period_s is None or longest_s < 2.0 * period_s:
        return None
    best: tuple[int, int] | None = None
    for stamps in pauses:
        first, last = np.searchsorted(stamps, (from_ns - round(longest_s * 1e9), until_ns))
        inside = stamps[max(int(first) - 1, 0) : int(last) + 1]
        if len(inside) < 2:
            continue
        widest = int(np.argmax(np.diff(inside)))
        begin, end = int(inside[widest]), int(inside[widest + 1])
        if end - begin >= PLACED * longest_s * 1e9 and (best is None or end - begin < best[1] - best[0]):
            best = (begin, end)
    if best is not None:
        return best
    begins_ns = log.span_ns[0] if log.span_ns else from_ns
    if pauses and from_ns < begins_ns < until_ns:  # no pause since the first row, so it was earlier
        return (begins_ns - round(longest_s * 1e9), begins_ns)
    return None


MISS_WARNING, MISS_CRITICAL = 0.01, 0.1
WINDOW_WARNING = 0.05
LONG_PERIODS = 10.0
LOAD_WARNING_PERCENT = 80.0
SATURATED_PERCENT = 99.95
RATE_LOW = 0.95
MOST_MARKS = 50


def long_loop_section(log: Log, windows: LoopWindows, happened: Sequence[Moment], clock: LogClock) -> Section:
    why = simulated_clock_reason(log)
    period_s = windows.period_s
    found = windows_with_long_loops(log, windows, happened, clock, period_s)
    findings = [_no_evidence(windows, why)] if why else _findings(log, windows, found, period_s, clock)
    known = dict(windows.names)
    missing = [
        text
        for meaning, text in (
            ("long_loops", "NLon (long loops)"),
            ("loops", "NL (loops)"),
            ("longest_us", "MaxT (longest loop)"),
            ("load_percent", "Load"),
        )
        if meaning not in known
    ]
    lacks = () if not missing else (f"PM of this firmware has no {', '.join(missing)}, so that cannot be judged.",)
    return Section(
        "scheduler",
        "Main loop",
        _facts(windows, why, period_s),
        tuple(findings),
        (_grid(windows, found, clock),) if found else (),
        _plots(windows, found),
        lacks,
    )


def _no_evidence(windows: LoopWindows, why: str) -> Finding:
    return Finding.notice(
        "scheduler.simulated_clock",
        f"PM tells nothing of processor time: {why}, and the time between loops is that of the simulated clock",
        (Evidence("PM", windows.field("longest_us") if "longest_us" in dict(windows.names) else None),),
        "Judge load and long loops on a log of a board, or of the Linux build in real time.",
    )


def _facts(windows: LoopWindows, why: str, period_s: float | None) -> tuple[Fact, ...]:
    total, long = _sum(windows.loops), _sum(windows.long_loops)
    load = windows.load_percent[np.isfinite(windows.load_percent)]
    facts = [
        Fact("windows", "PM records", len(windows.until_ns)),
        Fact("loop_rate_hz", "Loop rate", rounded(None if period_s is None else 1.0 / period_s, 1), "Hz"),
        Fact("loops", "Loops", total),
        Fact("long_loops", f"Loops over {LONG_AT} periods", long),
        Fact("long_loop_ratio", "Share of long loops", None if not total or long is None else round(long / total, 6)),
        Fact("longest_loop_us", "Longest loop", _whole_max(windows.longest_us), "us"),
        Fact("load_mean_percent", "Load, mean", rounded(load.mean(), 1) if len(load) else None, "%"),
        Fact("load_max_percent", "Load, highest", rounded(load.max(), 1) if len(load) else None, "%"),
        Fact(
            "load_saturated",
            "Windows with saturated load",
            int(np.sum(load > SATURATED_PERCENT)) if len(load) else None,
        ),
        Fact("extra_loop_us", "Budget added for late tasks, most", _whole_max(windows.extra_us), "us"),
        Fact(
            "memory_least_bytes",
            "Free memory, least",
            int(np.nanmin(windows.memory_bytes)) if np.isfinite(windows.memory_bytes).any() else None,
            "bytes",
        ),
        Fact("evidence", "Evidence of processor time", not why),
    ]
    length_s = float(np.sum(windows.until_ns - windows.from_ns)) * 1e-9
    for counter in windows.counters:
        facts.append(Fact(f"{counter.key}_count", f"Growth of {counter.label}", counter.total))
        if counter.key != "internal_errors" and length_s > 0.0 and counter.total:
            rate = rounded(counter.total / length_s, 1)
            facts.append(Fact(f"{counter.key}_per_s", f"Rate of {counter.label}", rate, "1/s"))
    return tuple(fact for fact in facts if fact.value is not None)


def _sum(values: Floats) -> int | None:
    return int(np.nansum(values)) if np.isfinite(values).any() else None


def _whole_max(values: Floats) -> int | None:
    return int(np.nanmax(values)) if np.isfinite(values).any() else None


def _findings(
    log: Log, windows: LoopWindows, found: list[LongLoopWindow], period_s: float | None, clock: LogClock
) -> Iterator[Finding]:
    yield from _long(windows, found, clock)
    # One finding for the longest loop while armed and one while disarmed, if they are long at all.
    for armed in (True, False):
        rows = [one for one in found if one.armed == armed and np.isfinite(windows.longest_us[one.row])]
        if not rows or period_s is None:
            continue
        worst = max(rows, key=lambda one: float(windows.longest_us[one.row]))
        longest_s = float(windows.longest_us[worst.row]) * 1e-6
        if longest_s < LONG_PERIODS * period_s:
            continue
        begin, end = int(windows.from_ns[worst.row]), int(windows.until_ns[worst.row])
        if worst.placed is not None:
            begin, end = worst.placed
        when = f"between {clock.text(begin)} and {clock.text(end)}"
        yield Finding(
            f"scheduler.longest_loop{'' if armed else '_disarmed'}",
            Severity.WARNING if armed and not worst.leapt else Severity.NOTICE,
            f"One loop took {1e3 * longest_s:.0f} ms, {longest_s / period_s:.0f} periods, "
            f"{'armed' if armed else 'not armed'}, {when}, with: {worst.happened}",
            (Evidence("PM", windows.field("longest_us"), begin, end, f"{1e6 * longest_s:.0f} us"),),
            "Look at the time bases for why the clock stepped; the loop itself kept its time."
            if worst.leapt
            else "The controllers stood still for so long: look for what was written, opened or started then."
            if armed
            else "Harmless where it comes once at the start; see that it does not come again when armed.",
        )
    yield from _load(windows, clock)
    yield from _rate(log, windows)
    extra = np.nan_to_num(windows.extra_us)
    late = np.flatnonzero(extra > 0.0)
    if not len(late):
        return
    at_ns = int(windows.until_ns[late[0]])
    yield Finding.notice(
        "scheduler.late_tasks",
        f"Tasks were eight times late, so up to {extra.max():.0f} us were added to each loop, first at "
        f"{clock.text(at_ns)}",
        tuple(Evidence("PM", windows.field("extra_us"), a, b) for a, b in _window_spells(windows, extra > 0.0)),
        "Fetch @SYS/tasks.txt (`xitl logs tasks`) to see which task takes the time.",
    )


def _long(windows: LoopWindows, found: list[LongLoopWindow], clock: LogClock) -> Iterator[Finding]:
    total, long = _sum(windows.loops), _sum(windows.long_loops)
    if not total or not long:
        return
    ratio = long / total
    with np.errstate(invalid="ignore", divide="ignore"):
        by_window = np.where(windows.loops > 0.0, windows.long_loops / windows.loops, 0.0)
    worst = int(np.nanargmax(np.nan_to_num(by_window)))
    severity = Severity.NOTICE
    if ratio > MISS_WARNING or by_window[worst] > WINDOW_WARNING:
        severity = Severity.CRITICAL if ratio > MISS_CRITICAL else Severity.WARNING
    beside = next((one.happened for one in found if one.row == worst), "")
    at = f"{clock.text(int(windows.from_ns[worst]))} to {clock.text(int(windows.until_ns[worst]))}"
    yield Finding(
        "scheduler.long_loops",
        severity,
        f"{long} of {total} loops ({100.0 * ratio:.2f} %) took more than {LONG_AT} periods; most from {at} "
        f"({100.0 * float(by_window[worst]):.1f} %), with: {beside}",
        tuple(
            Evidence(
                "PM",
                windows.field("long_loops"),
                int(windows.from_ns[one.row]),
                int(windows.until_ns[one.row]),
                f"{windows.long_loops[one.row]:.0f} of {windows.loops[one.row]:.0f}",
            )
            for one in found[:10]
        ),
        "Look what comes together with them below; take load off (LOG_BITMASK, SCHED_LOOP_RATE, notch filters, "
        "scripts) or give the process a real-time priority.",
    )


def _load(windows: LoopWindows, clock: LogClock) -> Iterator[Finding]:
    load = windows.load_percent
    known = np.isfinite(load)
    if not known.any():
        return
    full = np.flatnonzero(known & (load > SATURATED_PERCENT))
    mean = float(load[known].mean())
    if len(full):
        at_ns = int(windows.until_ns[full[0]])
        yield Finding.warning(
            "scheduler.load_saturated",
            f"Load was at 100 % in {len(full)} of {int(known.sum())} windows, first at {clock.text(at_ns)}: the "
            "loop rate fell under 95 % of what it should be",
            tuple(
                Evidence("PM", windows.field("load_percent"), a, b)
                for a, b in _window_spells(windows, known & (load > SATURATED_PERCENT))
            ),
            "Lower SCHED_LOOP_RATE or what the autopilot has to do (LOG_BITMASK, filters, scripts).",
        )
        return
    if mean > LOAD_WARNING_PERCENT:
        evidence = Evidence("PM", windows.field("load_percent"), value=f"{mean:.1f} %")
        step = "Lower SCHED_LOOP_RATE or what the autopilot has to do before something is added."
        yield Finding.warning("scheduler.load", f"The processor was {mean:.0f} % busy", (evidence,), step)
        return
    return


def _window_spells(windows: LoopWindows, flags: Flags) -> list[tuple[int, int]]:
    """Episodes of consecutive windows, by the time of logging."""
    return spells(windows.until_ns, flags)


def _rate(log: Log, windows: LoopWindows) -> Iterator[Finding]:
    wanted_hz = last_parameters(log).get("SCHED_LOOP_RATE")
    rates = windows.rate_hz[np.isfinite(windows.rate_hz)]
    if not wanted_hz or not len(rates) or float(np.median(rates)) >= RATE_LOW * wanted_hz:
        return
    reached_hz = float(np.median(rates))
    yield Finding.warning(
        "scheduler.loop_rate",
        f"The main loop ran at {reached_hz:.0f} Hz where SCHED_LOOP_RATE asks for {wanted_hz:.0f} Hz",
        (Evidence("PM", windows.field("rate_hz"), value=f"{reached_hz:.0f} Hz"),),
        "Lower SCHED_LOOP_RATE to what this board reaches: gains and filters count on it.",
    )


def _grid(windows: LoopWindows, found: list[LongLoopWindow], clock: LogClock) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for one in found:
        begin, end = one.placed or (int(windows.from_ns[one.row]), int(windows.until_ns[one.row]))
        rows.append(
            (
                clock.second(int(windows.until_ns[one.row])),
                rounded(windows.long_loops[one.row], 0),
                rounded(windows.loops[one.row], 0),
                rounded(windows.longest_us[one.row], 0),
                clock.second(begin) if one.placed else None,
                clock.second(end) if one.placed else None,
                "yes" if one.armed else "no",
                one.happened,
            )
        )
    columns = ("window until (s)", "long", "loops", "longest (us)", "from (s)", "until (s)", "armed", "with")
    return Grid.limited("long_loops", "Windows with long loops, and what else happened then", columns, rows)


def _plots(windows: LoopWindows, found: list[LongLoopWindow]) -> tuple[Plot, ...]:
    marks = tuple(
        Mark(
            (one.placed or (int(windows.from_ns[one.row]),))[0],
            one.happened[:80],
            (one.placed or (0, int(windows.until_ns[one.row])))[1],
            Severity.WARNING if one.armed else Severity.NOTICE,
        )
        for one in found[:MOST_MARKS]
    )
    plots = []
    for key, title, label, parts in (
        ("longest_loop", "Longest loop of each window", "ms", (("longest loop", windows.longest_us * 1e-3),)),
        ("long_loops", "Long loops of each window", "loops", (("long loops", windows.long_loops),)),
        ("load", "Load", "%", (("load", windows.load_percent),)),
    ):
        traces = tuple(
            Trace(name, windows.until_ns[np.isfinite(values)], values[np.isfinite(values)], "points")
            for name, values in parts
            if np.isfinite(values).any()
        )
        if traces:
            plots.append(Plot(key, title, label, traces, marks=marks if key == "longest_loop" else ()))
    return tuple(plots)
