"""A table as plain columns, and these as one CSV or Parquet file a message.

An array of k numbers is k columns, `name[0]` and on. CSV: the first line has the names and nothing else, as PlotJuggler
wants it: time_s first, plain field names without units (its layouts and everybody's scripts go by the name, and a comma
or slash in one breaks it or makes a tree of it). Units are in `columns.csv` beside them. Line breaks within texts are
written as \\n: PlotJuggler reads line by line. Parquet: the same columns; units are their metadata ("unit").
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.clocks.utc import UtcOffset, in_utc
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.table import FlatColumn, Table, flat_columns, flat_values, text_cells

COLUMNS_FILE = "columns.csv"
_LINES = 4096
_BREAKS = str.maketrans({"\n": "\\n", "\r": "\\r", "\0": ""})


def write_csv(
    path: Path, table: Table, pieces: Sequence[NDArray[np.intp]], zero_ns: int, utc: UtcOffset | None, raw: bool
) -> tuple[list[FlatColumn], list[str]]:
    """Write a CSV file, its time in seconds since `zero_ns` and, where `utc` is known, since 1970.

    Returns the columns written and the fields left out.
    """
    columns, left_out = flat_columns(table, pieces, raw)
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*time_names(table, utc is not None), *(column.name for column in columns)])
        for piece in pieces:
            stamps, values = table.stamp_ns[piece], flat_values(table, columns, piece, raw)
            for begin in range(0, len(piece), _LINES):
                some = slice(begin, begin + _LINES)
                times = [_seconds(stamps[some] - zero_ns), *([_seconds(in_utc(stamps[some], utc))] if utc else [])]
                cells = [_cells(flat, one[some]) for flat, one in zip(columns, values, strict=True)]
                writer.writerows(zip(*times, *cells, strict=True))
    return columns, left_out


def write_columns(path: Path, written: Sequence[tuple[str, str, Sequence[FlatColumn]]], raw: bool) -> None:
    """Write columns.csv. written: name, message and columns of each file."""
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["file", "message", "column", "unit", "kind"])
        for file_name, message, columns in written:
            for flat in columns:
                unit = flat.column.raw_unit if raw else flat.column.unit
                writer.writerow([file_name, message, flat.name, unit, flat.column.kind])


def time_names(table: Table, utc: bool) -> list[str]:
    """Names of the time columns, with an underscore where a field has the name."""
    names = ["time_s", "utc_s"] if utc else ["time_s"]
    return [f"{name}_" if name in table.columns else name for name in names]


def _cells(flat: FlatColumn, values: NDArray[Any]) -> list[str]:
    shown = text_cells(values)
    return [text.translate(_BREAKS) for text in shown] if flat.column.kind == "text" else shown


def _seconds(since_ns: NDArray[np.int64]) -> list[str]:
    """Seconds without loss: a double has too few digits for nanoseconds since 1970."""
    result = []
    for since in since_ns.tolist():
        whole, part = divmod(abs(since), 1_000_000_000)
        digits = f"{part:09d}" if part % 1000 else f"{part // 1000:06d}"
        result.append(f"{'-' if since < 0 else ''}{whole}.{digits}")
    return result


def require_parquet() -> None:
    """Raises LogError when pyarrow is not installed."""
    try:
        import pyarrow.parquet  # type: ignore[import-untyped]  # noqa: F401
    except ImportError as error:
        raise LogError(
            "--format parquet: pyarrow is not installed; install it with `pip install 'xitl[parquet]'`, or use csv"
        ) from error


def write_parquet(
    path: Path, table: Table, pieces: Sequence[NDArray[np.intp]], zero_ns: int, utc: UtcOffset | None, raw: bool
) -> tuple[list[FlatColumn], list[str]]:
    """Write a Parquet file: time_s (double), utc_s where `utc` is known, stamp_ns (int64, as logged) and the fields."""
    import pyarrow as pa
    from pyarrow import parquet

    columns, left_out = flat_columns(table, pieces, raw)
    times = [*time_names(table, utc is not None), "stamp_ns" if "stamp_ns" not in table.columns else "stamp_ns_"]
    schema: Any = None
    writer: Any = None
    try:
        for piece in pieces:
            stamps = table.stamp_ns[piece]
            seconds = [(stamps - zero_ns) * 1e-9, *([in_utc(stamps, utc) * 1e-9] if utc else [])]
            values = [*seconds, stamps, *map(_widened, flat_values(table, columns, piece, raw))]
            if schema is None:
                units = ["s"] * len(seconds) + ["ns"]
                units += [flat.column.raw_unit if raw else flat.column.unit for flat in columns]
                kinds = ["number"] * len(times) + [flat.column.kind for flat in columns]
                names = [*times, *(flat.name for flat in columns)]
                fields = [
                    pa.field(name, _type(pa, kind, one), metadata={"unit": unit} if unit else None)
                    for name, kind, unit, one in zip(names, kinds, units, values, strict=True)
                ]
                schema = pa.schema(fields, metadata={"message": table.name})
                writer = parquet.ParquetWriter(str(path), schema)
            arrays = [pa.array(one, type=field.type) for one, field in zip(values, schema, strict=True)]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
    finally:
        if writer is not None:
            writer.close()
    return columns, left_out


def _type(pa: Any, kind: str, values: NDArray[Any]) -> Any:
    if kind == "text":
        return pa.string()
    if kind == "bytes":
        return pa.binary()
    return pa.from_numpy_dtype(values.dtype)


def _widened(values: NDArray[Any]) -> NDArray[Any]:
    """Half precision as float32: few programs read it."""
    return values.astype(np.float32) if values.dtype == np.float16 else values
