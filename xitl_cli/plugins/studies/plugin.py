"""Entry points of the plug-in `studies`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xitl_cli.plugin import Command, keep_group

if TYPE_CHECKING:
    import typer


def _add_paper(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.studies import paper_command

    app.command("4.1")(paper_command.section_4_1)
    app.command("4.2")(paper_command.section_4_2)
    app.command("4.3")(paper_command.section_4_3)
    app.command("4.4")(paper_command.section_4_4)
    app.command("wdri")(paper_command.wdri)
    app.command("all")(paper_command.all_sections)


def _add_validate(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.studies.validate_command import validate

    app.command(name)(validate)


def _add_vehicle(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.studies import hydrodynamics_command, vehicle_command

    keep_group(app)
    app.command("check")(vehicle_command.check)
    app.command("hydrodynamics")(hydrodynamics_command.hydrodynamics)


PAPER = Command("Repeat the experiments of the paper.", _add_paper, group=True)
VALIDATE = Command(
    "Sail the standard manoeuvres with vessels and compare each figure with its reference.", _add_validate
)
VEHICLE = Command(
    "Check the model of a vessel, and compute its wave forces with a panel code.", _add_vehicle, group=True
)
