"""Entry points of the plug-in `firmware`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xitl_cli.plugin import Command

if TYPE_CHECKING:
    import typer


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.firmware import command

    app.command("get")(command.get)
    app.command("list")(command.list_firmware)
    app.command("path")(command.path)


COMMAND = Command("Download the firmware of other autopilots.", _add, group=True)
