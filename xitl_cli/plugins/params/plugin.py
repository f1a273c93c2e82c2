"""Entry points of the plug-in `params`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xitl_cli.plugin import Command

if TYPE_CHECKING:
    import typer


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.params import command

    app.command("show")(command.show)
    app.command("diff")(command.diff)
    app.command("set")(command.set_values)
    app.command("push")(command.push)
    app.command("pull")(command.pull)
    app.command("check")(command.check)


COMMAND = Command("Read, compare and set the parameters of a vehicle.", _add, group=True)
