"""Quantities of a log over time, for comparison and figures: plain arrays that stay valid without the log."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.signals import Series

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TimeSeries:
    """A quantity over time."""

    time_s: Floats
    """(N,) rising, on the log's clock."""
    values: Floats
    """(N,)."""

    def __len__(self) -> int:
        return len(self.time_s)

    def between(self, from_s: float, until_s: float) -> TimeSeries:
        """Return the part from `from_s` to `until_s`, both included."""
        inside = (self.time_s >= from_s) & (self.time_s <= until_s)
        return TimeSeries(self.time_s[inside], self.values[inside])

    def since(self, from_s: float | None) -> TimeSeries:
        """Return the part from `from_s` on; all of it for None."""
        return self if from_s is None else self.between(from_s, float("inf"))

    def at(self, time_s: Floats) -> Floats:
        """Return (M,) by linear interpolation; NaN outside."""
        found: Floats = np.interp(time_s, self.time_s, self.values, left=np.nan, right=np.nan)
        return found


def time_series(series: Series | None, column: int | None = None) -> TimeSeries | None:
    """Return a series, or one of its columns, in seconds of the log's clock."""
    if series is None:
        return None
    values = series.values if column is None else series.values[:, column]
    return TimeSeries((series.stamp_ns * 1e-9).astype(np.float64), np.array(values, dtype=np.float64))


def true_path_ne_m(run: Log) -> Floats:
    """Return (N, 2) north and east over ground from a run's recording."""
    found: Floats = np.asarray(run.tables["/truth/state"].values("position_ned_m"), dtype=np.float64)[:, :2]
    return found


def first_s(log: Log, name: str, holds: Callable[[Table], NDArray[np.bool_]]) -> float | None:
    """Return the first time at which a row of this table fulfils `holds`, in seconds of the log's clock.

    None without such a row.
    """
    table = log.tables.get(name)
    if table is None or not len(table):
        return None
    rows = np.flatnonzero(holds(table))
    return float(table.stamp_ns[rows[0]]) * 1e-9 if len(rows) else None
