"""A graph and its WDRI for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from xitl_cli.graph.of_run import MeasuredRun
    from xitl_cli.graph.wdri import Wdri


def show(result: Wdri, run: MeasuredRun | None) -> None:
    console = Console(highlight=False)
    console.print(_nodes(result))
    console.print(_links(result))
    console.print(_index(result))
    if run is not None:
        console.print(_differences(run))


def _nodes(result: Wdri) -> Table:
    from xitl_cli.graph.nodes import meaning

    table = Table(title="Nodes", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("node", no_wrap=True)
    table.add_column("is", ratio=3)
    table.add_column("kind", no_wrap=True)
    table.add_column("runs on", ratio=2)
    table.add_column("weight", justify="right", no_wrap=True)
    table.add_column("degree", justify="right", no_wrap=True)
    for vertex, degree in zip(result.graph.vertices, result.graph.degrees(), strict=True):
        table.add_row(
            vertex.name,
            Text(vertex.does or meaning(vertex.name)),
            vertex.kind,
            Text(vertex.runs_on or "-"),
            f"{vertex.weight:g}",
            str(degree),
            style="dim" if vertex.kind == "absent" else None,
        )
    return table


def _links(result: Wdri) -> Table:
    table = Table(title="Links", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    for vertex in result.graph.vertices:
        table.add_column(vertex.name, justify="right", no_wrap=True)
    for vertex, row in zip(result.graph.vertices, result.graph.adjacency, strict=True):
        table.add_row(vertex.name, *("1" if linked else "·" for linked in row))
    return table


def _index(result: Wdri) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    table.add_column()
    table.add_row("weighted degree", f"{result.d_w_sim:.4f}", f"over n = {result.n} vertices")
    table.add_row(
        "of the reference", f"{result.d_w_ref:.4f}", Text(f"over n = {result.n_ref} vertices: {result.reference}")
    )
    table.add_row(Text("WDRI", style="bold"), Text(f"{result.wdri:.4f}", style="bold"), "1 - |sim - ref| / ref")
    return table


def _differences(run: MeasuredRun) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_row("claimed by the profile", f"{run.claimed_wdri:.4f}")
    table.add_row("claimed, but nothing was carried", Text(", ".join(run.missing) or "-"))
    table.add_row("carried, but not claimed", Text(", ".join(run.unclaimed) or "-"))
    return table
