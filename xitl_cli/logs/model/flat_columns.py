"""A table as plain columns for CSV, Parquet and pandas.

An array of k numbers becomes k columns, `name[0]` and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.table import Column, Table

MOST_ELEMENTS = 1024


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
    found: list[FlatColumn] = []
    left_out: list[str] = []
    for column in table.columns.values():
        if not column.shape:
            found.append(FlatColumn(column.name, column, None))
            continue
        shape = column.shape if -1 not in column.shape else _longest(table, column.name, pieces, raw)
        if int(np.prod(shape)) > MOST_ELEMENTS:
            left_out.append(column.name)
            continue
        for number, at in enumerate(product(*map(range, shape))):
            found.append(FlatColumn(column.name + "".join(f"[{index}]" for index in at), column, number))
    return found, left_out


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


def _longest(table: Table, name: str, pieces: Sequence[NDArray[np.intp]], raw: bool) -> tuple[int, ...]:
    longest: tuple[int, ...] = (0,)
    for piece in pieces:
        longest = max(longest, table.values(name, piece, raw=raw).shape[1:])
    return longest


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
    frame = pd.DataFrame({flat.name: one for flat, one in zip(columns, values, strict=True)}, index=index)
    frame.attrs["units"] = {flat.name: flat.column.raw_unit if raw else flat.column.unit for flat in columns}
    return frame
