"""Export of a log to CSV, Parquet or MCAP files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.clocks.utc import UtcOffset, utc_offset
from xitl_cli.logs.export.files import file_names, make_directory, part_of, refuse_present
from xitl_cli.logs.export.tabular import COLUMNS_FILE, write_columns, write_csv
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.query import rows_at_once, rows_between
from xitl_cli.logs.model.table import FlatColumn, Table, stretches
from xitl_cli.logs.model.text import plural

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
        raise LogError(f"--format = {file_format!r} is not known; choose from {', '.join((*FORMATS, *BAG_FORMATS))}")
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
        since = f"since {log.zero_in_words}" if log.zero_ns == 0 else "from a zero of its own"
        times = f"the log tells no UTC: its times count {since}" if utc is None else f"its times are UTC {utc.source}"
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
            notes.append(f"{table.name}: {', '.join(left_out)} left out for its length; --format mcap has all")
    for path in also:
        with part_of(path, overwrite) as part:
            write_columns(part, described, wanted.raw)
    what = f"{_of(rows_written, wanted)}, a file each"
    known = "the log tells no UTC" if utc is None else f"utc_s is UTC {utc.source}"
    sentence = f"{directory}: {what}; time_s counts seconds since {log.zero_in_words}; {known}"
    return ExportResult(tuple(str(path) for path in [*paths, *also]), rows_written, sentence, tuple(notes))


_Writer = Callable[
    [Path, Table, list[NDArray[np.intp]], int, UtcOffset | None, bool], tuple[list[FlatColumn], list[str]]
]


def _writer(file_format: str) -> _Writer:
    if file_format == "csv":
        return write_csv
    from xitl_cli.logs.export.tabular import require_parquet, write_parquet

    require_parquet()
    return write_parquet


def _refuse_itself(log: Log, paths: list[Path]) -> None:
    """Refuse to write over the log: it is mapped into memory, and writing would remove it during reading."""
    for path in paths:
        if path.exists() and log.path.exists() and path.samefile(log.path):
            raise LogError(f"{path}: is the log itself; choose another place with --out")


def _of(rows: int, wanted: ExportSelection) -> str:
    return f"{plural(rows, 'row')} of {plural(len(wanted.tables), 'message')}"
