"""`xitl wdri`: the node graph of a profile, or of a run as it was, and its index against a reference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.graph.wdri import VertexCount, Wdri
    from xitl_cli.run.run_graph import MeasuredRun


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
    from xitl_cli.graph.wdri import profile_wdri
    from xitl_cli.profile import load_profile
    from xitl_cli.run.run_graph import is_run, measured_run

    count = _count(vertices)
    run = None
    if is_run(name):
        if overrides:
            raise UserError(
                f"{name}: is a run that is over, --set changes nothing in it; give a profile, or drop --set"
            )
        run = measured_run(Path(name), reference, count)
        result = run.wdri
    else:
        result = profile_wdri(load_profile(name, overrides or ()), reference, count)
    if as_json:
        import json

        typer.echo(json.dumps((run or result).as_json(), ensure_ascii=False))
        return
    _show(result, run)


def _count(text: str | None) -> VertexCount | None:
    if text is None:
        return None
    if text == "architecture":
        return "architecture"
    if text == "present":
        return "present"
    if text.isascii() and text.isdigit() and 0 < int(text[:6]) <= 1000:
        return int(text)
    raise UserError(f"--vertices = {text!r} is not a count of vertices; write architecture, present or 1 to 1000")


def _show(result: Wdri, run: MeasuredRun | None) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from xitl_cli.profile.schema.graph import node_meaning

    graph = result.graph
    nodes = Table(title="Nodes", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    nodes.add_column("node", no_wrap=True)
    nodes.add_column("is", ratio=3)
    nodes.add_column("kind", no_wrap=True)
    nodes.add_column("runs on", ratio=2)
    nodes.add_column("weight", justify="right", no_wrap=True)
    nodes.add_column("degree", justify="right", no_wrap=True)
    for vertex, degree in zip(graph.vertices, graph.degrees(), strict=True):
        does, runs_on = Text(vertex.does or node_meaning(vertex.name)), Text(vertex.runs_on or "-")
        style = "dim" if vertex.kind == "absent" else None
        nodes.add_row(vertex.name, does, vertex.kind, runs_on, f"{vertex.weight:g}", str(degree), style=style)
    links = Table(title="Links", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    links.add_column("", no_wrap=True)
    for vertex in graph.vertices:
        links.add_column(vertex.name, justify="right", no_wrap=True)
    for vertex, row in zip(graph.vertices, graph.adjacency, strict=True):
        links.add_row(vertex.name, *("1" if linked else "·" for linked in row))
    index = Table(box=None, show_header=False, pad_edge=False)
    index.add_column(no_wrap=True)
    index.add_column(justify="right", no_wrap=True)
    index.add_column()
    index.add_row("weighted degree", f"{result.d_w_sim:.4f}", f"over n = {result.n} vertices")
    reference = Text(f"over n = {result.n_ref} vertices: {result.reference}")
    index.add_row("of the reference", f"{result.d_w_ref:.4f}", reference)
    index.add_row(Text("WDRI", style="bold"), Text(f"{result.wdri:.4f}", style="bold"), "1 - |sim - ref| / ref")
    tables = [nodes, links, index]
    if run is not None:
        differences = Table(box=None, show_header=False, pad_edge=False)
        differences.add_row("claimed by the profile", f"{run.claimed_wdri:.4f}")
        differences.add_row("claimed, but nothing was carried", Text(", ".join(run.missing) or "-"))
        differences.add_row("carried, but not claimed", Text(", ".join(run.unclaimed) or "-"))
        tables.append(differences)
    console = Console(highlight=False)
    for table in tables:
        console.print(table)
