"""`xitl campaign compare`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from xitl_cli.commands.options import Json
from xitl_cli.commands.output import quiet_pipe
from xitl_cli.commands.terminal import say, terminal
from xitl_cli.errors import UserError
from xitl_cli.extras import CAMPAIGN


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Folder of a campaign: what the other is held against.")],
    b: Annotated[
        Path | None, typer.Argument(metavar="[B]", help="Folder of another one with the same seeds and axes.")
    ] = None,
    by: Annotated[
        str | None,
        typer.Option("--by", metavar="AXIS", help="Split A by an axis in place of B; its first value is A."),
    ] = None,
    confidence: Annotated[float, typer.Option(min=0.5, max=0.9999, help="Of the intervals and tests.")] = 0.95,
    report: Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Write a page with plots.")] = None,
    as_json: Json = False,
) -> None:
    """Compare two controllers, firmwares or vessels: run by run on the same seeds.

    Differences with intervals and a paired t test, pass rates by an exact test. Both count the pairs of one seed as a
    cluster. P-values are adjusted for all figures and verdicts together.
    """
    CAMPAIGN.require("a comparison needs")
    if (b is None) == (by is None):
        raise UserError("compare: give a second folder, or --by with an axis of the first; one of the two")
    from xitl_cli.commands.output import sections_document, show_sections
    from xitl_cli.logs.report.html import refuse_other, write_sections
    from xitl_cli.plugins.campaign.compare import compare_by, compare_tables
    from xitl_cli.plugins.campaign.report import comparison_section
    from xitl_cli.plugins.campaign.results import ResultTable

    if report is not None:
        refuse_other(report)
    table = ResultTable.read(a)
    if b is not None:
        told = [compare_tables(table, ResultTable.read(b), confidence)]
    else:
        assert by is not None
        told = compare_by(table, by, confidence)
    sections = [comparison_section(one, number) for number, one in enumerate(told, 1)]
    if report is not None:
        write_sections(report, "Comparison", "; ".join(section.title for section in sections), sections)
    with quiet_pipe():
        if as_json:
            print(json.dumps(sections_document(sections), indent=2, allow_nan=False))
            return
        console = terminal()
        show_sections(console, sections)
        if report is not None:
            say(console, f"{report} has the plots")
