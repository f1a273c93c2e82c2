"""Processor time of each task: @SYS/tasks.txt of ArduPilot, TASK rows and /tasks of xitl."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Section, Value
from xitl_cli.logs.model.system_files import (
    MOST_OVERRUNS,
    MOST_US,
    TASKS_MOST_BYTES,
    TASKS_PATH,
    TaskTime,
    parse_tasks,
    tasks_counted,
)
from xitl_cli.logs.signals.deadlines import TaskTotal, clock_stood_still, simulated_clock_reason, task_totals
from xitl_cli.logs.signals.series import rounded

FILE_NAME = "tasks.txt"
NAMED = 5
_FETCH = (
    "@SYS/tasks.txt has the time of each task. Fetch it during a run with `xitl logs tasks` into a file beside the log."
)


def analyse(log: Log) -> Section | None:
    """Section on tasks; None if there are neither tasks nor a scheduler."""
    own = task_totals(log)
    if clock_stood_still(own):  # nothing was measured, which the scheduler section reports
        own = []
    found = task_file(log)
    if not own and found is None:
        if log.format != "dataflash":
            return None
        return Section("tasks", "Tasks", lacks=(_FETCH,))
    clock = LogClock(log)
    facts: list[Fact] = []
    findings: list[Finding] = []
    grids: list[Grid] = []
    lacks: list[str] = []
    if own:
        facts += _own_facts(own)
        grids.append(_own_grid(own, clock))
    if found is not None:
        times, source = found
        if tasks_counted(times):
            longest = max(times, key=lambda task: task.most_us)
            facts.append(Fact("scheduler_tasks", "Tasks of the scheduler", len(times)))
            facts.append(Fact("longest_task_us", f"Longest run ({longest.name})", longest.most_us, "us"))
            facts.append(Fact("overruns", "Runs over their budget", sum(task.overruns for task in times)))
            findings += _file_findings(times, source)
            grids.append(_file_grid(times, source))
        else:
            why = simulated_clock_reason(log) or "nothing was counted yet"
            lacks.append(f"{source} lists {len(times)} tasks without any time: {why}.")
    return Section("tasks", "Tasks", tuple(facts), tuple(findings), tuple(grids), (), tuple(lacks))


def task_file(log: Log) -> tuple[list[TaskTime], str] | None:
    """The tasks and their source: the log itself, else a file next to it. None if there is none."""
    if log.format != "dataflash" or "FILE" not in log.tables:
        embedded = []
    else:
        from xitl_cli.logs.model.system_files import embedded_contents

        embedded = [
            (bytes(content[:TASKS_MOST_BYTES]).decode("utf-8", "replace"), f"FILE {name}")
            for name, content in embedded_contents(log).items()
            if Path(name).name == FILE_NAME
        ]
    # Candidates: `<log>.tasks.txt`, or tasks.txt in the log's folder.
    found = []
    for candidate in (
        log.path.with_name(log.path.name + "." + FILE_NAME),
        log.path.with_suffix("." + FILE_NAME),
        log.path.with_name(FILE_NAME),
    ):
        try:
            with candidate.open("rb") as file:
                found.append((file.read(TASKS_MOST_BYTES).decode("utf-8", "replace"), candidate.name))
        except OSError:
            continue
    for text, source in (*embedded, *found):
        tasks = parse_tasks(text)
        if tasks:
            return tasks, source
    return None


def _own_facts(own: list[TaskTotal]) -> Iterator[Fact]:
    runs = [task for task in own if task.run_max_s is not None]
    starts = [task for task in own if task.start_max_s is not None]
    yield Fact("tasks", "Periodic tasks", len(own))
    if runs:
        longest = max(runs, key=lambda task: task.run_max_s or 0.0)
        yield Fact("longest_run_ms", f"Longest run ({longest.name})", _ms(longest.run_max_s), "ms")
    if starts:
        latest = max(starts, key=lambda task: task.start_max_s or 0.0)
        yield Fact("latest_start_ms", f"Latest start ({latest.name})", _ms(latest.start_max_s), "ms")


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else rounded(1e3 * seconds)


def _own_grid(own: list[TaskTotal], clock: LogClock) -> Grid:
    def second(at_ns: int | None) -> float | None:
        return None if at_ns is None else clock.second(at_ns)

    def busy(task: TaskTotal) -> float | None:
        return None if task.run_mean_s is None else rounded(100.0 * task.run_mean_s * task.rate_hz, 2)

    rows: list[tuple[Value, ...]] = [
        (
            task.name,
            rounded(task.rate_hz, 1),
            task.cycles,
            task.missed,
            task.skipped,
            _ms(task.start_mean_s),
            _ms(task.start_max_s),
            second(task.worst_start_ns),
            _ms(task.run_mean_s),
            _ms(task.run_max_s),
            second(task.worst_run_ns),
            busy(task),
        )
        for task in sorted(own, key=lambda task: -(task.run_mean_s or 0.0) * task.rate_hz)
    ]
    columns = (
        "task", "rate (Hz)", "cycles", "missed", "skipped", "start late, mean (ms)", "most (ms)", "at (s)",
        "run, mean (ms)", "longest (ms)", "at (s) ", "of a processor (%)",
    )  # fmt: skip
    return Grid.limited("tasks", "Tasks, the slowest first", columns, rows)


def _file_findings(times: list[TaskTime], source: str) -> Iterator[Finding]:
    over = sorted((task for task in times if task.overruns), key=lambda task: -task.overruns)
    if not over:
        yield Finding.ok("tasks.in_time", f"None of {len(times)} tasks ran longer than it is allowed")
        return
    named = ", ".join(f"{task.name} {task.overruns} (up to {task.most_us} us)" for task in over[:NAMED])
    more = f" and {len(over) - NAMED} more" if len(over) > NAMED else ""
    yield Finding.notice(
        "tasks.overruns",
        f"{len(over)} of {len(times)} tasks ran longer than the scheduler allows them: {named}{more}",
        (Evidence(source, "OVR", value=str(sum(task.overruns for task in over))),),
        "It matters where long loops come together with it; a task that overruns in every window wants its cause "
        "found (a slow device, a file, a script).",
    )


def _file_grid(times: list[TaskTime], source: str) -> Grid:
    def capped(value: int, most: int) -> Value:
        return f"{most} or more" if value >= most else value

    rows: list[tuple[Value, ...]] = [
        (
            task.name,
            "yes" if task.fast else "",
            task.share_percent,
            task.mean_us if task.mean_us < MOST_US else f"{MOST_US} or more",
            capped(task.most_us, MOST_US),
            task.least_us,
            capped(task.overruns, MOST_OVERRUNS),
        )
        for task in sorted(times, key=lambda task: (-task.share_percent, -task.most_us))
        if task.most_us or task.overruns or task.share_percent
    ]
    columns = ("task", "every loop", "of all tasks (%)", "mean (us)", "longest (us)", "shortest (us)", "overruns")
    return Grid.limited(
        "task_file", f"Tasks of ArduPilot's scheduler in its last window, by {source} ({TASKS_PATH})", columns, rows
    )
