"""Signals in a report page, for its picker: some rows of every message, within a total size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.named_signals import signal_columns
from xitl_cli.logs.model.table import Floats, Table, by_instance

MOST_BYTES = 3_000_000
"""Bytes of the numbers in the page, before base64 adds a third."""

_ROWS = (8000, 4000, 2000, 1000, 500, 250)
_MOST_COLUMNS = 48  # of one message
_MOST_ELEMENTS = 16  # of one field: a covariance is not a signal
_ABOUT_THE_LOG = frozenset(("FMT", "FMTU", "UNIT", "MULT", "PARM", "FILE", "ISBH", "ISBD"))


@dataclass(frozen=True, slots=True)
class HeldColumn:
    """A field of a message."""

    name: str
    unit: str
    held: bool
    """A state, which lasts until the next row."""
    values: Floats
    """(n,) float64."""


@dataclass(frozen=True, slots=True)
class HeldTable:
    """A message, or one instance of it."""

    name: str
    instance: int | None
    at_s: Floats
    """(n,) on the page's time line."""
    of: int
    """Number of rows in the log."""
    columns: tuple[HeldColumn, ...]


@dataclass(frozen=True, slots=True)
class HeldLog:
    """Signals of one log."""

    label: str
    """Name of the file if there are several."""
    tables: tuple[HeldTable, ...]
    rows: int
    """Largest number of rows of a message."""
    left_out: int = 0
    """Number of omitted fields."""

    @property
    def sentence(self) -> str:
        """Sentence on the share of the log in the page."""
        thinned = [table for table in self.tables if table.of > len(table.at_s)]
        rows = "every row of every message"
        if thinned:
            most = max(thinned, key=lambda table: table.of / len(table.at_s))
            rows = f"at most {self.rows} rows of a message, evenly chosen ({most.name}: {len(most.at_s)} of {most.of})"
        without = f"; without {self.left_out} fields of arrays and long messages" if self.left_out else ""
        return rows + without + ("; `xitl logs plot` uses every row" if thinned or self.left_out else "")


def held_log(log: Log, time_line: TimeLine, label: str, most_bytes: int = MOST_BYTES) -> HeldLog:
    """Signals of all messages of a log, with as many rows of each as fit."""
    all_tables: list[Table] = []
    for name, table in log.tables.items():
        if name in _ABOUT_THE_LOG:
            continue
        try:
            all_tables += log.frame_tables(name).values()
        except KeyError:
            all_tables.append(table)
    parts = [
        (table.name, number if table.instance is not None else None, part)
        for table in all_tables
        for number, part in by_instance(table).items()
    ]
    widths = [min(sum(1 for _ in _numbers(part)), _MOST_COLUMNS) for _, _, part in parts]
    rows = next(
        (
            rows
            for rows in _ROWS
            if sum(4 * (2 + width) * min(len(part), rows) for (_, _, part), width in zip(parts, widths, strict=True))
            <= most_bytes
        ),
        _ROWS[-1],
    )
    tables, left_out, left = [], 0, most_bytes
    for name, instance, part in parts:
        held, without = _held_table(name, instance, part, time_line, rows)
        size = 4 * (2 + len(held.columns)) * len(held.at_s)
        if size > left:
            left_out += len(held.columns) + without
            continue
        left, left_out = left - size, left_out + without
        if held.columns:
            tables.append(held)
    return HeldLog(label, tuple(tables), rows, left_out)


def _numbers(part: Table) -> Iterator[tuple[str, int | None]]:
    """Fields with one number per row, and the elements of short arrays."""
    for name in signal_columns(part):
        shape = part.columns[name].shape
        if name.startswith("_"):
            continue
        if not shape:
            yield name, None
        elif len(shape) == 1 and 0 < shape[0] <= _MOST_ELEMENTS:
            yield from ((name, element) for element in range(shape[0]))


def _held_table(
    name: str, instance: int | None, part: Table, time_line: TimeLine, most: int
) -> tuple[HeldTable, int]:  # fmt: skip
    """A table of the picker, and the number of omitted fields."""
    many = len(part)
    rows = np.unique(np.linspace(0, many - 1, min(many, most)).astype(np.intp))
    fields = list(_numbers(part))
    columns = []
    for field, element in fields[:_MOST_COLUMNS]:
        column = part.columns[field]
        try:
            stored = np.asarray(part.values(field, rows))
        except LogError:  # damaged beyond reading; the report shows it elsewhere
            continue
        values = stored if element is None else stored[:, element]
        held = stored.dtype.kind in "iub" and not column.unit
        label = field if element is None else f"{field}[{element}]"
        columns.append(HeldColumn(label, column.unit, held, values.astype(np.float64)))
    arrays = sum(1 for field in signal_columns(part) if part.columns[field].shape and (field, 0) not in fields)
    at_s = time_line.seconds(part.stamp_ns[rows])
    return HeldTable(name, instance, at_s, many, tuple(columns)), len(fields) - len(columns) + arrays
