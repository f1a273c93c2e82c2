"""Entry points of the plug-in `identify`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xitl_cli.plugin import Command

if TYPE_CHECKING:
    import typer


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.identify import command

    app.command("sensors")(command.sensors)
    app.command("vessel")(command.vessel)


COMMAND = Command("Identify a vessel and its sensors from logs.", _add, group=True)
