"""`xitl agent`: the agent's own entry point, listed among the commands."""

from __future__ import annotations

import typer


def agent(context: typer.Context) -> None:
    """Run the embedded autopilot for a simulation host, on this machine or a board (`xitl agent --help`)."""
    from agent.__main__ import main

    raise typer.Exit(main(context.args, program="xitl agent"))
