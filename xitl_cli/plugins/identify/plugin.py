"""Entry points of the plug-in `identify`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xitl_cli.plugin import Command, keep_group

if TYPE_CHECKING:
    import typer


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.identify import vessel_command

    keep_group(app)
    app.command("vessel")(vessel_command.vessel)


COMMAND = Command("Identify the parameters of a vessel from logs.", _add, group=True)
