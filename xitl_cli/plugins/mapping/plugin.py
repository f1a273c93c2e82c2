"""Entry points of the plug-in `mapping`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xitl_cli.plugin import Command

if TYPE_CHECKING:
    import typer


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.mapping.command import map_command

    app.command(name)(map_command)


COMMAND = Command(
    "Run the companion's odometry and mapping over a recording: map, trajectories and their errors.", _add
)
