"""Check whether a run of xitl kept real time, by the limits of its summary's verdict."""

from __future__ import annotations

import numpy as np

from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Section
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.signals.deadlines import task_totals
from xitl_cli.logs.signals.real_time import (
    LinkLosses,
    RealTimeFigures,
    TaskMissCount,
    not_real_time,
    worst,
    worst_link,
)
from xitl_cli.logs.signals.series import rounded
from xitl_cli.plugins.logs.analyses.faults import fault_spans

PACE, CLOCKS, LINKS = "/pace", "/clocks", "/links"
HOST, COMPANION = "PS1", "HC"


def analyse(log: Log) -> Section | None:
    """Section on real time; None for a log that is not of a run in real time."""
    figures = measured(log)
    if figures is None:
        return None
    shortfalls = figures.shortfalls()
    if shortfalls:
        evidence: list[Evidence] = []
        if figures.stalls:
            evidence.append(Evidence(PACE, "stalled_s", value=f"{figures.stalled_s:.2f} s"))
        if figures.physics is not None and figures.physics.missed:
            evidence.append(Evidence("/tasks", "missed", value=f"{figures.physics.missed} of {figures.physics.cycles}"))
        if figures.control is not None and figures.control.missed:
            named = f"{figures.control.name} {figures.control.missed} of {figures.control.cycles}"
            evidence.append(Evidence("/tasks", "missed", value=named))
        if figures.link is not None and figures.link.lost:
            evidence.append(Evidence(LINKS, "lost", value=f"{figures.link.name} {figures.link.lost}"))
        for name, steps in figures.clock_steps:
            evidence.append(Evidence(CLOCKS, "steps", value=f"{name} {steps}"))
        finding = Finding.critical(
            "real_time.not_kept",
            not_real_time(shortfalls),
            tuple(evidence),
            "Do not use its timing as that of a real system. Run it on a machine with less load, with a "
            "PREEMPT_RT kernel or a lower clock.physics_rate_hz, or in lockstep (`xitl doctor` checks the machine).",
        )
    else:
        finding = Finding.ok("real_time.kept", "The run kept real time")
    facts: list[Fact] = []
    if figures.physics is not None:
        facts.append(Fact("physics_missed", "Physics deadlines missed", _percent(figures.physics.share), "%"))
    if figures.control is not None:
        label = f"Cycles missed of {figures.control.name}"
        facts.append(Fact("agent_missed", label, _percent(figures.control.share), "%"))
    if figures.link is not None:
        facts.append(Fact("lost", f"Frames lost of {figures.link.name}", _percent(figures.link.share), "%"))
    facts.append(Fact("stalls", "Stalls of more than 40 ms", figures.stalls))
    facts.append(Fact("stalled_s", "In all", rounded(figures.stalled_s), "s"))
    facts.append(Fact("longest_stall_s", "The longest", rounded(figures.longest_stall_s), "s"))
    facts.append(Fact("slipped_s", "Behind the wall clock, not caught up", rounded(figures.slipped_s), "s"))
    return Section("real_time", "Real time", tuple(facts), (finding,))


def measured(log: Log) -> RealTimeFigures | None:
    """Figures of a recording; None for another kind of log, or a lockstep run."""
    pace = log.tables.get(PACE)
    if pace is None or not len(pace):
        return None
    spared = any(group == "agent" for fault in fault_spans(log) for group, _, _ in fault.wrong)
    tasks = [
        (task.node, TaskMissCount(task.name, task.cycles + task.skipped, task.missed)) for task in task_totals(log)
    ]
    table = log.tables.get(LINKS)
    losses: list[LinkLosses] = []
    for name, row in _rows_of(table, "name").items():
        assert table is not None
        sent = round(_last(table, "sent", row))
        if sent and "lost" in table.columns and float(table.values("lost")[row]) >= 0.0:
            losses.append(
                LinkLosses(name, sent, max(round(_last(table, "lost", row) - _last(table, "impaired", row)), 0))
            )
    clocks = log.tables.get(CLOCKS)
    clock_steps: list[tuple[str, int]] = []
    if clocks is not None and not spared:
        steps = {name: round(_last(clocks, "steps", row)) for name, row in _rows_of(clocks, "node").items()}
        clock_steps = [(name, many) for name, many in steps.items() if many and name != HOST]
    return RealTimeFigures(
        length_s=_wall_s(log),
        physics=worst([task for node, task in tasks if node == HOST]),
        control=None if spared else worst([task for node, task in tasks if node not in (HOST, COMPANION)]),
        link=worst_link(losses),
        stalls=round(_last(pace, "stalls")),
        stalled_s=_last(pace, "stalled_s"),
        longest_stall_s=_last(pace, "longest_stall_s"),
        slipped_s=_last(pace, "slipped_s"),
        clock_steps=tuple(clock_steps),
    )


def _last(table: Table, name: str, row: int = -1) -> float:
    """Last value of a column; 0 if unknown."""
    if name not in table.columns:
        return 0.0
    value = float(table.values(name)[row])
    return max(value, 0.0) if np.isfinite(value) else 0.0


def _wall_s(log: Log) -> float:
    """Length of the run by the host's own clock, else by simulation time plus the time for which it was held."""
    clocks = log.tables.get(CLOCKS)
    if clocks is not None and {"node", "host_ns"} <= set(clocks.columns):
        host_ns = np.asarray(clocks.values("host_ns"))[np.asarray(clocks.values("node")) == HOST]
        if len(host_ns) > 1:
            return float(host_ns[-1] - host_ns[0]) * 1e-9
    span = log.span_ns
    return 0.0 if span is None else (span[1] - span[0]) * 1e-9 + _last(log.tables[PACE], "slipped_s")


def _rows_of(table: Table | None, key: str) -> dict[str, int]:
    """Last row of each name."""
    if table is None or key not in table.columns:
        return {}
    return {str(name): row for row, name in enumerate(table.values(key).tolist())}


def _percent(share: float) -> float | None:
    return rounded(100.0 * share, 3)
