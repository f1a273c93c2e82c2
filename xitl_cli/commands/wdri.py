"""`xitl wdri`: the node graph of a profile, or of a run as it was, and its index against a reference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.graph.wdri import Vertices


def wdri(
    name: Annotated[
        str,
        typer.Argument(metavar="PROFILE", help="A shipped profile's name, a path to a .yaml, or a run's directory."),
    ],
    reference: Annotated[
        str | None, typer.Option(help="A profile, or `complete`: every node real and linked to every node.")
    ] = None,
    vertices: Annotated[
        str | None,
        typer.Option(help="Count that averages the degrees of PROFILE: architecture, present or a number."),
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of PROFILE.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object; numbers are not rounded.")] = False,
) -> None:
    """Print nodes, links and the WDRI of a profile: how near its graph comes to a reference, from 0 to 1.

    Of a run's directory: the nodes that were there and the links that carried something.
    """
    from xitl_cli.graph.of_profile import wdri_of
    from xitl_cli.graph.of_run import is_run, measured_run
    from xitl_cli.profile import load_with_origins

    count = _count(vertices)
    run = None
    if is_run(name):
        if overrides:
            raise UserError(
                f"{name}: is a run that is over, --set changes nothing in it; give a profile, or drop --set"
            )
        run = measured_run(Path(name), reference, count)
    result = wdri_of(load_with_origins(name, overrides or ()).profile, reference, count) if run is None else run.wdri
    if as_json:
        import json

        typer.echo(json.dumps((result if run is None else run).as_json(), ensure_ascii=False))
        return
    from xitl_cli.commands.wdri_report import show

    show(result, run)


def _count(text: str | None) -> Vertices | None:
    if text is None:
        return None
    if text == "architecture":
        return "architecture"
    if text == "present":
        return "present"
    if text.isascii() and text.isdigit() and 0 < int(text[:6]) <= 1000:
        return int(text)
    raise UserError(f"--vertices = {text!r} is not a count of vertices; write architecture, present or 1 to 1000")
