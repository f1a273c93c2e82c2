"""Deadlines: long loops of ArduPilot (PM), missed deadlines of ours, and what else happened then."""

from __future__ import annotations

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.analyses.scheduler import long_loops, missed_deadlines
from xitl_cli.logs.log import Log
from xitl_cli.logs.running import deadlines, loops, moments
from xitl_cli.logs.sections import Finding, Section, Severity
from xitl_cli.logs.timeline.relations import relations
from xitl_cli.logs.timeline.steps import Step

_STILL = "The run was in lockstep: time stands still while a task runs, so no deadline could be missed."
_NO_PM = "The log has no PM: set bit 3 of LOG_BITMASK (PM) to log how the main loop kept its time."


def analyse(log: Log) -> Section | None:
    """None for a recording without deadlines, and for telemetry, which carries none."""
    windows = loops.loops(log)
    tasks = deadlines.totals(log)
    misses = deadlines.missed(log)
    if windows is None and not tasks and misses is None:
        if log.format != "dataflash":
            return None
        return Section("scheduler", "Scheduler", lacks=(_NO_PM,))
    steps = clock_steps(log)
    happened = [*moments.moments(log), *(_moment(step) for step in steps)]
    instants = Instants(log)
    parts: list[Section] = []
    if tasks and deadlines.still(tasks):
        parts.append(Section("scheduler", "Deadlines", lacks=(_STILL,)))
        tasks = []
    if windows is not None:
        parts.append(long_loops.section(log, windows, happened, instants))
    if tasks or misses is not None:
        parts.append(missed_deadlines.section(tasks, misses, steps, happened, instants))
    findings = [finding for part in parts for finding in part.findings]
    if not findings and not any(part.lacks for part in parts):
        kept = [] if windows is None else ["every loop"]
        kept += [f"every cycle of {len(tasks)} task{'' if len(tasks) == 1 else 's'}"] if tasks else []
        findings = [Finding("scheduler.on_time", Severity.OK, f"{' and '.join(kept)} kept its time")] if kept else []
    return Section(
        "scheduler",
        "Scheduler",
        tuple(fact for part in parts for fact in part.facts),
        tuple(findings),
        tuple(grid for part in parts for grid in part.grids),
        tuple(plot for part in parts for plot in part.plots),
        tuple(lack for part in parts for lack in part.lacks),
    )


def clock_steps(log: Log) -> list[Step]:
    """Of a node's own clock: what waits for one skips what it leaps over."""
    return [
        step
        for relation in relations(log)
        if relation.readings.key.startswith(("clocks.", "samples."))
        for step in relation.steps
        if step.size_s > 0.0
    ]


def _moment(step: Step) -> moments.Moment:
    begin = step.at_ns - round(step.size_s * 1e9)
    return moments.Moment(begin, step.at_ns, "clock", f"its clock leapt {step.size_s:.3f} s ahead", "")
