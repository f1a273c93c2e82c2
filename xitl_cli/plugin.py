"""Declarations that plug-ins register under the entry-point groups of `registry.py`.

Those of commands are here. `run_kinds.py` has those of runs. It is imported at the first use of one of them, because
`xitl --help` needs none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import typer
    from typer.core import TyperGroup

    from xitl_cli.run_kinds import DriverContext, DriverKind, LiveOutputKind, NodeContext, NodeKind

__all__ = ["Command", "DriverContext", "DriverKind", "LiveOutputKind", "NodeContext", "NodeKind"]


def __getattr__(name: str) -> Any:
    """Return a declaration of runs. Raises AttributeError for an unknown name."""
    if name in __all__:
        return getattr(import_module("xitl_cli.run_kinds"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


@dataclass(frozen=True, slots=True)
class Command:
    """A command of `xitl`, or a group of commands, under the name of its entry point (group `xitl.commands`)."""

    help: str
    """One sentence, for `xitl --help`. Of a single command it is the first sentence of the function's docstring."""

    add: Callable[[typer.Typer, str], None]
    """`add(app, name)` registers the functions. xitl calls it only when the command is on the command line, so that
    imports inside of it cost nothing elsewhere. A single command registers itself as `name` in `app`. The commands of a
    group register in `app`, which is the group."""

    group: bool = False
    """Whether it is a group of commands."""

    group_class: Callable[[], type[TyperGroup]] | None = None
    """Makes the click class of a group, None for the usual one."""

    help_without_command: bool = True
    """Whether a group shows its help when no command follows."""


def keep_group(app: typer.Typer) -> None:
    """Keep a group with one command a group: typer would turn it into the command itself."""

    def several() -> None:
        """Keeps the name of the only command."""

    app.callback()(several)
