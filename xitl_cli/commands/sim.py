"""`xitl sim`: one run of a profile."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from xitl_cli.errors import UserError


def sim(
    profile: Annotated[
        str, typer.Option("--profile", "-p", help="Profile name (see `xitl profiles list`) or path.")
    ] = "sitl",
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Override a key: environment.wind.mean_mps=8. Repeatable."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Run directory (default: runs/<profile>-<time>).")
    ] = None,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="End after this much simulation time.")
    ] = None,
    clock: Annotated[str | None, typer.Option("--clock", help="lockstep or realtime.")] = None,
    firmware: Annotated[
        str | None,
        typer.Option(
            "--firmware",
            metavar="PATH",
            help="Program of the autopilot to start; `find` looks for one, `external` waits for one started elsewhere.",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Seed of everything random.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON and nothing else.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier run in the same DIR.")] = False,
) -> None:
    """Run a simulation. Exit code: 0 completed, 1 not completed, 2 something to put right, 130 interrupted."""
    from rich.console import Console

    from xitl_cli.commands.sim_report import show_result
    from xitl_cli.profile import load_profile
    from xitl_cli.run.core.directory import default_path
    from xitl_cli.run.session import run
    from xitl_cli.run.view import make_view

    options = {"clock.duration_s": duration, "clock.mode": clock, "clock.seed": seed, "autopilot.firmware": firmware}
    given = [f"{key}={value}" for key, value in options.items() if value is not None]
    loaded = load_profile(profile, [*(overrides or []), *given])
    console = Console(stderr=as_json)
    result = run(loaded, out or default_path(loaded.name), overwrite, lambda: make_view(console, loaded.name, as_json))
    if as_json:
        typer.echo(json.dumps(result.summary, indent=2, allow_nan=False))
    else:
        show_result(console, loaded, result)
    if result.summary["error"]:
        raise UserError(f"{result.summary['error']} (what was recorded is in {result.directory})")
    raise typer.Exit(result.exit_code)
