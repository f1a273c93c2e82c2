"""Entry points of the plug-in `campaign`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xitl_cli.plugin import Command

if TYPE_CHECKING:
    import typer
    from typer.core import TyperGroup


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.campaign import command

    app.command(command.DEFAULT_COMMAND)(command.run)
    app.command("compare")(command.compare)


def _group_class() -> type[TyperGroup]:
    from xitl_cli.plugins.campaign.command import CampaignGroup

    return CampaignGroup


COMMAND = Command(
    "Run a plan of many runs: `xitl campaign PLAN.yaml` (options: `xitl campaign run -h`), or compare two campaigns.",
    _add,
    group=True,
    group_class=_group_class,
)
