"""`xitl wdri`: the node graph of a profile or of a run, and its index against a reference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.options import Json, Set, complete_profile
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.graph.wdri import FleetWdri, VertexCount, Wdri
    from xitl_cli.run.run_graph import MeasuredRun


def wdri(
    name: Annotated[
        str,
        typer.Argument(
            metavar="PROFILE",
            help="Name of a shipped profile, path of a .yaml file, or a run directory.",
            autocompletion=complete_profile,
        ),
    ],
    reference: Annotated[
        str | None,
        typer.Option(
            metavar="PROFILE",
            help="Compare with this profile, or with `complete`, in which every node is real and linked to every node "
            "(default: the reference in the profile).",
            autocompletion=complete_profile,
        ),
    ] = None,
    vertices: Annotated[
        str | None,
        typer.Option(
            metavar="COUNT",
            help="Number of nodes over which the degrees of PROFILE are averaged: architecture, present or a number.",
        ),
    ] = None,
    vessel: Annotated[
        str | None, typer.Option("--vessel", metavar="NAME", help="Show the nodes of this vessel of a fleet.")
    ] = None,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Print the nodes, the links and the realism index (WDRI, from 0 to 1) of a profile or of a run.

    The weighted degree realism index compares the node graph with that of a reference. For a fleet, the command prints
    the index of each vessel and their mean. For a run directory, it counts only nodes that were connected and links
    that carried data.
    """
    from xitl_cli.graph.wdri import FleetWdri, fleet_wdri, profile_wdri
    from xitl_cli.profile import load_profile
    from xitl_cli.run.run_graph import is_run, measured_run, vessels_of_run

    count = _count(vertices)
    run = None
    if is_run(name):
        if overrides:
            raise UserError(f"{name} is a finished run, which --set cannot change; give a profile, or remove --set")
        names = vessels_of_run(Path(name))
        if names and vessel is None:
            fleet = FleetWdri({member: measured_run(Path(name), reference, count, member).wdri for member in names})
            _show_fleet(fleet, as_json)
            return
        run = measured_run(Path(name), reference, count, vessel)
        result = run.wdri
    else:
        profile = load_profile(name, overrides or ())
        if vessel is not None:
            profile = profile.vessel(vessel)
        elif profile.vessels is not None:
            _show_fleet(fleet_wdri(profile, reference, count), as_json)
            return
        result = profile_wdri(profile, reference, count)
    if as_json:
        import json

        typer.echo(json.dumps((run or result).as_json(), ensure_ascii=False))
        return
    _show(result, run)


def _show_fleet(fleet: FleetWdri, as_json: bool) -> None:
    if as_json:
        import json

        typer.echo(json.dumps(fleet.as_json(), ensure_ascii=False))
        return
    from xitl_cli.commands.terminal import say, show_facts, show_rows, terminal

    console = terminal()
    say(console, "Vessels", "bold")
    rows = []
    for name, vessel in fleet.vessels.items():
        kinds = [vertex.kind for vertex in vessel.graph.vertices]
        counts = (str(kinds.count("real")), str(kinds.count("virtual")))
        figures = (f"{figure:.4f}" for figure in (vessel.d_w_sim, vessel.d_w_ref, vessel.wdri))
        rows.append([name, *counts, *figures, vessel.reference])
    heads = ("vessel", "real", "virtual", "degree", "reference's", "WDRI", "reference")
    show_rows(console, heads, rows, text=(0, 6))
    console.print()
    lowest = min(fleet.vessels, key=lambda name: fleet.vessels[name].wdri)
    facts: list[tuple[str, str] | tuple[str, str, str]] = [
        ("WDRI", f"{fleet.wdri:.4f}, the mean of {len(rows)}", "bold"),
        ("lowest", f"{fleet.vessels[lowest].wdri:.4f}, {lowest}; --vessel {lowest} shows its nodes"),
    ]
    show_facts(console, facts)


def _count(text: str | None) -> VertexCount | None:
    if text is None:
        return None
    if text == "architecture":
        return "architecture"
    if text == "present":
        return "present"
    if text.isascii() and text.isdigit() and 0 < int(text[:6]) <= 1000:
        return int(text)
    raise UserError(f"--vertices {text!r} is not a number of nodes; write architecture, present or 1 to 1000")


def _show(result: Wdri, run: MeasuredRun | None) -> None:
    from xitl_cli.commands.terminal import say, show_facts, show_rows, terminal
    from xitl_cli.profile.schema.graph import node_meaning

    console, graph = terminal(), result.graph
    say(console, "Nodes", "bold")
    rows = [
        [
            vertex.name,
            vertex.kind,
            f"{vertex.weight:g}",
            str(degree),
            (vertex.does or node_meaning(vertex.name)) + (f" ({vertex.runs_on})" if vertex.runs_on else ""),
        ]
        for vertex, degree in zip(graph.vertices, graph.degrees(), strict=True)
    ]
    styles = ["dim" if vertex.kind == "absent" else "" for vertex in graph.vertices]
    show_rows(console, ("node", "kind", "weight", "degree", "what"), rows, text=(0, 1, 4), styles=styles)
    console.print()
    say(console, "Links", "bold")
    names = [vertex.name for vertex in graph.vertices]
    if max(map(len, names)) + sum(len(name) + 2 for name in names) <= console.width:
        matrix = [
            [name, *("1" if linked else "·" for linked in row)]
            for name, row in zip(names, graph.adjacency, strict=True)
        ]
        show_rows(console, ("", *names), matrix)
    else:  # too narrow for the matrix: a list of links
        to = (
            (name, [other for other, linked in zip(names, row, strict=True) if linked])
            for name, row in zip(names, graph.adjacency, strict=True)
        )
        show_facts(console, [(name, ", ".join(others) or "-") for name, others in to])
    console.print()
    facts: list[tuple[str, str] | tuple[str, str, str]] = [
        ("weighted degree", f"{result.d_w_sim:.4f} over n = {result.n} vertices"),
        ("of the reference", f"{result.d_w_ref:.4f} over n = {result.n_ref} vertices: {result.reference}"),
        ("WDRI", f"{result.wdri:.4f} = 1 - |sim - ref| / ref", "bold"),
    ]
    if run is not None:
        facts += [
            ("claimed by the profile", f"{run.claimed_wdri:.4f}"),
            ("claimed links without data", ", ".join(run.missing) or "-"),
            ("links with data, not claimed", ", ".join(run.unclaimed) or "-"),
            ("nodes claimed real, but virtual", ", ".join(run.overclaimed) or "-"),
        ]
    show_facts(console, facts)
