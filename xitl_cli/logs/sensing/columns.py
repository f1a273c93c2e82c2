"""Columns as numbers that can be computed with, and numbers as an answer may show them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.table import Table

_FARTHEST_NS = 1 << 61


def numbers(table: Table, name: str, *, raw: bool = False) -> NDArray[np.float64] | None:
    """(N,) or (N, k), NaN for what is no finite number; None when the table has no such column of numbers."""
    column = table.columns.get(name)
    if column is None or column.kind != "number":
        return None
    values = np.array(table.values(name, raw=raw), dtype=np.float64)
    values[~np.isfinite(values)] = np.nan
    return values


def stacked(table: Table, names: Sequence[str], *, raw: bool = False) -> NDArray[np.float64] | None:
    """(N, k) of k columns of one number a row; None unless all are there."""
    columns = [numbers(table, name, raw=raw) for name in names]
    found = [column for column in columns if column is not None and column.ndim == 1]
    return np.stack(found, axis=1) if len(found) == len(names) else None


def stamps(table: Table) -> NDArray[np.int64]:
    """(N,) the stamps (ns), those gone wild brought within seventy years: differences of any two then fit."""
    return np.clip(table.stamp_ns, -_FARTHEST_NS, _FARTHEST_NS)


def kind_of(name: str) -> str:
    """Message behind the name of a table: "XITL_IMU" of "/link/agent/tx:XITL_IMU"."""
    return name.rsplit(":", 1)[-1]


def tables_of(log: Log, kinds: Sequence[str]) -> list[Table]:
    """The tables of these messages, of whichever link, in the order of `kinds`."""
    return [table for kind in kinds for name, table in log.tables.items() if kind_of(name) == kind]


def labelled(table: Table, number: int) -> str:
    """ "IMU[1]"; without the number when the message has no instances."""
    return table.name if table.instance is None else f"{table.name}[{number}]"


def told(value: float | None, digits: int = 4) -> float | None:
    """Rounded to significant digits for a Fact or a Grid; None for what is no finite number."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{digits}g}")


def some(instants: Sequence[str], most: int = 4) -> str:
    """ "0:03.0, 0:05.1 and 7 more"."""
    if len(instants) <= most:
        return ", ".join(instants)
    return f"{', '.join(instants[:most])} and {len(instants) - most} more"
