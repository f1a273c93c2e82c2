"""Entry point of the plug-in `twin`, for `pyproject.toml`. Its function imports lazily, so that loading is cheap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xitl_cli.plugin import Command

if TYPE_CHECKING:
    import typer


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.twin.command import twin

    app.command(name)(twin)


COMMAND = Command("Run the model of a boat next to the real boat, record both, and name their difference.", _add)
