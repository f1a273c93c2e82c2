"""Export of a log to CSV, Parquet or MCAP files.

Tables as plain columns, written as one CSV or Parquet file per message.

An array of k numbers becomes k columns, `name[0]` and so on.

CSV: the first line has only the names, as PlotJuggler requires. time_s is first; field names have no units, because
layouts and scripts refer to the name, and PlotJuggler misreads a comma or slash in it. Units are in `columns.csv` next
to the files. Line breaks within texts are written as \\n, because PlotJuggler reads line by line.

Parquet: the same columns; units are their metadata ("unit").
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.clocks.readings import UtcOffset, in_utc, utc_offset
from xitl_cli.logs.export.files import file_names, make_directory, part_of, refuse_present
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.query import rows_at_once, rows_between
from xitl_cli.logs.model.table import FlatColumn, Table, flat_columns, flat_values, stretches, text_cells
from xitl_cli.logs.model.text import plural

COLUMNS_FILE = "columns.csv"
_LINES = 4096
_BREAKS = str.maketrans({"\n": "\\n", "\r": "\\r", "\0": ""})


def write_csv(
    path: Path, table: Table, pieces: Sequence[NDArray[np.intp]], zero_ns: int, utc: UtcOffset | None, raw: bool
) -> tuple[list[FlatColumn], list[str]]:
    """Write a CSV file, with time in seconds since `zero_ns` and, if `utc` is known, since 1970.

    Returns the written columns and the omitted fields.
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
    """Names of the time columns, with an underscore if a field has the same name."""
    names = ["time_s", "utc_s"] if utc else ["time_s"]
    return [f"{name}_" if name in table.columns else name for name in names]


def _cells(flat: FlatColumn, values: NDArray[Any]) -> list[str]:
    shown = text_cells(values)
    return [text.translate(_BREAKS) for text in shown] if flat.column.kind == "text" else shown


def _seconds(since_ns: NDArray[np.int64]) -> list[str]:
    """Seconds without loss, because a double has too few digits for nanoseconds since 1970."""
    result = []
    for since in since_ns.tolist():
        whole, part = divmod(abs(since), 1_000_000_000)
        digits = f"{part:09d}" if part % 1000 else f"{part // 1000:06d}"
        result.append(f"{'-' if since < 0 else ''}{whole}.{digits}")
    return result


def require_parquet() -> None:
    """Raise LogError if pyarrow is not installed."""
    try:
        import pyarrow.parquet  # type: ignore[import-untyped]  # noqa: F401
    except ImportError as error:
        raise LogError(
            "--format parquet: pyarrow is not installed; install it with `pip install 'xitl[parquet]'`, or use csv"
        ) from error


def write_parquet(
    path: Path, table: Table, pieces: Sequence[NDArray[np.intp]], zero_ns: int, utc: UtcOffset | None, raw: bool
) -> tuple[list[FlatColumn], list[str]]:
    """Write a Parquet file: time_s (double), utc_s if `utc` is known, stamp_ns (int64, as logged) and the fields."""
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
    """Half precision converted to float32, because few programs read half precision."""
    return values.astype(np.float32) if values.dtype == np.float16 else values


FORMATS = ("csv", "parquet", "mcap")
BagFormat = Literal["rosbag2-mcap", "rosbag2-sqlite3", "rosbag1"]
BAG_FORMATS: tuple[BagFormat, ...] = get_args(BagFormat)
"""Bags of ROS. Their export knows the meaning of messages and is elsewhere."""


@dataclass(frozen=True, slots=True)
class ExportSelection:
    """Data to export."""

    tables: tuple[Table, ...]
    from_ns: int | None = None
    """First stamp, included; None: no limit."""
    until_ns: int | None = None
    """Last stamp, included; None: no limit."""
    raw: bool = False


@dataclass(frozen=True, slots=True)
class ExportResult:
    """The files written."""

    files: tuple[str, ...]
    rows: int
    sentence: str
    notes: tuple[str, ...] = ()
    """A sentence for each difference between the log and the files."""

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def export_log(log: Log, wanted: ExportSelection, file_format: str, out: Path | None, overwrite: bool) -> ExportResult:
    """Write the selected tables. Raises LogError for an unknown format, an unwritable path, an existing file."""
    if file_format not in FORMATS:
        raise LogError(
            f"--format = {file_format!r} is not known; choose from {', '.join((*FORMATS, *BAG_FORMATS))}, "
            "or install the package that has it"
        )
    if file_format == "mcap":
        from xitl_cli.logs.export.mcap_export import write_mcap

        path = out or Path(f"{log.path.stem}-export.mcap")
        if path.is_dir():
            path = path / f"{log.path.stem}-export.mcap"
        _refuse_itself(log, [path])
        refuse_present([path], overwrite)
        make_directory(path.parent)
        utc = utc_offset(log)
        with part_of(path, overwrite) as part:
            rows, early = write_mcap(part, log, wanted.tables, (wanted.from_ns, wanted.until_ns), utc, wanted.raw)
        notes = (f"{early} rows stamped before the log's zero are at 0",) if early else ()
        since = f"since {log.zero_in_words}" if log.zero_ns == 0 else "from a zero that is not known"
        times = f"the log has no UTC: its times count {since}" if utc is None else f"its times are UTC {utc.source}"
        return ExportResult((str(path),), rows, f"{path}: {_of(rows, wanted)}; {times}", notes)
    return _as_files(log, wanted, file_format, out or Path(f"{log.path.stem}-{file_format}"), overwrite)


def _as_files(log: Log, wanted: ExportSelection, file_format: str, directory: Path, overwrite: bool) -> ExportResult:
    write = _writer(file_format)
    reserved = (COLUMNS_FILE.removesuffix(".csv"),)
    names = {
        name: f"{made}.{file_format}" for name, made in file_names((t.name for t in wanted.tables), reserved).items()
    }
    paths = [directory / name for name in names.values()]
    also = [directory / COLUMNS_FILE] if file_format == "csv" else []
    _refuse_itself(log, paths)
    make_directory(directory)
    refuse_present([*paths, *also], overwrite)
    utc, zero, rows_written = utc_offset(log), log.zero_ns, 0
    notes: list[str] = []
    described: list[tuple[str, str, list[FlatColumn]]] = []
    for table, path in zip(wanted.tables, paths, strict=True):
        rows = rows_between(table, wanted.from_ns, wanted.until_ns)
        at_once = rows_at_once(log, [table])
        with part_of(path, overwrite) as part:
            columns, left_out = write(part, table, stretches(rows, at_once), zero, utc, wanted.raw)
        rows_written += len(rows)
        described.append((path.name, table.name, columns))
        if left_out:
            notes.append(f"{table.name}: {', '.join(left_out)} omitted because it is too long; --format mcap writes it")
    for path in also:
        with part_of(path, overwrite) as part:
            write_columns(part, described, wanted.raw)
    what = f"{_of(rows_written, wanted)}, a file each"
    known = "the log has no UTC" if utc is None else f"utc_s is UTC {utc.source}"
    sentence = f"{directory}: {what}; time_s counts seconds since {log.zero_in_words}; {known}"
    return ExportResult(tuple(str(path) for path in [*paths, *also]), rows_written, sentence, tuple(notes))


_Writer = Callable[
    [Path, Table, list[NDArray[np.intp]], int, UtcOffset | None, bool], tuple[list[FlatColumn], list[str]]
]


def _writer(file_format: str) -> _Writer:
    if file_format == "csv":
        return write_csv
    require_parquet()
    return write_parquet


def _refuse_itself(log: Log, paths: list[Path]) -> None:
    """Refuse to write over the log: it is mapped into memory, and writing would remove it during reading."""
    for path in paths:
        if path.exists() and log.path.exists() and path.samefile(log.path):
            raise LogError(f"{path}: is the log itself; choose another path with --out")


def _of(rows: int, wanted: ExportSelection) -> str:
    return f"{plural(rows, 'row')} of {plural(len(wanted.tables), 'message')}"
