"""The commands of xitl, for tests that call them within their process."""

from __future__ import annotations

from collections.abc import Sequence

import typer

from xitl_cli import main


def xitl_app(arguments: Sequence[str] | None = None) -> typer.Typer:
    """Return all commands. With `arguments`, the others stay empty, because filling them takes time."""
    return main._app(arguments)
