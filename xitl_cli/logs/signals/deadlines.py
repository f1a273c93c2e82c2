"""Timing of programs: windows of ArduPilot's main loop (PM), totals and misses of periodic tasks (xitl).

DataFlash logs of xitl: TASK, TSKQ, MISS on the agent's clock. MCAP of xitl: /tasks, /misses in simulation time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Floats, Stamps, Table, first_of, whole_ns
from xitl_cli.logs.signals.states import LOCKSTEP, first_text

SITL_BOARD = 3  # VER.BT
LONGEST_WINDOW_NS = 60_000_000_000
USUAL_WINDOW_NS = 10_000_000_000
LONG_AT = 1.2

# The oldest name is last. Fields are grouped by meaning: counters since boot, and values of the window.
_LONG, _LOOPS, _LONGEST, _LOAD = ("NLon",), ("NL", "NLoop"), ("MaxT",), ("Load",)
_EXTRA, _RATE, _MEMORY = ("Ex", "ExUS"), ("LR",), ("Mem",)
_COUNTERS = (
    ("internal_errors", "internal errors", ("ErC", "ErrC", "IntEC")),
    ("spi", "SPI transactions", ("SPIC",)),
    ("i2c", "I2C transactions", ("I2CC",)),
    ("i2c_interrupts", "I2C interrupts", ("I2CI",)),
)


@dataclass(frozen=True, slots=True)
class LoopCounter:
    """A counter since boot."""

    key: str
    label: str
    field: str
    total: int
    grown: Floats
    """(N,) growth in each window, 0 after a restart."""


@dataclass(frozen=True, slots=True)
class LoopWindows:
    """Windows of the main loop; each array is (N,). An array of NaN means that this version lacks the field."""

    from_ns: Stamps
    """Beginning of each window."""
    until_ns: Stamps
    """End of each window."""
    loops: Floats
    long_loops: Floats
    """Loops of 1.2 periods and more."""
    longest_us: Floats
    """From one IMU sample to the next, not processor time."""
    load_percent: Floats
    """Saturates at 100 if the loop rate is below 95 % of its nominal value."""
    extra_us: Floats
    """Added to the loop's budget for tasks that are 8 times late."""
    rate_hz: Floats
    """Filtered loop rate."""
    memory_bytes: Floats
    """Free memory."""
    counters: tuple[LoopCounter, ...]
    names: tuple[tuple[str, str], ...]

    def field(self, meaning: str) -> str:
        """Name of the field in this version."""
        return dict(self.names)[meaning]

    @property
    def period_s(self) -> float | None:
        """Loop period by the autopilot's filtered rate, else by the windows."""
        rates = self.rate_hz[np.isfinite(self.rate_hz) & (self.rate_hz > 0.0)]
        if len(rates):
            return 1.0 / float(np.median(rates))
        length_s = (self.until_ns - self.from_ns).astype(np.float64) * 1e-9
        known = (self.loops > 0.0) & (length_s > 0.0)
        return float(np.median(length_s[known] / self.loops[known])) if known.any() else None


def loop_windows(log: Log) -> LoopWindows | None:
    """Windows of the log; None without a PM row."""
    table = log.tables.get("PM")
    if table is None or not len(table):
        return None
    until_ns = table.stamp_ns
    length_ns = np.diff(until_ns)
    usual = length_ns[(length_ns > 0) & (length_ns < LONGEST_WINDOW_NS)]
    usual_ns = int(np.median(usual)) if len(usual) else USUAL_WINDOW_NS
    from_ns = until_ns - np.concatenate(([usual_ns], length_ns))
    wrong = (from_ns >= until_ns) | (until_ns - from_ns > LONGEST_WINDOW_NS)
    from_ns = np.where(wrong, until_ns - usual_ns, from_ns)
    meanings = {
        "long_loops": _LONG, "loops": _LOOPS, "longest_us": _LONGEST, "load_percent": _LOAD, "extra_us": _EXTRA,
        "rate_hz": _RATE, "memory_bytes": _MEMORY,
    }  # fmt: skip
    names = {meaning: first_of(table, fields) for meaning, fields in meanings.items()}
    values = {meaning: _values(table, name) for meaning, name in names.items()}
    values["load_percent"] = values["load_percent"] * 0.1
    counters = []
    for key, label, fields in _COUNTERS:
        name = first_of(table, fields)
        if name is not None:
            counted = _values(table, name)
            grown = np.maximum(np.diff(counted, prepend=counted[:1]), 0.0)
            counters.append(LoopCounter(key, label, name, int(np.nansum(grown)), grown))
    known = tuple((meaning, name) for meaning, name in names.items() if name is not None)
    return LoopWindows(from_ns=from_ns, until_ns=until_ns, counters=tuple(counters), names=known, **values)


def _values(table: Table, name: str | None) -> Floats:
    """Values as stored; NaN without the field."""
    if name is None or table.columns[name].kind != "number":
        return np.full(len(table), np.nan)
    values = np.asarray(table.values(name, raw=True), dtype=np.float64)
    return values if values.ndim == 1 else np.full(len(table), np.nan)


def simulated_clock_reason(log: Log) -> str:
    """Reason why loop times in this log do not measure a processor; "" if they do."""
    version = log.tables.get("VER")
    if version is not None and "BT" in version.columns and SITL_BOARD in version.values("BT", raw=True)[-1:].tolist():
        return "the board is ArduPilot's own simulator (VER.BT 3)"
    if "SIM" in log.tables:
        return "a simulator writes into it (SIM)"
    if first_text(log, LOCKSTEP) is not None:
        return "it ran in lockstep (MSG)"
    found = loop_windows(log)
    if version is None and found is not None and len(found.until_ns) >= 3:
        load, longest = found.load_percent, found.longest_us
        if np.isfinite(load).all() and not load.any() and np.isfinite(longest).all() and len(set(longest[1:])) == 1:
            return "load is always 0 and the longest loop the same in every window"
    return ""


TASK_FIELDS = {"node", "task", "rate_hz", "cycles", "missed", "skipped"}
MISS_FIELDS = {"node", "task", "due_ns", "start_ns", "end_ns", "skipped"}


@dataclass(frozen=True, slots=True)
class TaskTotal:
    """Totals of one task up to the end of the log. Durations are None if unknown."""

    node: str
    task: str
    rate_hz: float
    cycles: int
    missed: int
    """Includes `skipped`."""
    skipped: int
    """Cycles that never ran."""
    start_mean_s: float | None
    start_max_s: float | None
    worst_start_ns: int | None
    """On the log's own time."""
    run_mean_s: float | None
    run_max_s: float | None
    worst_run_ns: int | None
    """On the log's own time."""

    @property
    def name(self) -> str:
        return f"{self.node} {self.task}".strip()

    @property
    def ratio(self) -> float:
        """Missed share of all due cycles."""
        return self.missed / max(self.cycles + self.skipped, 1)


@dataclass(frozen=True, slots=True)
class MissedDeadlines:
    """Missed deadlines; each array is (N,)."""

    task: tuple[str, ...]
    due_ns: Stamps
    """On the log's own time."""
    late_s: Floats
    """From the deadline to the start."""
    run_s: Floats
    """From the start to the end."""
    skipped: Stamps
    message: str

    def __len__(self) -> int:
        return len(self.due_ns)

    @property
    def end_ns(self) -> Stamps:
        after: Stamps = self.due_ns + whole_ns((self.late_s + self.run_s) * 1e9)
        return after


def task_totals(log: Log) -> list[TaskTotal]:
    """Last totals of every task."""
    table = log.tables.get("/tasks")
    if table is not None and set(table.columns) >= TASK_FIELDS:
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
    table = log.tables.get("TASK")
    if table is not None and {"Name", "Rate", "N", "Miss", "Skip"} <= set(table.columns):
        return _logged(table, log.tables.get("TSKQ"))
    return []


def clock_stood_still(tasks: Sequence[TaskTotal]) -> bool:
    """Whether the clock did not advance while the tasks ran, as in lockstep."""
    return not any(task.run_max_s or task.start_max_s or task.missed for task in tasks)


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


def missed_deadlines(log: Log) -> MissedDeadlines | None:
    """Missed deadlines; None if the log has no single deadlines, or none was missed."""
    table = log.tables.get("/misses")
    if table is not None and set(table.columns) >= MISS_FIELDS:
        due_ns, start_ns, end_ns = (
            np.asarray(table.values(column, raw=True)).astype(np.int64) for column in ("due_ns", "start_ns", "end_ns")
        )
        names = zip(table.values("node").tolist(), table.values("task").tolist(), strict=True)
        known = (due_ns >= 0) & (start_ns >= due_ns) & (end_ns >= start_ns)
        stamps = table.stamp_ns
        return MissedDeadlines(
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
    return MissedDeadlines(
        tuple(str(name) for name in table.values("Name")),
        np.asarray(table.values("DueUS", raw=True)).astype(np.int64) * 1000,
        late * 1e-6,
        run * 1e-6,
        np.asarray(table.values("Skip", raw=True)).astype(np.int64),
        "MISS",
    )
