"""The commands of xitl, for tests that call them within their process."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import pytest
import typer

from xitl_cli import main


def xitl_app(arguments: Sequence[str] | None = None) -> typer.Typer:
    """Return all commands. With `arguments`, the others stay empty, because filling them takes time."""
    return main._app(arguments)


def xitl(*arguments: str) -> int:
    """Run a command within this process. Return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["xitl", *arguments])
        with pytest.raises(SystemExit) as ended:
            main.main()
    return int(ended.value.code or 0)
