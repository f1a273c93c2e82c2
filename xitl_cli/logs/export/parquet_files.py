"""One Parquet file a message, columns as in CSV; units are metadata of the columns ("unit")."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.errors import LogError
from xitl_cli.logs.export.csv_files import time_names
from xitl_cli.logs.export.flat import FlatColumn, flat_columns, flat_values
from xitl_cli.logs.table import Table


def require_parquet() -> None:
    """Raises LogError when pyarrow is not installed."""
    try:
        import pyarrow.parquet  # type: ignore[import-untyped]  # noqa: F401
    except ImportError as error:
        raise LogError(
            "--format parquet: pyarrow is not installed; install it with `pip install 'xitl[parquet]'`, or use csv"
        ) from error


def write_parquet(
    path: Path, table: Table, pieces: Sequence[NDArray[np.intp]], zero_ns: int, utc: bool, raw: bool
) -> tuple[list[FlatColumn], list[str]]:
    """time_s (double), with `utc` also utc_s, then stamp_ns (int64, as logged) and the fields."""
    import pyarrow as pa
    from pyarrow import parquet

    columns, left_out = flat_columns(table, pieces, raw)
    times = [*time_names(table, utc), "stamp_ns" if "stamp_ns" not in table.columns else "stamp_ns_"]
    schema: Any = None
    writer: Any = None
    try:
        for piece in pieces:
            stamps = table.stamp_ns[piece]
            seconds = [(stamps - zero_ns) * 1e-9, *([stamps * 1e-9] if utc else [])]
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
    """Half precision is read by few."""
    return values.astype(np.float32) if values.dtype == np.float16 else values
