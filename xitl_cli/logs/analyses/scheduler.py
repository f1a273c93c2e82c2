"""Deadlines: missed deadlines of periodic tasks and long loops of ArduPilot, each with simultaneous events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from xitl_cli.logs.analyses.long_loops import long_loop_section
from xitl_cli.logs.clocks.fit import ClockStep, clock_relations
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Flags
from xitl_cli.logs.signals.deadlines import (
    MissedDeadlines,
    TaskTotal,
    clock_stood_still,
    loop_windows,
    missed_deadlines,
    task_totals,
)
from xitl_cli.logs.signals.moments import Moment, moments, moments_near, moments_text
from xitl_cli.logs.signals.series import rounded

RATIO_WARNING, RATIO_CRITICAL = 0.01, 0.1
FEW = 3
BESIDE_NS = 500_000_000
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
                "How many cycles there were is not logged; compare with the rate of the task.",
            )
        )
    listed = 0 if misses is None else len(misses)
    counted = sum(task.missed for task in tasks)
    facts = (
        Fact("tasks", "Periodic tasks", len(tasks)),
        Fact("deadlines_missed", "Deadlines missed", counted if tasks else listed),
        Fact("cycles_skipped", "of those, cycles that never ran", sum(task.skipped for task in tasks)),
        Fact("misses_listed", "Misses logged one by one", listed),
    )
    return Section(
        "scheduler",
        "Deadlines",
        facts,
        tuple(findings),
        () if misses is None else (_grid(misses, happened, clock),),
        () if misses is None else _plots(misses, by_step),
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
    severity = max(_severity(task, max(task.missed - leapt[task.name], 0)) for task in tasks)
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
    step = "Give the agent a real-time priority and a processor of its own, or take load off that machine."
    if node == "PS1":
        step = "The host was late with its own steps: close other programs on it, or lower clock.physics_rate_hz."
    if by_clock == missed:
        step = "Look at the time bases for why the clock stepped; the tasks themselves kept their time."
    return Finding("scheduler.deadlines_missed", severity, sentence, evidence, step)


def _severity(task: TaskTotal, missed: int) -> Severity:
    ratio = missed / max(task.cycles + task.skipped, 1)
    if ratio <= RATIO_WARNING or missed <= FEW:
        return Severity.NOTICE
    return Severity.CRITICAL if ratio > RATIO_CRITICAL else Severity.WARNING


def _ms(seconds: float) -> str:
    return f"{1e3 * float(seconds):.1f} ms"


def _grid(misses: MissedDeadlines, happened: Sequence[Moment], clock: LogClock) -> Grid:
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
    return Grid.limited("misses", "Deadlines missed, and what else happened then", columns, rows)


def _plots(misses: MissedDeadlines, by_step: Flags) -> tuple[Plot, ...]:
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
_NO_PM = "The log has no PM: set bit 3 of LOG_BITMASK (PM) to log how the main loop kept its time."


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
    happened = [*moments(log), *(_moment(step) for step in steps)]
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


def _moment(step: ClockStep) -> Moment:
    begin = step.at_ns - round(step.size_s * 1e9)
    return Moment(begin, step.at_ns, "clock", f"its clock leapt {step.size_s:.3f} s ahead", "")
