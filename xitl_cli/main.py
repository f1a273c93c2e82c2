"""The `xitl` command: one line per command. The only place that turns an error into a line and an exit code."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, NoReturn

from xitl_cli.errors import UserError

if TYPE_CHECKING:
    import typer

_ABOUT_THE_AGENT = (["package"], ["deploy"])


def main() -> NoReturn:
    """Entry point of the console script."""
    # Before numpy is loaded: the matrices are small, and a second thread costs more than it brings.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if sys.argv[1:2] == ["agent"] and sys.argv[2:3] not in _ABOUT_THE_AGENT:
        from agent.__main__ import main as agent_main  # without the command-line library: boards are small

        sys.exit(agent_main(sys.argv[2:], program="xitl agent"))
    try:
        _app()()
    except UserError as error:
        fail(str(error))
    sys.exit(0)


def fail(message: str) -> NoReturn:
    """One red line, exit code 2."""
    from rich.console import Console

    Console(stderr=True, soft_wrap=True, highlight=False).print(f"error: {message}", style="bold red", markup=False)
    sys.exit(2)


def _app() -> typer.Typer:
    import typer

    from xitl_cli.commands import (
        agent,
        doctor,
        firmware,
        logs,
        logs_analyze,
        logs_compare,
        paper,
        params,
        profiles,
        sim,
        wdri,
    )

    app = typer.Typer(
        name="xitl",
        help="X-in-the-loop simulation for autonomous boats and other MAVLink vehicles.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    profile_commands = typer.Typer(help="List, show and check profiles.", no_args_is_help=True)
    profile_commands.command("list")(profiles.list_profiles)
    profile_commands.command("show")(profiles.show)
    profile_commands.command("check")(profiles.check)
    agent_commands = typer.Typer(
        help="Run the agent for a simulation host (`xitl agent --help`), package it, deploy it to a board."
    )
    agent_commands.command("package")(agent.package)
    agent_commands.command("deploy")(agent.deploy)
    parameter_commands = typer.Typer(help="Read, compare and set parameters of a vehicle.", no_args_is_help=True)
    parameter_commands.command("show")(params.show)
    parameter_commands.command("diff")(params.diff)
    parameter_commands.command("set")(params.set_values)
    parameter_commands.command("push")(params.push)
    parameter_commands.command("pull")(params.pull)
    parameter_commands.command("check")(params.check)
    firmware_commands = typer.Typer(help="Download the firmware of other autopilots.", no_args_is_help=True)
    firmware_commands.command("get")(firmware.get)
    firmware_commands.command("list")(firmware.list_firmware)
    firmware_commands.command("path")(firmware.path)
    log_commands = typer.Typer(help="Look into the logs of vehicles and runs.", no_args_is_help=True)
    log_commands.command("info")(logs.info)
    log_commands.command("dump")(logs.dump)
    log_commands.command("export")(logs.export)
    log_commands.command("analyze")(logs_analyze.analyze)
    log_commands.command("plot")(logs_analyze.plot)
    log_commands.command("compare")(logs_compare.compare)
    log_commands.command("tasks")(logs.tasks)
    paper_commands = typer.Typer(help="Repeat the experiments of the paper.", no_args_is_help=True)
    paper_commands.callback()(_several)
    paper_commands.command("4.2")(paper.section_4_2)
    app.command("sim")(sim.sim)
    app.add_typer(agent_commands, name="agent")
    app.command("doctor")(doctor.doctor)
    app.command("wdri")(wdri.wdri)
    app.add_typer(profile_commands, name="profiles")
    app.add_typer(parameter_commands, name="params")
    app.add_typer(firmware_commands, name="firmware")
    app.add_typer(log_commands, name="logs")
    app.add_typer(paper_commands, name="paper")
    version = typer.Option(False, "--version", callback=_show_version, is_eager=True, help="Show the version and exit.")

    def options(version: bool = version) -> None:
        """X-in-the-loop simulation for autonomous boats and other MAVLink vehicles."""

    app.callback()(options)
    return app


def _several() -> None:
    """Keeps the name of a group's only command."""


def _show_version(wanted: bool) -> None:
    if wanted:
        import typer

        from agent import __version__

        typer.echo(f"xitl {__version__}")
        raise typer.Exit


if __name__ == "__main__":
    main()
