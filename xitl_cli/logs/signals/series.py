"""A quantity over time as a series that can be compared; columns of tables as numeric arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Floats, Stamps, Table, by_instance, rising

SignalSource = Literal["estimate", "truth"]


@dataclass(frozen=True, slots=True)
class Series:
    """A quantity over time. N is at least 1."""

    stamp_ns: Stamps
    """(N,) strictly increasing, on the log's own time."""
    values: Floats
    """(N,) or (N, k), finite."""
    unit: str
    """Such as "deg", "m/s", "us"."""
    source: str
    """Message and field, for evidence ("ATT.Yaw")."""
    turns: bool = False
    """True for 360-degree angles in deg."""
    dropped: int = 0
    """Number of omitted rows, with a time that went back or a value that is not finite."""

    def interpolated(self, stamp_ns: Stamps) -> Floats:
        """(M,) or (M, k) linear interpolation between the samples (angles along the shorter arc), NaN outside them."""
        values = np.unwrap(self.values, period=360.0, axis=0) if self.turns else self.values
        where = (stamp_ns - self.stamp_ns[0]).astype(np.float64)
        known = (self.stamp_ns - self.stamp_ns[0]).astype(np.float64)
        columns = values.reshape(len(values), -1).T
        between = np.stack([np.interp(where, known, column, left=np.nan, right=np.nan) for column in columns], axis=-1)
        shaped: Floats = between.reshape((len(stamp_ns), *values.shape[1:]))
        return np.mod(shaped, 360.0) if self.turns else shaped


SeriesReader = Callable[[Log], Series | None]


def make_series(
    stamp_ns: Stamps, values: NDArray[Any], unit: str, source: str, *, turns: bool = False
) -> Series | None:
    """Make a series of valid rows; None if none is left."""
    numbers = np.asarray(values, dtype=np.float64)
    if not len(numbers):
        return None
    good = np.asarray(np.isfinite(numbers).reshape(len(numbers), -1).all(axis=1))
    stamps, numbers = stamp_ns[good], numbers[good]
    if not len(stamps):
        return None
    forward = rising(stamps)
    dropped = len(good) - int(forward.sum())
    return Series(stamps[forward].astype(np.int64), numbers[forward], unit, source, turns, dropped)


def column_series(
    log: Log, table: str, name: str, unit: str, *, factor: float = 1.0, turns: bool = False, raw: bool = False
) -> Series | None:
    """Column of a table of the log, times `factor`; of several instances, the lowest number."""
    found = first_instance(log, table)
    if found is None or name not in found.columns or found.columns[name].kind != "number":
        return None
    return make_series(found.stamp_ns, found.values(name, raw=raw) * factor, unit, f"{table}.{name}", turns=turns)


def channel_series(table: Table, values: Floats, unit: str, field: str, *, used_only: bool) -> dict[int, Series]:
    """One series for each column of `values` (N, k), by channel from 1. used_only: without those that are always 0."""
    channels: dict[int, Series] = {}
    for index in range(values.shape[1]):
        series = make_series(table.stamp_ns, values[:, index], unit, f"{table.name}.{field}[{index}]")
        if series is not None and (series.values.any() or not used_only):
            channels[index + 1] = series
    return channels


def first_instance(log: Log, table: str) -> Table | None:
    """The table, or its lowest instance if it has several."""
    found = log.tables.get(table)
    if found is None or found.instance is None:
        return found
    split = by_instance(found)
    return split[min(split)] if split else None


def first_series(log: Log, *ways: SeriesReader) -> Series | None:
    """Series of the first of these readers that has one."""
    for read in ways:
        series = read(log)
        if series is not None:
            return series
    return None


def stacked_columns(table: Table, names: tuple[str, ...]) -> Floats | None:
    """(N, k) of these columns; None if one is missing."""
    if not all(name in table.columns for name in names):
        return None
    return np.stack([np.asarray(table.values(name), dtype=np.float64) for name in names], axis=1)


_FARTHEST_NS = 1 << 61


def numbers(table: Table, name: str, *, raw: bool = False) -> Floats | None:
    """(N,) or (N, k), NaN if not finite; None if the table has no such numeric column."""
    column = table.columns.get(name)
    if column is None or column.kind != "number":
        return None
    values = np.array(table.values(name, raw=raw), dtype=np.float64)
    values[~np.isfinite(values)] = np.nan
    return values


def stacked(table: Table, names: Sequence[str], *, raw: bool = False) -> Floats | None:
    """(N, k) of k columns with one number per row; None if one is missing."""
    columns = [numbers(table, name, raw=raw) for name in names]
    known = [column for column in columns if column is not None and column.ndim == 1]
    return np.stack(known, axis=1) if len(known) == len(names) else None


def bounded_stamps(table: Table) -> Stamps:
    """(N,) stamps (ns), clipped to seventy years, so that the difference of any two fits in 64 bits."""
    return np.clip(table.stamp_ns, -_FARTHEST_NS, _FARTHEST_NS)


def message_of(name: str) -> str:
    """Message in the name of a table: "XITL_IMU" of "/link/agent/tx:XITL_IMU"."""
    return name.rsplit(":", 1)[-1]


def tables_of(log: Log, kinds: Sequence[str]) -> list[Table]:
    """Tables of these messages, from any link, in the order of `kinds`."""
    return [table for kind in kinds for name, table in log.tables.items() if message_of(name) == kind]


def instance_label(table: Table, number: int) -> str:
    """Name of an instance, such as "IMU[1]"; without the number if the message has no instances."""
    return table.name if table.instance is None else f"{table.name}[{number}]"


def rounded(value: float | np.floating | None, digits: int = 3) -> float | None:
    """Rounded value for facts and tables; None if not finite."""
    if value is None or not np.isfinite(value):
        return None
    return round(float(value), digits)


def significant(value: float | None, digits: int = 4) -> float | None:
    """Value rounded to significant digits for a Fact or a Grid; None if not finite."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{digits}g}")


def listed(instants: Sequence[str], most: int = 4) -> str:
    """Instants as a list, such as "0:03.0, 0:05.1 and 7 more"."""
    if len(instants) <= most:
        return ", ".join(instants)
    return f"{', '.join(instants[:most])} and {len(instants) - most} more"
