"""`xitl paper 4.2`: the paper's experiments."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from xitl_cli.commands.terminal import say, show_rows, terminal

if TYPE_CHECKING:
    from xitl_cli.experiments.departure import DepartureRun

INTERRUPTED = 130
WHOSE = {"own": "its own", "ours": "our"}


def section_4_2(
    firmware: Annotated[
        str | None,
        typer.Option("--firmware", metavar="PATH", help="ardurover to start (default: the one that is found)."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="For its six runs (default: runs/paper-4.2-<time>).")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of everything random, the same for all runs.")] = 1,
    duration: Annotated[float, typer.Option("--duration", metavar="S", help="Simulation time of each run.")] = 120.0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier runs in the same DIR.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Compare how soon ArduPilot departs with its own simulated sensors and with ours, in the paper's environments.

    Exit code: 0 when the vessel moved in all runs, 1 when not, 2 something to put right.
    """
    from xitl_cli.experiments.departure import EVENTS, InterruptedRunError, measure_departures, table_json

    console = terminal(stderr=as_json, soft_wrap=True)
    directory = out or Path("runs") / f"paper-4.2-{datetime.now(UTC).strftime('%Y%m%d-%H%M%S')}"

    def on_departure(one: DepartureRun) -> None:
        times = ", ".join(f"{name} {_seconds(one.times_s[event])}" for event, name in EVENTS.items())
        console.print(f"{one.environment}, {WHOSE[one.sensors]} sensors: {times}", markup=False)
        if one.problem:
            console.print(f"  {one.problem}", markup=False)

    try:
        departures = measure_departures(directory, firmware, seed, duration, overwrite, on_departure)
    except InterruptedRunError:
        raise typer.Exit(INTERRUPTED) from None
    report = json.dumps(table_json(departures), indent=2, ensure_ascii=False)
    (directory / "table.json").write_text(report + "\n", encoding="utf-8")
    if as_json:
        typer.echo(report)
    else:
        _show(console, departures)
        console.print(f"\nruns, profiles and table.json: {directory}", markup=False)
    moved = all(one.times_s["time_to_motion_s"] is not None for one in departures)
    raise typer.Exit(0 if moved else 1)


def _show(console: Console, departures: list[DepartureRun]) -> None:
    from xitl_cli.experiments.departure import ENVIRONMENTS, EVENTS, compare_departures

    rows: list[list[str]] = []
    before = ""
    for row in compare_departures(departures):
        named = ENVIRONMENTS[row.environment] if row.environment != before else ""
        before = row.environment
        difference = "–" if row.difference_s is None else f"{row.difference_s:+.1f} s"
        rows.append([named, EVENTS[row.event], _seconds(row.own_s), _seconds(row.ours_s), difference])
    console.print()
    firmware = departures[0].firmware or "–"
    say(console, f"Section 4.2: departure of ArduPilot {firmware}, simulation time from its start", "bold")
    heads = ("environment", "event", "own sensors", "our sensors", "difference")
    show_rows(console, heads, rows, text=(0, 1))


def _seconds(value_s: float | None) -> str:
    return "–" if value_s is None else f"{value_s:.1f} s"
