"""A table of the report as lines of text that fit a width."""

from __future__ import annotations

import textwrap

from xitl_cli.logs.report.words import is_numeric, plural, value_text
from xitl_cli.logs.sections import Grid
from xitl_cli.logs.text import printable

_APART = 2
_WIDE = 24
_LEAST_BELOW = 20


def grid_lines(grid: Grid, width: int, most_rows: int) -> list[str]:
    """Head, rows, and what was left out. No line is longer than `width` where words allow.

    Where not all columns fit, wide text goes below its row, and columns are left out from the right.
    """
    shown = [
        [printable(value_text(value, name)) for name, value in zip(grid.columns, row, strict=False)]
        for row in grid.rows[:most_rows]
    ]
    shown = [row + [""] * (len(grid.columns) - len(row)) for row in shown]
    heads = [printable(name) for name in grid.columns]
    widths = [
        max([*map(len, head.split()), *(len(row[index]) for row in shown)], default=0)
        for index, head in enumerate(heads)
    ]
    right = [is_numeric(grid, index) for index in range(len(heads))]
    beside, below = list(range(len(heads))), []
    if _total(widths, beside) > width:
        below = [index for index in beside[1:] if not right[index] and widths[index] > _WIDE]
        beside = [index for index in beside if index not in below]
    while len(beside) > 1 and _total(widths, beside) > width:
        beside.pop()
    for index in beside:  # a heading in one line, where there is room for it
        widths[index] += max(0, min(len(heads[index]) - widths[index], width - _total(widths, beside)))
    lines = _head(heads, widths, right, beside)
    for row in shown:
        lines.append(_line([row[index] for index in beside], widths, right, beside))
        for index in below:
            if row[index]:
                lines += textwrap.wrap(
                    f"{heads[index]}: {row[index]}",
                    max(width, _LEAST_BELOW),
                    initial_indent="  ",
                    subsequent_indent="    ",
                )
    return lines + _left_out(len(grid.rows) - len(shown), len(heads) - len(beside) - len(below))


def _total(widths: list[int], columns: list[int]) -> int:
    return sum(widths[index] for index in columns) + _APART * (len(columns) - 1)


def _head(heads: list[str], widths: list[int], right: list[bool], columns: list[int]) -> list[str]:
    wrapped = [textwrap.wrap(heads[index], widths[index] or 1) or [""] for index in columns]
    rows = max(map(len, wrapped))
    at_the_foot = [[""] * (rows - len(words)) + words for words in wrapped]
    return [_line([words[row] for words in at_the_foot], widths, right, columns) for row in range(rows)]


def _line(cells: list[str], widths: list[int], right: list[bool], columns: list[int]) -> str:
    padded = (
        cell.rjust(widths[index]) if right[index] else cell.ljust(widths[index])
        for cell, index in zip(cells, columns, strict=True)
    )
    return (" " * _APART).join(padded).rstrip()


def _left_out(rows: int, columns: int) -> list[str]:
    parts = [plural(rows, "more row")] if rows > 0 else []
    parts += [plural(columns, "more column")] if columns > 0 else []
    return [f"({' and '.join(parts)} in --report and --json)"] if parts else []
