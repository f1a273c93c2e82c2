"""Output of commands at a terminal: plain text, wrapped to the width, never cut off.

Colours appear at a terminal only, and not when NO_COLOR is set.
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
"""A narrower column of text is hard to read. The row then becomes a paragraph."""


def terminal(stderr: bool = False, soft_wrap: bool = False) -> Console:
    """Return a console that prints text literally: brackets are no markup, `:x:` is no picture.

    soft_wrap: the terminal wraps lines, so that a path stays one word.
    """
    from rich.console import Console

    return Console(stderr=stderr, highlight=False, markup=False, emoji=False, soft_wrap=soft_wrap)


@contextmanager
def progress(first: str) -> Iterator[Callable[[str], None]]:
    """Show the current step if there is a terminal."""
    console = terminal(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    from rich.text import Text

    with console.status(first) as status:
        yield lambda text: status.update(Text(printable(text)))


def say(console: Console, text: str, style: str = "") -> None:
    """Print a sentence, wrapped between words."""
    for line in _wrapped(text, console.width):
        _line(console, line, style)


def show_facts(console: Console, facts: Sequence[tuple[str, str] | tuple[str, str, str]]) -> None:
    """Print labels, each with its text to the right, or below it on a narrow terminal.

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
    """Print a table with one line of headings, or without it when all are empty.

    text: columns aligned to the left; the last of them may be wrapped. styles: of each row. On a narrow terminal, each
    row is a paragraph that names its columns.
    """
    if not rows:
        return
    cells = [[printable(cell) for cell in row] for row in rows]
    table = [list(heads), *cells] if any(heads) else cells
    widths = [max(len(row[column]) for row in table) for column in range(len(heads))]
    room = console.width - APART * (len(heads) - 1)
    wrapped = max(text, default=-1)
    if sum(widths) > room and wrapped >= 0:  # narrow the last text column
        widths[wrapped] = max(min(widths[wrapped], LEAST_TEXT), room - sum(widths) + widths[wrapped])
    every = [styles[number] if number < len(styles) else "" for number in range(len(cells))]
    if sum(widths) > room:
        for row, style in zip(cells, every, strict=True):
            for line in _wrapped(row[0], console.width):
                _line(console, line, style or "bold")
            named = [f"{head} {cell}".strip() for head, cell in zip(heads[1:], row[1:], strict=True) if cell]
            for line in _wrapped(", ".join(named), console.width - APART):
                _line(console, " " * APART + line, style)
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


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(printable(text), max(width, 1), break_on_hyphens=False)


def _line(console: Console, text: str, style: str = "") -> None:
    from rich.text import Text

    console.print(Text(text, style=style), soft_wrap=True)
