"""One quantity over time, fit to be compared: stamps increase, values are finite."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.table import Table

Of = Literal["estimate", "truth"]


@dataclass(frozen=True, slots=True)
class Series:
    """stamp_ns: (N,) strictly increasing, on the log's own time. values: (N,) or (N, k), finite. N is at least 1.

    unit: "deg", "m/s", "us" …; a series of 360-degree angles has unit "deg" and `turns`. source: where it was read, for
    evidence ("ATT.Yaw"). dropped: rows left out since they went back in time or were no number.
    """

    stamp_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    unit: str
    source: str
    turns: bool = False
    dropped: int = 0

    def at(self, stamp_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """(M,) or (M, k) between the samples on a straight line (an angle the short way round), NaN outside them."""
        values = np.unwrap(self.values, period=360.0, axis=0) if self.turns else self.values
        where = (stamp_ns - self.stamp_ns[0]).astype(np.float64)
        known = (self.stamp_ns - self.stamp_ns[0]).astype(np.float64)
        columns = values.reshape(len(values), -1).T
        found = np.stack([np.interp(where, known, column, left=np.nan, right=np.nan) for column in columns], axis=-1)
        shaped: NDArray[np.float64] = found.reshape((len(stamp_ns), *values.shape[1:]))
        return np.mod(shaped, 360.0) if self.turns else shaped


Way = Callable[[Log], Series | None]


def series(
    stamp_ns: NDArray[np.int64], values: NDArray[Any], unit: str, source: str, *, turns: bool = False
) -> Series | None:
    """Cleaned; None when nothing is left."""
    numbers = np.asarray(values, dtype=np.float64)
    if not len(numbers):
        return None
    good = np.asarray(np.isfinite(numbers).reshape(len(numbers), -1).all(axis=1))
    stamps, numbers = stamp_ns[good], numbers[good]
    if not len(stamps):
        return None
    newest = np.maximum.accumulate(stamps)
    forward = np.concatenate(([True], stamps[1:] > newest[:-1]))
    dropped = len(good) - int(forward.sum())
    return Series(stamps[forward].astype(np.int64), numbers[forward], unit, source, turns, dropped)


def column(
    log: Log, table: str, name: str, unit: str, *, factor: float = 1.0, turns: bool = False, raw: bool = False
) -> Series | None:
    """A column of a table of the log, times `factor`; of several instances the one numbered lowest."""
    found = whole(log, table)
    if found is None or name not in found.columns or found.columns[name].kind != "number":
        return None
    return series(found.stamp_ns, found.values(name, raw=raw) * factor, unit, f"{table}.{name}", turns=turns)


def whole(log: Log, table: str) -> Table | None:
    """The table, or its lowest instance when it has several."""
    found = log.tables.get(table)
    if found is None or found.instance is None:
        return found
    from xitl_cli.logs.table import by_instance

    split = by_instance(found)
    return split[min(split)] if split else None


def first(log: Log, *ways: Way) -> Series | None:
    """What the first of these ways finds."""
    return next((found for way in ways if (found := way(log)) is not None), None)


def vectors(table: Table, names: tuple[str, ...]) -> NDArray[np.float64] | None:
    """(N, k) of these columns; None unless all are there."""
    if not all(name in table.columns for name in names):
        return None
    return np.stack([np.asarray(table.values(name), dtype=np.float64) for name in names], axis=1)
