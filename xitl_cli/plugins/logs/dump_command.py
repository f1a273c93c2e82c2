"""Rows of messages as text: a table for one message, `name=value` for several, or JSON."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.named_signals import TIME
from xitl_cli.logs.model.query import RowCondition, merge_rows, rows_at_once
from xitl_cli.logs.model.table import Table, column_named, json_cells, text_cells

_LINES = 2048
_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(0x20), *range(0x7F, 0xA0))}
_BREAKS = {**_CONTROLS, ord("\n"): "\\n", ord("\r"): "\\r", ord("\t"): "\\t", 0x1B: "\\e"}
_INDENT = " " * 6


@dataclass(frozen=True, slots=True)
class Asked:
    """Options of a dump."""

    fields: tuple[str, ...] = ()
    """Fields in this order, for messages that have them; all if empty."""
    condition: RowCondition | None = None
    span_ns: tuple[int | None, int | None] = (None, None)
    """First and last stamp."""
    raw: bool = False
    limit: int | None = None
    as_json: bool = False
    width: int | None = None
    """Columns of a terminal for folding; None: no folding."""


def row_lines(log: Log, tables: Sequence[Table], asked: Asked) -> Iterator[str]:
    """Yield pieces of text, each with complete lines. Raises LogError for a field that none of the messages has."""
    zero, at_once = log.zero_ns, rows_at_once(log, tables)
    # The columns of each table: all if none is selected, otherwise the selected ones that it has.
    if not asked.fields:
        columns = [list(table.columns) for table in tables]
    else:
        selected: list[list[str]] = [[] for _ in tables]
        for name in asked.fields:
            refusals = []
            for table, names in zip(tables, selected, strict=True):
                try:
                    names.append(column_named(table, name))
                except LogError as error:
                    refusals.append(error)
            if len(refusals) == len(tables):
                raise refusals[0]
        columns = [list(dict.fromkeys(names)) for names in selected]
    left = asked.limit
    layout: _Layout | None = None
    for batch in merge_rows(tables, *asked.span_ns, asked.condition, zero, at_once, raw=asked.raw):
        if left == 0:
            return
        shown = batch.first(left)
        left = None if left is None else left - len(shown.order)
        stretches = [
            _Stretch(
                table,
                names,
                table.stamp_ns[rows] - zero,
                [table.values(name, rows, raw=asked.raw) for name in names],
            )
            for table, names, rows in zip(tables, columns, shown.rows, strict=True)
        ]
        if layout is None:
            layout = _layout(stretches, asked)
            yield layout.head
        lines = [_lines(layout, stretch) for stretch in stretches]
        for begin in range(0, len(shown.order), _LINES):
            yield "".join(next(lines[owner]) for owner in shown.order[begin : begin + _LINES].tolist())


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Some rows of one table."""

    table: Table
    columns: Sequence[str]
    since_ns: NDArray[np.int64]
    """Time since second 0, (n,)."""
    values: Sequence[NDArray[Any]]
    """Values of each column, (n, …)."""

    def part(self, rows: slice) -> _Stretch:
        return _Stretch(self.table, self.columns, self.since_ns[rows], [values[rows] for values in self.values])

    @property
    def times(self) -> list[str]:
        return [f"{since_ns * 1e-9:.6f}" for since_ns in self.since_ns.tolist()]


def _lines(layout: _Layout, stretch: _Stretch) -> Iterator[str]:
    for begin in range(0, len(stretch.since_ns), _LINES):
        yield from layout.lines(stretch.part(slice(begin, begin + _LINES)))


class _Layout(Protocol):
    @property
    def head(self) -> str: ...

    def lines(self, stretch: _Stretch) -> list[str]:
        """Return one line per row; a folded line has several lines of the terminal."""
        ...


def _layout(stretches: Sequence[_Stretch], asked: Asked) -> _Layout:
    if asked.as_json:
        return _Json()
    if len(stretches) == 1:
        table = _Columns.for_rows_like(stretches[0], asked.raw)
        if asked.width is None or table.width <= asked.width:
            return table
    return _Named(asked.width)


@dataclass(frozen=True, slots=True)
class _Columns:
    """A table. The first rows determine the width of its columns."""

    names: Sequence[str]
    units: Sequence[str]
    widths: Sequence[int]
    left: Sequence[bool]

    @classmethod
    def for_rows_like(cls, stretch: _Stretch, raw: bool) -> _Columns:
        columns = [stretch.table.columns[name] for name in stretch.columns]
        names = [TIME, *stretch.columns]
        units = ["s", *((column.raw_unit if raw else column.unit) for column in columns)]
        cells = [stretch.times, *map(text_cells, stretch.values)]
        widths = [max(map(len, [name, unit, *column])) for name, unit, column in zip(names, units, cells, strict=True)]
        return cls(names, units, widths, [False, *(column.kind == "text" for column in columns)])

    @property
    def width(self) -> int:
        return sum(self.widths) + 2 * (len(self.widths) - 1)

    @property
    def head(self) -> str:
        return self._line(self.names) + self._line(self.units)

    def lines(self, stretch: _Stretch) -> list[str]:
        return [self._line(row) for row in zip(stretch.times, *map(text_cells, stretch.values), strict=True)]

    def _line(self, cells: Sequence[str]) -> str:
        placed = (
            f"{cell:<{width}}" if left else f"{cell:>{width}}"
            for cell, width, left in zip(cells, self.widths, self.left, strict=True)
        )
        return "  ".join(placed).rstrip().translate(_BREAKS) + "\n"


@dataclass(frozen=True, slots=True)
class _Named:
    """Format with names: 12.345678 ATT Roll=0.1 Pitch=0.2"""

    width: int | None
    head: str = ""

    def lines(self, stretch: _Stretch) -> list[str]:
        names = [f"{name}=" for name in stretch.columns]
        cells = zip(stretch.times, *map(_quoted, stretch.values), strict=True)
        return [
            self._folded([at, stretch.table.name, *(name + value for name, value in zip(names, row, strict=True))])
            for at, *row in cells
        ]

    def _folded(self, words: list[str]) -> str:
        line = " ".join(words)
        if self.width is None or len(line) <= self.width:
            return line + "\n"
        folded = textwrap.wrap(
            line, max(self.width, 20), subsequent_indent=_INDENT, break_on_hyphens=False, break_long_words=False
        )
        return "\n".join(folded) + "\n"


def _quoted(values: NDArray[Any]) -> list[str]:
    """Quote texts that would otherwise merge with the following text."""
    shown = text_cells(values)
    if values.dtype.kind != "U":
        return shown
    return [json.dumps(text, ensure_ascii=False) if not text or not text.isalnum() else text for text in shown]


@dataclass(frozen=True, slots=True)
class _Json:
    head: str = ""

    def lines(self, stretch: _Stretch) -> list[str]:
        columns = [json_cells(values) for values in stretch.values]
        name, names = stretch.table.name, stretch.columns
        rows = (
            {TIME: since_ns / 1e9, "message": name, "fields": dict(zip(names, row, strict=True))}
            for since_ns, *row in zip(stretch.since_ns.tolist(), *columns, strict=True)
        )
        return [json.dumps(row, allow_nan=False, ensure_ascii=False) + "\n" for row in rows]
