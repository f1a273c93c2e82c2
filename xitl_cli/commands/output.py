"""What commands that print a lot have in common."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from xitl_cli.errors import UserError
from xitl_cli.logs.model.text import printable

if TYPE_CHECKING:
    from xitl_cli.logs.model.log import Log

GONE = (errno.EPIPE, errno.EIO)
"""Of what is printed: a reader that left, a terminal that hung up."""


@contextmanager
def quiet_pipe() -> Iterator[None]:
    """A reader that has seen enough (`| head`) ends the output, and not with an error."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        # What is left in the buffer would raise once more when the interpreter closes it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(0) from None


@contextmanager
def still_read() -> Iterator[None]:
    """The output of what has its own exit code: a reader that left or a terminal that hung up changes nothing."""
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        if error.errno not in GONE:
            raise
        # What is left in the buffer would raise once more when the interpreter closes it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def refuse(sentences: Sequence[str]) -> None:
    """A line for each file that could not be read; raises UserError with the last of them."""
    for sentence in sentences[:-1]:
        typer.echo(f"error: {printable(sentence)}", err=True)
    if sentences:
        raise UserError(sentences[-1])


def tell_damage(*logs: Log) -> None:
    """A line on stderr for each log of which something is missing or in doubt, and how to mend it."""
    from xitl_cli.logs.report.wording import damage_sentences

    for log in logs:
        health = log.health
        if health.degraded:
            typer.echo(printable(f"{log.path}: degraded: {'; '.join(damage_sentences(health))}"), err=True)


def tell_vessels(*shown: tuple[Path, str, Sequence[str]]) -> None:
    """A line on stderr for each recording of several vessels: the path, the one that was taken, and all of them."""
    for path, vessel, vessels in shown:
        if vessel:
            there = ", ".join(vessels[:8]) + (f" and {len(vessels) - 8} more" if len(vessels) > 8 else "")
            typer.echo(printable(f"{path}: is of {there}; this is {vessel}, --vessel NAME takes another"), err=True)


def open_in_browser(page: Path) -> None:
    """In the browser of the desktop; a machine without one gets a line instead of a browser in its terminal."""
    import webbrowser

    desktop = sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    try:
        opened = bool(desktop) and webbrowser.open(page.absolute().as_uri())
    except (webbrowser.Error, OSError):
        opened = False
    if not opened:
        typer.echo(f"no browser could be opened here; open {page} yourself", err=True)
