"""The common model of all formats: a log holds tables, a table has columns, a column is an array.

    log["ATT"]["Roll"]                (N,) degrees
    log["/truth/state"].stamp_ns      (N,) nanoseconds since the log's own zero

Data is read on first use.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.text import listed, resolve_name

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Flags = NDArray[np.bool_]
Rows = slice | NDArray[np.intp] | NDArray[np.bool_]
ALL = slice(None)
MOST_ELEMENTS = 1024
"""Largest number of elements of an array column that gets flat columns."""
_FARTHEST_NS = 2.0**62

Kind = Literal["number", "text", "bytes"]


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table."""

    name: str
    unit: str = ""
    """Unit of `Table.values`; "" if the log names none."""
    raw_unit: str = ""
    """Unit of `Table.values` with `raw=True`."""
    kind: Kind = "number"
    shape: tuple[int, ...] = ()
    """Shape of the value of one row; () for a number. It is (-1,) if it differs from row to row; `values` then pads
    with NaN.
    """


class Table(ABC):
    """All messages of one type, in the order of the file. Iterating gives the names of its columns.

        table = xitl.open_log("flight.bin")["ATT"]
        table["Roll"]  # (N,) in the unit of table.columns["Roll"]
        table.values("Roll", slice(10), raw=True)  # the first ten, as stored
        table.stamp_ns  # (N,) time in ns since the log's own zero

    name: name of the message or topic. instance: the column with the instance number of a message (for IMU, GPS …),
    None if there is none.
    """

    name: str
    instance: str | None = None

    @property
    @abstractmethod
    def columns(self) -> Mapping[str, Column]:
        """Columns by name, in the log's order."""

    @abstractmethod
    def __len__(self) -> int:
        """Number of rows."""

    @property
    def indexed_rows(self) -> int:
        """Number of rows from the file's index, without reading the rows; `len` if there is no index."""
        return len(self)

    @property
    @abstractmethod
    def stamp_ns(self) -> NDArray[np.int64]:
        """(N,) ns since the log's own zero (`Log.base`), as logged: it may repeat or go back. Read-only.

        An impossible time (from damage) is replaced by that of the row before (`LogHealth.replaced_stamps`).
        """

    @property
    @abstractmethod
    def file_offset(self) -> NDArray[np.int64]:
        """(N,) increasing position of each row in the file, in bytes. It orders rows across tables."""

    @abstractmethod
    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        """(n, *shape) numbers in the column's unit, or as stored (whole numbers stay whole numbers) with `raw`.

        Text is an array of str, bytes an array of object. Raises KeyError if there is no such column.
        """

    @property
    def ends_ns(self) -> tuple[int, int] | None:
        """Stamps of the first and the last row; None if rows have no time."""
        stamps = self.stamp_ns
        return (int(stamps[0]), int(stamps[-1])) if len(stamps) else None

    @cached_property
    def selections(self) -> Mapping[int, Table]:
        """One table per instance, by its number; the table itself as 0 if it has no instances.

        In a damaged log, the column of the instance can be a text or an array. The table then has no instances.
        """
        column = None if self.instance is None else self.columns[self.instance]
        if column is None or column.kind != "number" or column.shape:
            return {0: self}
        numbers = self.values(column.name, raw=True)
        small = numbers.dtype == np.uint8
        every = np.flatnonzero(np.bincount(numbers)) if small else np.unique(numbers)
        return {int(number): Selection(self, numbers == number) for number in every}

    def __getitem__(self, column: str) -> NDArray[Any]:
        """Like `values`, for all rows. Raises UnknownNameError, which names the nearest column."""
        return self.values(column_named(self, column))

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __contains__(self, column: object) -> bool:
        return column in self.columns

    def to_pandas(self, *, raw: bool = False) -> Any:
        """A pandas.DataFrame of all rows by `time_s`, seconds since the log's own zero.

        An array of k numbers becomes k columns, `name[0]` and so on. An array with more than 1024 numbers is omitted.
        `frame.attrs["units"]` has the units by column. Raises LogError if pandas is not installed.
        """
        return data_frame(self, raw)


class Selection(Table):
    """Some rows of a table, as a table."""

    def __init__(self, table: Table, rows: Rows) -> None:
        self._table = table
        self._index: NDArray[np.intp] = np.arange(len(table), dtype=np.intp)[rows]
        self.name, self.instance = table.name, table.instance

    @property
    def columns(self) -> Mapping[str, Column]:
        return self._table.columns

    def __len__(self) -> int:
        return len(self._index)

    @cached_property
    def stamp_ns(self) -> NDArray[np.int64]:
        stamps = self._table.stamp_ns[self._index]
        stamps.flags.writeable = False
        return stamps

    @property
    def file_offset(self) -> NDArray[np.int64]:
        return self._table.file_offset[self._index]

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        return self._table.values(column, self._index[rows], raw=raw)


def by_instance(table: Table) -> dict[int, Table]:
    """One table per instance, by its number; the table itself as 0 if it has no instances."""
    return dict(table.selections)


def whole_ns(ns: Floats) -> Stamps:
    """Nanoseconds as whole numbers. Values outside the range of a stamp, which damage causes, are clipped to it."""
    return np.clip(np.rint(np.nan_to_num(ns)), -_FARTHEST_NS, _FARTHEST_NS).astype(np.int64)


def seconds_since(zero_ns: int, stamp_ns: Stamps) -> Floats:
    """(N,) seconds since the stamp `zero_ns`."""
    return np.multiply(stamp_ns - zero_ns, 1e-9, dtype=np.float64)


def distinct(stamp_ns: Stamps) -> Stamps:
    """(D,) sorted stamps without repetitions. Nearly sorted stamps take a fraction of the time of `np.unique`."""
    ordered = np.sort(stamp_ns, kind="stable")
    first = np.ones(len(ordered), dtype=np.bool_)
    np.not_equal(ordered[1:], ordered[:-1], out=first[1:])
    return ordered[first]


def rising(stamp_ns: Stamps) -> Flags:
    """(N,) True in rows that are later than all previous rows."""
    if not len(stamp_ns):
        return np.ones(0, dtype=np.bool_)
    newest = np.maximum.accumulate(stamp_ns)
    return np.concatenate(([True], stamp_ns[1:] > newest[:-1]))


def steps_back(stamp_ns: NDArray[np.int64]) -> int:
    """Number of stamps earlier than the previous stamp."""
    return int(np.count_nonzero(stamp_ns[1:] < stamp_ns[:-1]))


def first_of(table: Table, names: Sequence[str]) -> str | None:
    """First of these columns that the table has, for a field that was renamed; None if it has none."""
    return next((name for name in names if name in table.columns), None)


def column_named(table: Table, wanted: str) -> str:
    """Name of the column, ignoring case. Raises UnknownNameError."""
    return resolve_name(wanted, table.columns, f"{table.name} has no field", f"it has {listed(table.columns)}")


def text_cells(values: NDArray[Any]) -> list[str]:
    """Values of a column as text, one text per row.

    A number has the shortest digits that give the same number. Arrays are in brackets; bytes are hexadecimal digits.
    """
    if values.ndim > 1:
        flat = text_cells(values.ravel())
        count = values.size // len(values) if len(values) else 0
        return ["[" + " ".join(flat[row * count : (row + 1) * count]) + "]" for row in range(len(values))]
    if values.dtype.kind == "f":
        return [_shortest(value) for value in values]
    if values.dtype.kind == "O":
        return [value.hex() if isinstance(value, bytes) else str(value) for value in values]
    return [str(value) for value in values.tolist()]


def json_cells(values: NDArray[Any]) -> list[Any]:
    """Values of a column for JSON, one per row: numbers and texts. None if not finite; bytes as hexadecimal digits."""
    if values.ndim > 1:
        return [json_cells(row) for row in values]
    if values.dtype.kind == "f":
        # Print as many digits as the stored precision has, not those of the double converted from it.
        return [float(_shortest(value)) if math.isfinite(value) else None for value in values]
    if values.dtype.kind == "O":
        return [value.hex() if isinstance(value, bytes) else str(value) for value in values]
    return list(values.tolist())


def _shortest(value: np.floating[Any]) -> str:
    return str(value).removesuffix(".0")


# Flat columns for CSV, Parquet and pandas: an array of k numbers becomes k columns, `name[0]` and so on.


@dataclass(frozen=True, slots=True)
class FlatColumn:
    """`element` of `column`, or all of it."""

    name: str
    column: Column
    element: int | None


def stretches(rows: NDArray[np.intp], at_once: int) -> list[NDArray[np.intp]]:
    """`rows` in pieces of `at_once`; one empty piece if there are no rows."""
    return [rows[begin : begin + at_once] for begin in range(0, max(len(rows), 1), at_once)]


def flat_columns(table: Table, pieces: Sequence[NDArray[np.intp]], raw: bool) -> tuple[list[FlatColumn], list[str]]:
    """Columns, and the names of omitted columns: those with more than MOST_ELEMENTS numbers per row."""
    flat: list[FlatColumn] = []
    left_out: list[str] = []
    for column in table.columns.values():
        if not column.shape:
            flat.append(FlatColumn(column.name, column, None))
            continue
        shape = column.shape
        if -1 in shape:  # the longest row decides
            shapes = [table.values(column.name, piece, raw=raw).shape[1:] for piece in pieces]
            shape = max([(0,), *shapes])
        if int(np.prod(shape)) > MOST_ELEMENTS:
            left_out.append(column.name)
            continue
        for number, at in enumerate(product(*map(range, shape))):
            flat.append(FlatColumn(column.name + "".join(f"[{index}]" for index in at), column, number))
    return flat, left_out


def flat_values(table: Table, columns: Sequence[FlatColumn], rows: NDArray[np.intp], raw: bool) -> list[NDArray[Any]]:
    """Values (n,) of each column. NaN fills an array that is shorter than the longest of its column."""
    read: dict[str, NDArray[Any]] = {}
    result = []
    for flat in columns:
        name = flat.column.name
        if name not in read:
            values = table.values(name, rows, raw=raw)
            read[name] = values.reshape(len(values), -1) if flat.element is not None and len(values) else values
        values = read[name]
        if flat.element is None:
            result.append(values)
        elif values.ndim > 1 and flat.element < values.shape[1]:
            result.append(values[:, flat.element])
        else:
            result.append(np.full(len(rows), np.nan))
    return result


def data_frame(table: Table, raw: bool) -> Any:
    """See `Table.to_pandas`."""
    try:
        import pandas as pd  # type: ignore[import-untyped]
    except ImportError as error:
        raise LogError("pandas is not installed; install it with `pip install 'xitl[pandas]'`") from error
    every = np.arange(len(table), dtype=np.intp)
    columns, _ = flat_columns(table, [every], raw)
    index = pd.Index(table.stamp_ns * 1e-9, name="time_s")
    values = flat_values(table, columns, every, raw)
    frame = pd.DataFrame({flat.name: array for flat, array in zip(columns, values, strict=True)}, index=index)
    frame.attrs["units"] = {flat.name: flat.column.raw_unit if raw else flat.column.unit for flat in columns}
    return frame
