"""`xitl plugins`: lists the installed plug-ins."""

from __future__ import annotations

import json
from dataclasses import asdict

import typer

from xitl_cli.commands.options import Json


def plugins(as_json: Json = False) -> None:
    """List the installed plug-ins and the errors of those that cannot be loaded.

    Each plug-in is listed with its package. Exit code 1 when one cannot be loaded.
    """
    from xitl_cli.commands.terminal import say, show_rows, terminal
    from xitl_cli.registry import GROUPS
    from xitl_cli.registry import plugins as registered

    rows = registered()
    broken = [row for row in rows if row.error]
    if as_json:
        typer.echo(json.dumps({"plugins": [asdict(row) for row in rows]}, ensure_ascii=False))
        raise typer.Exit(1 if broken else 0)
    console = terminal()
    for group in GROUPS:
        of_group = [row for row in rows if row.group == group]
        if not of_group:
            continue
        say(console, group, "bold")
        lines = [
            [row.name, f"{row.package} {row.version}", "cannot be loaded" if row.error else ""] for row in of_group
        ]
        show_rows(console, ("", "", ""), lines, text=(0, 1, 2))
        console.print()
    for row in broken:
        say(console, row.error, "bold red")
    raise typer.Exit(1 if broken else 0)
