"""One CSV file a message.

The first line has the names and nothing else, as PlotJuggler wants it: time_s first, plain field names without units
(its layouts and everybody's scripts go by the name, and a comma or slash in one breaks it or makes a tree of it).
Units are in `columns.csv` beside them. Line breaks within texts are written as \\n: PlotJuggler reads line by line.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.export.flat import FlatColumn, flat_columns, flat_values
from xitl_cli.logs.query.cells import texts
from xitl_cli.logs.table import Table

COLUMNS_FILE = "columns.csv"
_LINES = 4096
_BREAKS = str.maketrans({"\n": "\\n", "\r": "\\r", "\0": ""})


def write_csv(
    path: Path, table: Table, pieces: Sequence[NDArray[np.intp]], zero_ns: int, utc: bool, raw: bool
) -> tuple[list[FlatColumn], list[str]]:
    """Time in seconds since `zero_ns`, with `utc` also since 1970. What was written, and fields that were left out."""
    columns, left_out = flat_columns(table, pieces, raw)
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*time_names(table, utc), *(column.name for column in columns)])
        for piece in pieces:
            stamps, values = table.stamp_ns[piece], flat_values(table, columns, piece, raw)
            for begin in range(0, len(piece), _LINES):
                some = slice(begin, begin + _LINES)
                times = [_seconds(stamps[some] - zero_ns), *([_seconds(stamps[some])] if utc else [])]
                cells = [_cells(flat, one[some]) for flat, one in zip(columns, values, strict=True)]
                writer.writerows(zip(*times, *cells, strict=True))
    return columns, left_out


def write_columns(path: Path, written: Sequence[tuple[str, str, Sequence[FlatColumn]]], raw: bool) -> None:
    """written: of each file its name, its message and its columns."""
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["file", "message", "column", "unit", "kind"])
        for file_name, message, columns in written:
            for flat in columns:
                unit = flat.column.raw_unit if raw else flat.column.unit
                writer.writerow([file_name, message, flat.name, unit, flat.column.kind])


def time_names(table: Table, utc: bool) -> list[str]:
    """Of the columns of time, with an underscore where a field has the name."""
    names = ["time_s", "utc_s"] if utc else ["time_s"]
    return [f"{name}_" if name in table.columns else name for name in names]


def _cells(flat: FlatColumn, values: NDArray[Any]) -> list[str]:
    shown = texts(values)
    return [text.translate(_BREAKS) for text in shown] if flat.column.kind == "text" else shown


def _seconds(since_ns: NDArray[np.int64]) -> list[str]:
    """Without loss: a double has too few digits for nanoseconds since 1970."""
    result = []
    for since in since_ns.tolist():
        whole, part = divmod(abs(since), 1_000_000_000)
        digits = f"{part:09d}" if part % 1000 else f"{part // 1000:06d}"
        result.append(f"{'-' if since < 0 else ''}{whole}.{digits}")
    return result
