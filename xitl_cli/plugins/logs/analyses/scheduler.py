"""Deadlines: missed deadlines of periodic tasks and long loops of ArduPilot, each with simultaneous events.

Long loops of ArduPilot's main loop, by window of its PM record.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.fit import ClockStep, clock_relations
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Flags, Floats, Stamps, distinct
from xitl_cli.logs.signals.deadlines import (
    LONG_AT,
    LoopWindows,
    MissedDeadlines,
    TaskTotal,
    clock_stood_still,
    loop_windows,
    missed_deadlines,
    simulated_clock_reason,
    task_totals,
)
from xitl_cli.logs.signals.moments import Moment, moments, moments_near, moments_text
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
        stamps = distinct(table.stamp_ns)
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
MOST_LOOP_MARKS = 50


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
        f"PM shows no processor time: {why}, and the time between loops is that of the simulated clock",
        (Evidence("PM", windows.field("longest_us") if "longest_us" in dict(windows.names) else None),),
        "Judge load and long loops with a log of a board, or of the Linux build in real time.",
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
    log: Log, windows: LoopWindows, long_windows: list[LongLoopWindow], period_s: float | None, clock: LogClock
) -> Iterator[Finding]:
    yield from _long(windows, long_windows, clock)
    # One finding for the longest loop while armed and one while disarmed, if they are long at all.
    for armed in (True, False):
        rows = [
            window for window in long_windows if window.armed == armed and np.isfinite(windows.longest_us[window.row])
        ]
        if not rows or period_s is None:
            continue
        worst = max(rows, key=lambda window: float(windows.longest_us[window.row]))
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
            "See in the time bases why the clock stepped. The loop itself was on time."
            if worst.leapt
            else "The controllers stopped for this time. Look for files or programs that were opened or started then."
            if armed
            else "This is harmless once at the start. Check that it does not occur while armed.",
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
        tuple(Evidence("PM", windows.field("extra_us"), a, b) for a, b in spells(windows.until_ns, extra > 0.0)),
        "Fetch @SYS/tasks.txt (`xitl logs tasks`) to see which task takes the time.",
    )


def _long(windows: LoopWindows, long_windows: list[LongLoopWindow], clock: LogClock) -> Iterator[Finding]:
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
    beside = next((window.happened for window in long_windows if window.row == worst), "")
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
                int(windows.from_ns[window.row]),
                int(windows.until_ns[window.row]),
                f"{windows.long_loops[window.row]:.0f} of {windows.loops[window.row]:.0f}",
            )
            for window in long_windows[:10]
        ),
        "See below which events coincide with them. Reduce the load (LOG_BITMASK, SCHED_LOOP_RATE, notch filters, "
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
            "loop rate fell under 95 % of its target",
            tuple(
                Evidence("PM", windows.field("load_percent"), a, b)
                for a, b in spells(windows.until_ns, known & (load > SATURATED_PERCENT))
            ),
            "Lower SCHED_LOOP_RATE or the load of the autopilot (LOG_BITMASK, filters, scripts).",
        )
        return
    if mean > LOAD_WARNING_PERCENT:
        evidence = Evidence("PM", windows.field("load_percent"), value=f"{mean:.1f} %")
        step = "Lower SCHED_LOOP_RATE or the load of the autopilot before you add something."
        yield Finding.warning("scheduler.load", f"The processor was {mean:.0f} % busy", (evidence,), step)
        return
    return


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
        "Lower SCHED_LOOP_RATE to the rate that this board reaches: gains and filters depend on it.",
    )


def _grid(windows: LoopWindows, long: list[LongLoopWindow], clock: LogClock) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for window in long:
        begin, end = window.placed or (int(windows.from_ns[window.row]), int(windows.until_ns[window.row]))
        rows.append(
            (
                clock.second(int(windows.until_ns[window.row])),
                rounded(windows.long_loops[window.row], 0),
                rounded(windows.loops[window.row], 0),
                rounded(windows.longest_us[window.row], 0),
                clock.second(begin) if window.placed else None,
                clock.second(end) if window.placed else None,
                "yes" if window.armed else "no",
                window.happened,
            )
        )
    columns = ("window until (s)", "long", "loops", "longest (us)", "from (s)", "until (s)", "armed", "with")
    return Grid.limited("long_loops", "Windows with long loops, and coincident events", columns, rows)


def _plots(windows: LoopWindows, long: list[LongLoopWindow]) -> tuple[Plot, ...]:
    marks = tuple(
        Mark(
            (window.placed or (int(windows.from_ns[window.row]),))[0],
            window.happened[:80],
            (window.placed or (0, int(windows.until_ns[window.row])))[1],
            Severity.WARNING if window.armed else Severity.NOTICE,
        )
        for window in long[:MOST_LOOP_MARKS]
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


RATIO_WARNING, RATIO_CRITICAL = 0.01, 0.1
FEW = 3
STEP_NS = 1_000_000_000
MOST_MARKS = 100


def missed_section(
    tasks: Sequence[TaskTotal],
    misses: MissedDeadlines | None,
    steps: Sequence[ClockStep],
    happened: Sequence[Moment],
    clock: LogClock,
) -> Section:
    by_step = np.zeros(0, dtype=np.bool_) if misses is None else _by_step(misses, steps)
    late = [task for task in tasks if task.missed]
    findings = [
        _finding([task for task in late if task.node == node], misses, by_step, happened, clock)
        for node in dict.fromkeys(task.node for task in late)
    ]
    unlisted = (
        []
        if misses is None
        else [
            name for name in dict.fromkeys(misses.task) if not next((task for task in tasks if task.name == name), None)
        ]
    )
    if misses is not None and unlisted:
        rows = [row for row, name in enumerate(misses.task) if name in unlisted]
        at_ns = int(misses.due_ns[rows[0]])
        findings.append(
            Finding.notice(
                "scheduler.deadlines_missed",
                f"{len(rows)} deadlines of {', '.join(unlisted)} were missed, the first at {clock.text(at_ns)}",
                (Evidence(misses.message, None, at_ns, int(misses.end_ns[rows[-1]])),),
                "The number of cycles is not logged. Compare with the rate of the task.",
            )
        )
    listed = 0 if misses is None else len(misses)
    counted = sum(task.missed for task in tasks)
    facts = (
        Fact("tasks", "Periodic tasks", len(tasks)),
        Fact("deadlines_missed", "Deadlines missed", counted if tasks else listed),
        Fact("cycles_skipped", "Of these, cycles that never ran", sum(task.skipped for task in tasks)),
        Fact("misses_listed", "Misses logged one by one", listed),
    )
    return Section(
        "scheduler",
        "Deadlines",
        facts,
        tuple(findings),
        () if misses is None else (_missed_grid(misses, happened, clock),),
        () if misses is None else _missed_plots(misses, by_step),
    )


def _by_step(misses: MissedDeadlines, steps: Sequence[ClockStep]) -> Flags:
    """Misses that only result from a forward step of the clock."""
    found = np.zeros(len(misses), dtype=np.bool_)
    end_ns = misses.end_ns
    for step in steps:
        size_ns = round(step.size_s * 1e9)
        close = (misses.due_ns <= step.at_ns + STEP_NS + size_ns) & (end_ns >= step.at_ns - STEP_NS - size_ns)
        found |= close & (np.abs(misses.skipped) > 0)
    return found


def _finding(
    tasks: Sequence[TaskTotal],
    misses: MissedDeadlines | None,
    by_step: Flags,
    happened: Sequence[Moment],
    clock: LogClock,
) -> Finding:
    """One finding for all tasks of a node, because the cause for one also delayed the others."""
    names = {task.name for task in tasks}
    rows = [] if misses is None else [row for row, name in enumerate(misses.task) if name in names]
    leapt = {task.name: 0 for task in tasks}
    for row in rows:
        if misses is not None and by_step[row]:
            leapt[misses.task[row]] += int(misses.skipped[row])
    severity = Severity.NOTICE
    for task in tasks:
        own_missed = max(task.missed - leapt[task.name], 0)
        ratio = own_missed / max(task.cycles + task.skipped, 1)
        if ratio > RATIO_WARNING and own_missed > FEW:
            severity = max(severity, Severity.CRITICAL if ratio > RATIO_CRITICAL else Severity.WARNING)
    missed, due = sum(task.missed for task in tasks), sum(task.cycles + task.skipped for task in tasks)
    by_clock = min(sum(leapt.values()), missed)
    each = ", ".join(f"{task.task} {task.missed} of {task.cycles + task.skipped}" for task in tasks)
    node = tasks[0].node
    sentence = (
        f"{missed} deadlines {f'of {node} ' if node else ''}were missed "
        f"({100.0 * missed / max(due, 1):.2f} %: {each}), {sum(task.skipped for task in tasks)} of them skipped"
    )
    if by_clock:
        sentence += f"; {'all' if by_clock == missed else by_clock} because its clock leapt ahead"
    evidence: tuple[Evidence, ...] = (Evidence("/tasks", "missed") if node else Evidence("TASK", "Miss"),)
    own = [row for row in rows if not by_step[row]] or rows
    if misses is not None and own:
        worst = max(own, key=lambda row: float(misses.late_s[row] + misses.run_s[row]))
        at_ns = int(misses.due_ns[worst])
        beside = moments_text(moments_near(happened, at_ns, int(misses.end_ns[worst]), BESIDE_NS))
        sentence += (
            f"; the worst, {misses.task[worst]} at {clock.text(at_ns)}, {_ms(misses.late_s[worst])} late, ran "
            f"{_ms(misses.run_s[worst])}, with: {beside}"
        )
        field = "due_ns" if misses.message == "/misses" else "DueUS"
        evidence += tuple(
            Evidence(misses.message, field, int(misses.due_ns[row]), int(misses.end_ns[row])) for row in own[:10]
        )
    step = "Give the agent a real-time priority and its own processor, or reduce the load of that machine."
    if node == "PS1":
        step = "The host was late with its steps. Close other programs on it, or lower clock.physics_rate_hz."
    if by_clock == missed:
        step = "See in the time bases why the clock stepped. The tasks themselves were on time."
    return Finding("scheduler.deadlines_missed", severity, sentence, evidence, step)


def _ms(seconds: float) -> str:
    return f"{1e3 * float(seconds):.1f} ms"


def _missed_grid(misses: MissedDeadlines, happened: Sequence[Moment], clock: LogClock) -> Grid:
    rows: list[tuple[Value, ...]] = []
    order = np.argsort(misses.due_ns, kind="stable")
    for row in order.tolist()[:600]:
        beside = moments_text(moments_near(happened, int(misses.due_ns[row]), int(misses.end_ns[row]), BESIDE_NS))
        rows.append(
            (
                clock.second(int(misses.due_ns[row])),
                misses.task[row],
                rounded(misses.late_s[row] * 1e3),
                rounded(misses.run_s[row] * 1e3),
                int(misses.skipped[row]),
                beside,
            )
        )
    columns = ("due (s)", "task", "late (ms)", "ran (ms)", "skipped", "with")
    return Grid.limited("misses", "Missed deadlines, and coincident events", columns, rows)


def _missed_plots(misses: MissedDeadlines, by_step: Flags) -> tuple[Plot, ...]:
    names = np.array(misses.task)
    traces = []
    for name in dict.fromkeys(misses.task):
        mine = names == name
        traces.append(Trace(f"{name}: late", misses.due_ns[mine], misses.late_s[mine] * 1e3, "points"))
    traces.append(Trace("run time", misses.due_ns, misses.run_s * 1e3, "points"))
    marks = tuple(
        Mark(int(misses.due_ns[row]), "clock leapt ahead", None, Severity.NOTICE)
        for row in np.flatnonzero(by_step)[:MOST_MARKS].tolist()
    )
    return (Plot("misses", "Deadlines missed", "ms", tuple(traces), marks=marks),)


_STILL = "The run was in lockstep: time stands still while a task runs, so no deadline could be missed."
_NO_PM = "The log has no PM: set bit 3 of LOG_BITMASK (PM) to log the timing of the main loop."


def analyse(log: Log) -> Section | None:
    """Section on deadlines; None for a recording without them, and for telemetry, which has none."""
    windows = loop_windows(log)
    tasks = task_totals(log)
    misses = missed_deadlines(log)
    if windows is None and not tasks and misses is None:
        if log.format != "dataflash":
            return None
        return Section("scheduler", "Scheduler", lacks=(_NO_PM,))
    steps = clock_steps(log)
    leaps = [
        Moment(
            step.at_ns - round(step.size_s * 1e9), step.at_ns, "clock", f"its clock leapt {step.size_s:.3f} s ahead", ""
        )
        for step in steps
    ]
    happened = [*moments(log), *leaps]
    clock = LogClock(log)
    parts: list[Section] = []
    if tasks and clock_stood_still(tasks):
        parts.append(Section("scheduler", "Deadlines", lacks=(_STILL,)))
        tasks = []
    if windows is not None:
        parts.append(long_loop_section(log, windows, happened, clock))
    if tasks or misses is not None:
        parts.append(missed_section(tasks, misses, steps, happened, clock))
    findings = [finding for part in parts for finding in part.findings]
    if not findings and not any(part.lacks for part in parts):
        kept = [] if windows is None else ["every loop"]
        kept += [f"every cycle of {len(tasks)} task{'' if len(tasks) == 1 else 's'}"] if tasks else []
        findings = [Finding.ok("scheduler.on_time", f"{' and '.join(kept)} kept its time")] if kept else []
    return replace(Section.joined("scheduler", "Scheduler", parts), findings=tuple(findings))


def clock_steps(log: Log) -> list[ClockStep]:
    """Steps of a node's own clock: a task that waits for it skips the interval of a step."""
    return [
        step
        for relation in clock_relations(log)
        if relation.readings.key.startswith(("clocks.", "samples."))
        for step in relation.steps
        if step.size_s > 0.0
    ]
