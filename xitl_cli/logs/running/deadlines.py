"""Deadlines of periodic tasks: totals of each task, and every one that was missed.

DataFlash of ours: TASK, TSKQ, MISS on the agent's clock. MCAP of ours: /tasks, /misses in simulation time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.table import Table

TASK_FIELDS = {"node", "task", "rate_hz", "cycles", "missed", "skipped"}
MISS_FIELDS = {"node", "task", "due_ns", "start_ns", "end_ns", "skipped"}


@dataclass(frozen=True, slots=True)
class TaskTotal:
    """One task up to the end of the log; times in s, None where not known; worst_*_ns on the log's own time.

    missed includes skipped: cycles that never ran.
    """

    node: str
    task: str
    rate_hz: float
    cycles: int
    missed: int
    skipped: int
    start_mean_s: float | None
    start_max_s: float | None
    worst_start_ns: int | None
    run_mean_s: float | None
    run_max_s: float | None
    worst_run_ns: int | None

    @property
    def name(self) -> str:
        return f"{self.node} {self.task}".strip()

    @property
    def ratio(self) -> float:
        """Missed of all that were due."""
        return self.missed / max(self.cycles + self.skipped, 1)


@dataclass(frozen=True, slots=True)
class Missed:
    """(N,) deadlines. due_ns, end_ns: on the log's own time. late_s: from there to the start. run_s: from the start."""

    task: tuple[str, ...]
    due_ns: NDArray[np.int64]
    late_s: NDArray[np.float64]
    run_s: NDArray[np.float64]
    skipped: NDArray[np.int64]
    message: str

    def __len__(self) -> int:
        return len(self.due_ns)

    @property
    def end_ns(self) -> NDArray[np.int64]:
        after: NDArray[np.int64] = self.due_ns + np.round((self.late_s + self.run_s) * 1e9).astype(np.int64)
        return after


def totals(log: Log) -> list[TaskTotal]:
    """The last count of every task."""
    table = log.tables.get("/tasks")
    if table is not None and set(table.columns) >= TASK_FIELDS:
        return _recorded(table)
    table = log.tables.get("TASK")
    if table is not None and {"Name", "Rate", "N", "Miss", "Skip"} <= set(table.columns):
        return _logged(table, log.tables.get("TSKQ"))
    return []


def still(tasks: Sequence[TaskTotal]) -> bool:
    """Whether the clock stood still while the tasks ran, as it does in lockstep."""
    return not any(task.run_max_s or task.start_max_s or task.missed for task in tasks)


def _recorded(table: Table) -> list[TaskTotal]:
    names = list(zip(table.values("node").tolist(), table.values("task").tolist(), strict=True))
    last = {name: row for row, name in enumerate(names)}
    return [
        TaskTotal(
            str(node),
            str(task),
            float(table.values("rate_hz", slice(row, row + 1))[0]),
            _count(table, "cycles", row),
            _count(table, "missed", row),
            _count(table, "skipped", row),
            _part(table, "start_jitter_mean_s", row, 1.0),
            _part(table, "start_jitter_max_s", row, 1.0),
            _instant(table, "worst_start_ns", row, 1),
            _part(table, "run_mean_s", row, 1.0),
            _part(table, "run_max_s", row, 1.0),
            _instant(table, "worst_run_ns", row, 1),
        )
        for (node, task), row in last.items()
    ]


def _logged(table: Table, worst: Table | None) -> list[TaskTotal]:
    last = {str(name): row for row, name in enumerate(table.values("Name").tolist())}
    worst_rows: dict[int, int] = {}
    if worst is not None and "I" in worst.columns:
        worst_rows = {int(number): row for row, number in enumerate(worst.values("I", raw=True).tolist())}
    found = []
    for name, row in last.items():
        number = int(table.values("I", slice(row, row + 1), raw=True)[0]) if "I" in table.columns else -1
        other = worst_rows.get(number)
        found.append(
            TaskTotal(
                "",
                name,
                float(table.values("Rate", slice(row, row + 1), raw=True)[0]),
                _count(table, "N", row),
                _count(table, "Miss", row),
                _count(table, "Skip", row),
                _part(table, "JMean", row, 1e-6),
                _part(table, "JMax", row, 1e-6),
                None if worst is None or other is None else _instant(worst, "JAtUS", other, 1000),
                _part(table, "RMean", row, 1e-6),
                _part(table, "RMax", row, 1e-6),
                None if worst is None or other is None else _instant(worst, "RAtUS", other, 1000),
            )
        )
    return found


def _count(table: Table, column: str, row: int) -> int:
    return int(table.values(column, slice(row, row + 1), raw=True)[0])


def _part(table: Table, column: str, row: int, factor: float) -> float | None:
    if column not in table.columns:
        return None
    value = float(table.values(column, slice(row, row + 1), raw=True)[0]) * factor
    return value if np.isfinite(value) and value >= 0.0 else None


def _instant(table: Table, column: str, row: int, factor: int) -> int | None:
    if column not in table.columns:
        return None
    value = int(table.values(column, slice(row, row + 1), raw=True)[0])
    return value * factor if value > 0 else None


def missed(log: Log) -> Missed | None:
    """None where no deadlines are logged one by one, or none was missed."""
    table = log.tables.get("/misses")
    if table is not None and set(table.columns) >= MISS_FIELDS:
        due_ns, start_ns, end_ns = (
            np.asarray(table.values(column, raw=True)).astype(np.int64) for column in ("due_ns", "start_ns", "end_ns")
        )
        names = zip(table.values("node").tolist(), table.values("task").tolist(), strict=True)
        known = (due_ns >= 0) & (start_ns >= due_ns) & (end_ns >= start_ns)
        stamps = table.stamp_ns
        return Missed(
            tuple(f"{node} {task}" for node, task in names),
            np.where(known, due_ns, stamps),
            np.where(known, start_ns - due_ns, 0) * 1e-9,
            np.where(known, end_ns - start_ns, 0) * 1e-9,
            np.asarray(table.values("skipped", raw=True)).astype(np.int64),
            "/misses",
        )
    table = log.tables.get("MISS")
    if table is None or not {"Name", "DueUS", "Late", "Run", "Skip"} <= set(table.columns):
        return None
    late, run = (np.asarray(table.values(column, raw=True), dtype=np.float64) for column in ("Late", "Run"))
    return Missed(
        tuple(str(name) for name in table.values("Name")),
        np.asarray(table.values("DueUS", raw=True)).astype(np.int64) * 1000,
        late * 1e-6,
        run * 1e-6,
        np.asarray(table.values("Skip", raw=True)).astype(np.int64),
        "MISS",
    )
