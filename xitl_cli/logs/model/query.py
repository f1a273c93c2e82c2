"""Queries on a log: messages, a time span and a condition select rows.

A condition is an expression on the rows of a message: `Roll > 5 and I == 0`, `abs(GyrX) >= 0.1`, `Name == 'ATC_RATE'`,
`hypot(XKF1.VN, XKF1.VE) > 2`. It is evaluated on whole columns.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.expressions.evaluation import ARITIES, LACKING, TIMED, Evaluation, Quantity
from xitl_cli.logs.expressions.syntax import ExpressionError, Language, functions_in, names_in, parse
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.named_signals import TIME, find_signal, interpolation, no_message, table_of
from xitl_cli.logs.model.table import Floats, Rows, Stamps, Table, column_named, seconds_since
from xitl_cli.logs.model.text import resolve_name

NS_PER_S = 1_000_000_000
_FIRST, _MOST = 256, 16_384
_SEQUENTIAL_BYTES = 64 << 20
_INDEXED = re.compile(r"\[(\d+)\]$")
CONDITIONS = Language("condition", "'Roll > 5 and I == 0'", ARITIES)


@dataclass(frozen=True, slots=True)
class NamedTables:
    """Tables selected by name."""

    tables: tuple[Table, ...]
    """In the order of the names, without duplicates."""
    rowless: tuple[str, ...]
    """Names that the log describes but has no rows of."""


def tables_named(log: Log, wanted: Iterable[str]) -> NamedTables:
    """The tables of messages or topics; "IMU,ATT" are two names. Raises LogError."""
    names = [name.strip() for text in wanted for name in text.split(",") if name.strip()]
    if not len(log):
        raise LogError(f"{log.path}: has no readable message; `xitl logs info` shows its damage")
    known = {name.casefold(): name for name in log.rowless}
    without = {name: known[name.casefold()] for name in names if name.casefold() in known}
    tables = {table.name: table for table in (log[name] for name in names if name not in without)}
    return NamedTables(tuple(tables.values()), tuple(dict.fromkeys(without.values())))


def stamps_between(log: Log, from_s: float | None, until_s: float | None) -> tuple[int | None, int | None]:
    """First and last stamp of a span given in seconds. Raises LogError for an empty span."""
    for option, value in (("--from", from_s), ("--until", until_s)):
        if value is not None and not (math.isfinite(value) and abs(value) < 9e9):
            raise LogError(f"{option} = {value} is not a time in a log; give seconds since {log.zero_in_words}")
    if from_s is not None and until_s is not None and until_s < from_s:
        raise LogError(f"--until = {until_s:g} is before --from = {from_s:g}; swap them")
    zero = log.zero_ns
    from_ns = None if from_s is None else zero + round(from_s * NS_PER_S)
    until_ns = None if until_s is None else zero + round(until_s * NS_PER_S)
    return from_ns, until_ns


class RowCondition:
    """A parsed condition. `names`: fields in it, without [k].

    Raises LogError if `text` is not a condition.

    log: log that provides the signals of other messages, evaluated at the time of the row. None: other messages are
    unavailable.
    """

    def __init__(self, text: str, log: Log | None = None) -> None:
        self.text, self._log = text, log
        try:
            self._tree = parse(text, CONDITIONS, () if log is None else log.tables)
        except ExpressionError as error:
            raise LogError(f"{text!r} {error}") from None
        self.names = tuple(dict.fromkeys(_INDEXED.sub("", path) for path in names_in(self._tree)))
        self.notes: dict[str, None] = {}
        self._timed = not functions_in(self._tree).isdisjoint(TIMED)
        self._whole: dict[str, NDArray[np.bool_]] = {}
        self._others: dict[str, Callable[[Stamps], Floats]] = {}
        self._units: dict[str, str] = {}

    def within(self, log: Log) -> RowCondition:
        """The same condition on rows of this log."""
        return RowCondition(self.text, log)

    def lacked(self, tables: Sequence[Table]) -> dict[str, list[str]]:
        """Fields that the condition names and a table lacks, by name of the table.

        Raises LogError for a field that no table has.
        """
        lacked: dict[str, list[str]] = {}
        for name in self.names:
            without = [table for table in tables if _own_field(table, name) is None and not self._elsewhere(name)]
            if len(without) == len(tables) > 1:
                every = [column for table in tables for column in table.columns]
                lacks = f"none of {', '.join(table.name for table in tables)} has a field"
                resolve_name(name, dict.fromkeys(every), lacks, "`xitl logs info --fields` lists them")
            for table in without:
                lacked.setdefault(table.name, []).append(name)
        return lacked if len(tables) > 1 else {}

    def holds(
        self, table: Table, rows: Rows, zero_ns: int, *, raw: bool = False, lacks: Collection[str] = ()
    ) -> NDArray[np.bool_]:
        """(n,) True in each row in which the condition holds.

        A comparison with NaN is False, and so is a comparison with a field in `lacks`. Raises LogError.
        """
        if not self._timed:
            return self._truth(table, rows, zero_ns, raw, lacks)
        if table.name not in self._whole:  # functions along time need all rows of each instance
            whole = np.zeros(len(table), dtype=np.bool_)
            if table.instance is None:
                rows_by_instance = [np.arange(len(table), dtype=np.intp)]
            else:
                numbers = table.values(table.instance, raw=True)
                rows_by_instance = [np.flatnonzero(numbers == number) for number in np.unique(numbers)]
            for own in rows_by_instance:
                whole[own] = self._truth(table, own, zero_ns, raw, lacks)
            self._whole[table.name] = whole
        return self._whole[table.name][rows]

    def _truth(
        self, table: Table, rows: Rows, zero_ns: int, raw: bool, lacks: Collection[str]
    ) -> NDArray[np.bool_]:  # fmt: skip
        evaluation = Evaluation(
            self.text,
            lambda path: self._resolved(path, table, rows, zero_ns, raw, lacks),
            lambda: seconds_since(zero_ns, table.stamp_ns[rows]),
        )
        try:
            with np.errstate(all="ignore"):
                result = evaluation.quantity(self._tree)
        except ExpressionError as error:
            raise LogError(f"{self.text!r} {error}") from None
        self.notes.update(dict.fromkeys(evaluation.notes))
        if not result.is_truth:
            raise LogError(f"{self.text!r} is a value, not a condition; compare it, such as '… > 0'")
        count = len(table.stamp_ns[rows])
        return np.broadcast_to(np.asarray(result.values, dtype=np.bool_), (count,))

    def _resolved(
        self, path: str, table: Table, rows: Rows, zero_ns: int, raw: bool, lacks: Collection[str]
    ) -> Quantity:  # fmt: skip
        """A field of the row, else another message's signal at the row's time."""
        # Split a path into field and element: "V[1]" gives ("V", 1).
        index = _INDEXED.search(path)
        base, element = (path, None) if index is None else (path[: index.start()], int(index[1]))
        if base in lacks:
            return LACKING
        if base == TIME and TIME not in table.columns:
            return Quantity(seconds_since(zero_ns, table.stamp_ns[rows]), "s")
        field = _own_field(table, base)
        if field is None and self._elsewhere(base):
            stamp_ns = table.stamp_ns[rows]
            assert self._log is not None
            if path not in self._others:
                signal = find_signal(self._log, path, raw=raw)
                self._others[path], self._units[path] = interpolation(signal), signal.unit
            return Quantity(self._others[path](stamp_ns), self._units[path])
        if field is None and self._log is not None and "." in base and not any("." in name for name in table.columns):
            raise no_message(self._log, path)
        return self._field(table, column_named(table, base if field is None else field), element, rows, raw)

    def _elsewhere(self, name: str) -> bool:
        """Whether the name begins with a message of the log. If so, the field is read from that message."""
        return self._log is not None and table_of(self._log, name) is not None

    def _field(self, table: Table, name: str, element: int | None, rows: Rows, raw: bool) -> Quantity:
        column = table.columns[name]
        if element is None and column.shape:
            raise LogError(f"{self.text!r}: {name} of {table.name} is an array; write {name}[0]")
        if element is not None and len(column.shape) != 1:
            raise LogError(f"{self.text!r}: {name} of {table.name} is not an array; remove [{element}]")
        if column.kind == "bytes":
            raise LogError(f"{self.text!r}: {name} of {table.name} holds bytes, which cannot be compared")
        values = table.values(name, rows, raw=raw)
        if values.dtype.kind in "iu":  # small integers would overflow
            values = values.astype(np.float64 if values.dtype == np.uint64 else np.int64)
        if element is not None:
            if element >= values.shape[1]:
                raise LogError(
                    f"{self.text!r}: {name} of {table.name} has {values.shape[1]} elements; the first is [0]"
                )
            values = values[:, element]
        return Quantity(values, column.raw_unit if raw else column.unit)


def _own_field(table: Table, name: str) -> str | None:
    """Field of the row with this name, with or without the message in front; None if the table has no such field."""
    columns = {column.casefold(): column for column in reversed(list(table.columns))}
    folded = name.casefold()
    if name in table.columns or folded == TIME:
        return name
    return columns.get(folded, columns.get(folded.removeprefix(f"{table.name}.".casefold())))


@dataclass(frozen=True, slots=True)
class RowBatch:
    """Rows of several tables from one part of the file."""

    rows: tuple[NDArray[np.intp], ...]
    """Rows of each table, ascending."""
    order: NDArray[np.intp]
    """(n,) index of the table that provides each row."""

    def first(self, count: int | None) -> RowBatch:
        """The first `count` rows; all for None."""
        if count is None or count >= len(self.order):
            return self
        order = self.order[:count]
        return RowBatch(tuple(rows[: np.count_nonzero(order == own)] for own, rows in enumerate(self.rows)), order)


def merge_rows(
    tables: Sequence[Table],
    from_ns: int | None,
    until_ns: int | None,
    condition: RowCondition | None,
    zero_ns: int,
    at_once: int = _MOST,
    *,
    raw: bool = False,
) -> Iterator[RowBatch]:
    """Yield rows of several tables in file order. The first batches are small, so that only the used rows are read."""
    lacked = condition.lacked(tables) if condition is not None else {}
    if condition is not None:
        for table in tables:  # raise errors in the condition now, not after a thousand rows
            condition.holds(table, slice(0, 1), zero_ns, raw=raw, lacks=lacked.get(table.name, ()))
    chosen = [rows_between(table, from_ns, until_ns) for table in tables]
    owner = np.concatenate([np.full(len(rows), number, np.intp) for number, rows in enumerate(chosen)])
    rows = np.concatenate(chosen)
    if len(tables) > 1:
        place = np.concatenate([table.file_offset[rows] for table, rows in zip(tables, chosen, strict=True)])
        order = np.argsort(place, kind="stable")
        owner, rows = owner[order], rows[order]
    begin, size = 0, _FIRST
    while begin < len(rows):
        part_owner, part_rows = owner[begin : begin + size], rows[begin : begin + size]
        if condition is not None:
            selected = np.ones(len(part_rows), dtype=np.bool_)
            for number, table in enumerate(tables):
                own = np.flatnonzero(part_owner == number)
                if len(own):
                    lacks = lacked.get(table.name, ())
                    selected[own] = condition.holds(table, part_rows[own], zero_ns, raw=raw, lacks=lacks)
            part_owner, part_rows = part_owner[selected], part_rows[selected]
        if len(part_owner):
            yield RowBatch(tuple(part_rows[part_owner == number] for number in range(len(tables))), part_owner)
        begin, size = begin + size, min(size * 2, at_once)


def rows_at_once(log: Log, tables: Sequence[Table]) -> int:
    """Batch size: large for a recording, which is read from its beginning for any of its rows, else small."""
    if not log.of_topics:
        return _MOST
    widest = max(sum(math.prod(map(abs, column.shape)) for column in table.columns.values()) for table in tables)
    return max(_MOST, _SEQUENTIAL_BYTES // (8 * max(widest, 1)))


def rows_between(table: Table, from_ns: int | None, until_ns: int | None) -> NDArray[np.intp]:
    """Rows stamped from `from_ns` to `until_ns`, both included; None: no limit."""
    if from_ns is None and until_ns is None:
        return np.arange(len(table), dtype=np.intp)
    stamps = table.stamp_ns
    inside = np.ones(len(stamps), dtype=np.bool_)
    if from_ns is not None:
        inside &= stamps >= from_ns
    if until_ns is not None:
        inside &= stamps <= until_ns
    return np.flatnonzero(inside)
