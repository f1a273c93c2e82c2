"""Entry points of the plug-in `logs`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xitl_cli.plugin import Command

if TYPE_CHECKING:
    import typer


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.logs import analyze_command, command, compare_command

    app.command("info")(command.info)
    app.command("dump")(command.dump)
    app.command("export")(command.export)
    app.command("analyze")(analyze_command.analyze)
    app.command("plot")(analyze_command.plot)
    app.command("compare")(compare_command.compare)
    app.command("repair")(command.repair)
    app.command("tasks")(command.tasks)


COMMAND = Command("Look into the logs of vehicles and runs.", _add, group=True)
