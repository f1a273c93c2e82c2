"""Shared functions of commands that print a lot."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from xitl_cli.errors import UserError
from xitl_cli.logs.model.text import printable

if TYPE_CHECKING:
    from rich.console import Console

    from xitl_cli.logs.model.log import Log
    from xitl_cli.logs.model.sections import Section

GONE = (errno.EPIPE, errno.EIO)
"""Errors of an output without a reader, or with a closed terminal."""


@contextmanager
def quiet_pipe() -> Iterator[None]:
    """End the output without an error when its reader closes it (`| head`)."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        discard_output()
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
        discard_output()


def discard_output() -> None:
    """Send the rest of the output nowhere. Otherwise, the interpreter raises again when it flushes the buffer."""
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
            names = ", ".join(vessels[:8]) + (f" and {len(vessels) - 8} more" if len(vessels) > 8 else "")
            text = f"{path} contains {names}; this is {vessel}, --vessel NAME selects another"
            typer.echo(printable(text), err=True)


def open_in_browser(page: Path) -> None:
    """Open the page in the desktop's browser. On a machine without a desktop, print a line instead."""
    import webbrowser

    desktop = sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    try:
        opened = bool(desktop) and webbrowser.open(page.absolute().as_uri())
    except (webbrowser.Error, OSError):
        opened = False
    if not opened:
        typer.echo(f"no web browser could be opened; open {page} yourself", err=True)


def show_sections(console: Console, sections: Sequence[Section]) -> None:
    """Print the findings of each section of a campaign, their next steps and its tables."""
    from xitl_cli.commands.terminal import say
    from xitl_cli.logs.model.sections import Severity
    from xitl_cli.logs.report.terminal import show_section

    styles = {Severity.CRITICAL: "bold red", Severity.WARNING: "yellow", Severity.NOTICE: "cyan", Severity.OK: "green"}
    for section in sections:
        for finding in section.findings:
            console.print()
            say(console, f"{finding.sentence}.", styles[finding.severity])
            if finding.next_step:
                say(console, finding.next_step)
        show_section(console, section)


def sections_document(sections: Sequence[Section]) -> dict[str, Any]:
    """Return the sections by their keys, as in `xitl logs analyze --json`."""
    from xitl_cli.logs.clocks.time_line import TimeLine
    from xitl_cli.logs.report.json import section_document

    return {section.key: section_document(section, TimeLine()) for section in sections}
