"""The one model behind every format: a log holds tables, a table has columns, a column is an array.

    Log.tables["ATT"].values("Roll")          (N,) degrees
    Log.tables["/truth/state"].stamp_ns       (N,) nanoseconds since the log's own zero

Nothing is read before it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Flags = NDArray[np.bool_]
Rows = slice | NDArray[np.intp] | NDArray[np.bool_]
ALL = slice(None)

Kind = Literal["number", "text", "bytes"]


@dataclass(frozen=True, slots=True)
class Column:
    """unit: of what `values` returns, "" when the log names none. raw_unit: of `values(…, raw=True)`.

    shape: of one row's value, () for a number. It may be (-1,) where it differs from row to row; `values` then pads
    with NaN.
    """

    name: str
    unit: str = ""
    raw_unit: str = ""
    kind: Kind = "number"
    shape: tuple[int, ...] = ()


class Table(Protocol):
    """All messages of one type, in the order of the file."""

    @property
    def name(self) -> str: ...

    @property
    def columns(self) -> Mapping[str, Column]:
        """In the log's order."""
        ...

    @property
    def instance(self) -> str | None:
        """The column that tells the instances of a message apart (of IMU, GPS …)."""
        ...

    def __len__(self) -> int: ...

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        """(N,) since the log's own zero (`Log.base`), as logged: it may repeat or go back. Read-only.

        A time that cannot be, which is damage, is that of the row before (`Health.replaced_stamps`).
        """
        ...

    @property
    def place(self) -> NDArray[np.int64]:
        """(N,) increasing: where in the file each row is, in bytes. Orders rows across tables."""
        ...

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        """(n, *shape) numbers in the column's unit, or as stored (whole numbers stay whole numbers) with `raw`.

        Text is an array of str, bytes one of object. Raises KeyError when there is no such column.
        """
        ...


class Selection:
    """Some rows of a table, itself a table."""

    def __init__(self, table: Table, rows: Rows) -> None:
        self._table = table
        self._index: NDArray[np.intp] = np.arange(len(table), dtype=np.intp)[rows]

    @property
    def name(self) -> str:
        return self._table.name

    @property
    def columns(self) -> Mapping[str, Column]:
        return self._table.columns

    @property
    def instance(self) -> str | None:
        return self._table.instance

    def __len__(self) -> int:
        return len(self._index)

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        return self._table.stamp_ns[self._index]

    @property
    def place(self) -> NDArray[np.int64]:
        return self._table.place[self._index]

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        return self._table.values(column, self._index[rows], raw=raw)


def by_instance(table: Table) -> dict[int, Table]:
    """One table an instance, by number; the table itself under 0 when it has no instances."""
    if table.instance is None:
        return {0: table}
    numbers = table.values(table.instance, raw=True)
    return {int(number): Selection(table, numbers == number) for number in np.unique(numbers)}


def steps_back(stamp_ns: NDArray[np.int64]) -> int:
    """How many are earlier than the one before."""
    return int(np.count_nonzero(stamp_ns[1:] < stamp_ns[:-1]))


def first_of(table: Table, names: Sequence[str]) -> str | None:
    """The first of these columns that the table has: a field that was renamed."""
    return next((name for name in names if name in table.columns), None)
