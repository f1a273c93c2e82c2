"""What commands print for a person: text as it is, in as many lines as the width takes, never cut off.

Colours appear at a terminal only, and not where NO_COLOR is set.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from xitl_cli.logs.model.text import printable

if TYPE_CHECKING:
    from rich.console import Console

APART = 2
LEAST_TEXT = 24
"""A column of text narrower than this is hard to read: the row is told in a paragraph then."""


def terminal(stderr: bool = False, soft_wrap: bool = False) -> Console:
    """What is printed there is taken for what it says: brackets are no markup, `:x:` is no picture.

    soft_wrap: lines are left to the terminal to wrap, so that a path stays one word.
    """
    from rich.console import Console

    return Console(stderr=stderr, highlight=False, markup=False, emoji=False, soft_wrap=soft_wrap)


@contextmanager
def progress(first: str) -> Iterator[Callable[[str], None]]:
    """Shows what is being done while there is a terminal to show it on."""
    console = terminal(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    from rich.text import Text

    with console.status(first) as status:
        yield lambda text: status.update(Text(printable(text)))


def say(console: Console, text: str, style: str = "") -> None:
    """A sentence, wrapped between words."""
    for line in _wrapped(text, console.width):
        _line(console, line, style)


def show_facts(console: Console, facts: Sequence[tuple[str, str] | tuple[str, str, str]]) -> None:
    """Labels, and beside each its text in as many lines as it takes; below it where there is no room beside.

    A third word is the style of a fact.
    """
    if not facts:
        return
    indent = max(len(fact[0]) for fact in facts) + APART
    if console.width - indent < LEAST_TEXT:
        indent = APART
    for label, text, *styles in facts:
        style = "".join(styles)
        lines = [line for part in text.split("\n") for line in _wrapped(part, console.width - indent)] or [""]
        if len(label) >= indent:
            _line(console, label, style)
            label = ""
        for number, line in enumerate(lines):
            _line(console, f"{'' if number else label:<{indent}}{line}".rstrip(), style)


def show_rows(
    console: Console,
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    text: Collection[int] = (0,),
    styles: Sequence[str] = (),
) -> None:
    """A table with one line of headings; without any where all are empty.

    text: columns that are aligned to the left, of which the last may be wrapped. styles: of each row. Where the width
    does not do, each row is a paragraph that names its columns.
    """
    if not rows:
        return
    cells = [[printable(cell) for cell in row] for row in rows]
    table = [list(heads), *cells] if any(heads) else cells
    widths = [max(len(row[column]) for row in table) for column in range(len(heads))]
    room = console.width - APART * (len(heads) - 1)
    wrapped = max(text, default=-1)
    if sum(widths) > room and wrapped >= 0:
        widths[wrapped] = max(min(widths[wrapped], LEAST_TEXT), room - sum(widths) + widths[wrapped])
    every = [styles[number] if number < len(styles) else "" for number in range(len(cells))]
    if sum(widths) > room:
        for row, style in zip(cells, every, strict=True):
            _paragraph(console, heads, row, style)
        return
    for row, style in zip(table, [*(["bold"] if any(heads) else []), *every], strict=True):
        parts = [_wrapped(cell, widths[column]) or [""] for column, cell in enumerate(row)]
        for number in range(max(map(len, parts))):
            shown = [part[number] if number < len(part) else "" for part in parts]
            padded = (
                cell.ljust(widths[column]) if column in text else cell.rjust(widths[column])
                for column, cell in enumerate(shown)
            )
            _line(console, (" " * APART).join(padded).rstrip(), style)


def _paragraph(console: Console, heads: Sequence[str], row: Sequence[str], style: str) -> None:
    first, *others = row
    for line in _wrapped(first, console.width):
        _line(console, line, style or "bold")
    told = [f"{head} {cell}".strip() for head, cell in zip(heads[1:], others, strict=True) if cell]
    for line in _wrapped(", ".join(told), console.width - APART):
        _line(console, " " * APART + line, style)


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(printable(text), max(width, 1), break_on_hyphens=False)


def _line(console: Console, text: str, style: str = "") -> None:
    from rich.text import Text

    console.print(Text(text, style=style), soft_wrap=True)
