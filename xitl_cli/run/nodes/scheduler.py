"""How the scheduler of an ArduPilot did, from the PM records of its DataFlash log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.errors import LogError
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.table import Table, first_of

_LOOPS = ("NL", "NLoop")  # by version


@dataclass(frozen=True, slots=True)
class SchedulerRecord:
    """Sums over all rows. long_loops: loops that took longer than the period allows. max_us: the longest loop.

    fields: the columns that this version logs. load_*_percent: of the processor's time. None: not logged.
    """

    rows: int
    fields: tuple[str, ...]
    loops: int | None = None
    long_loops: int | None = None
    max_us: int | None = None
    load_mean_percent: float | None = None
    load_max_percent: float | None = None


def scheduler_record(log: Path) -> SchedulerRecord | None:
    """From a DataFlash log; None when it cannot be read or has no PM records."""
    try:
        with DataFlashLog(log) as opened:
            table = opened.tables.get("PM")
            return None if table is None else _record(table)
    except LogError:
        return None


def _record(table: Table) -> SchedulerRecord:
    loops, long_loops = _column(table, first_of(table, _LOOPS)), _column(table, first_of(table, ("NLon",)))
    longest, load = _column(table, first_of(table, ("MaxT",))), _column(table, first_of(table, ("Load",)))
    return SchedulerRecord(
        rows=len(table),
        fields=tuple(name for name in table.columns if name != "TimeUS"),
        loops=None if loops is None else int(loops.sum()),
        long_loops=None if long_loops is None else int(long_loops.sum()),
        max_us=None if longest is None else int(longest.max()),
        load_mean_percent=None if load is None else float(load.mean()) / 10.0,
        load_max_percent=None if load is None else float(load.max()) / 10.0,
    )


def _column(table: Table, name: str | None) -> NDArray[np.float64] | None:
    """As logged, in single counts; None where no row has it."""
    if name is None or table.columns[name].kind != "number" or table.columns[name].shape:
        return None
    values = table.values(name, raw=True).astype(np.float64)
    known: NDArray[np.float64] = values[np.isfinite(values)]
    return known if len(known) else None
