"""Shared functions of commands that print a lot."""

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
"""Errors of an output without a reader, or with a closed terminal."""


@contextmanager
def quiet_pipe() -> Iterator[None]:
    """End the output without an error when its reader closes it (`| head`)."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        # The interpreter would raise again when it flushes the rest of the buffer.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(0) from None


@contextmanager
def still_read() -> Iterator[None]:
    """Ignore a closed reader or terminal, so that the command keeps its exit code."""
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        if error.errno not in GONE:
            raise
        # The interpreter would raise again when it flushes the rest of the buffer.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def refuse(sentences: Sequence[str]) -> None:
    """Print a line for each file that could not be read; raises UserError with the last of them."""
    for sentence in sentences[:-1]:
        typer.echo(f"error: {printable(sentence)}", err=True)
    if sentences:
        raise UserError(sentences[-1])


def tell_damage(*logs: Log) -> None:
    """Print a line on stderr for each log with missing or doubtful data, with the way to repair it."""
    from xitl_cli.logs.report.wording import damage_sentences

    for log in logs:
        health = log.health
        if health.degraded:
            typer.echo(printable(f"{log.path}: degraded: {'; '.join(damage_sentences(health))}"), err=True)


def tell_vessels(*shown: tuple[Path, str, Sequence[str]]) -> None:
    """Print a line on stderr for each recording of several vessels: path, selected vessel, and all vessels."""
    for path, vessel, vessels in shown:
        if vessel:
            there = ", ".join(vessels[:8]) + (f" and {len(vessels) - 8} more" if len(vessels) > 8 else "")
            typer.echo(printable(f"{path}: is of {there}; this is {vessel}, --vessel NAME takes another"), err=True)


def open_in_browser(page: Path) -> None:
    """Open the page in the desktop's browser. On a machine without a desktop, print a line instead."""
    import webbrowser

    desktop = sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    try:
        opened = bool(desktop) and webbrowser.open(page.absolute().as_uri())
    except (webbrowser.Error, OSError):
        opened = False
    if not opened:
        typer.echo(f"no browser could be opened here; open {page} yourself", err=True)
