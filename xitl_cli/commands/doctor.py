"""`xitl doctor`: checks this machine for simulation, and this machine or a board for hardware in the loop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.agent import Identity, Port, SshConfig, reached
from xitl_cli.commands.options import Json

if TYPE_CHECKING:
    from agent.board.doctor import DoctorFinding
    from xitl_cli.deploy.ssh import Board

HOST_PYTHON = (3, 11)
STYLES = {"ok": "", "warning": "yellow", "problem": "bold red"}


def doctor(
    destination: Annotated[
        str | None,
        typer.Argument(
            metavar="USER@HOST",
            help="Check this board over ssh (board:NAME: one of `xitl board`). Default: check this machine.",
        ),
    ] = None,
    link: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Also check that this link can be opened: its port, device or interface."),
    ] = None,
    as_json: Json = False,
    port: Port = None,
    identity: Identity = None,
    ssh_config: SshConfig = None,
) -> None:
    """Check that this machine or a board is ready for runs, and print how to correct each problem.

    This machine: packages, firmware and ports for simulation. This machine or a board: kernel, permissions, clocks and
    devices for hardware in the loop. Exit code 1 when something will not work.
    """
    from agent.board.doctor import examine, exit_code, findings_to_json

    simulating: list[DoctorFinding] = []
    if destination is None:
        from xitl_cli.readiness import examine_simulating

        simulating, machine = examine_simulating(), examine(link, HOST_PYTHON)
    else:
        machine = _examine_board(reached(destination, port, identity, ssh_config), link)
    if as_json:
        typer.echo(findings_to_json([*simulating, *machine]))
    else:
        _show(simulating, machine)
    raise typer.Exit(exit_code([*simulating, *machine]))


def _show(simulating: list[DoctorFinding], machine: list[DoctorFinding]) -> None:
    """Print the findings of each part, and the verdicts last."""
    from xitl_cli.commands.terminal import say, show_facts, terminal
    from xitl_cli.readiness import verdict, without_optional

    console = terminal()
    verdicts = []
    for title, purpose, findings in (
        ("Simulating", "simulating on this machine", simulating),
        ("Agent and hardware in the loop", "agent and hardware in the loop", machine),
    ):
        if not findings:
            continue
        say(console, title, "bold")
        facts = []
        for finding in findings:
            level = "" if finding.level == "ok" else f"{finding.level}: "
            advice = f"\n→ {finding.advice}" if finding.advice else ""
            facts.append((finding.check, f"{level}{finding.found}{advice}", STYLES[finding.level]))
        show_facts(console, facts)
        console.print()
        level, sentence = verdict(purpose, findings)
        verdicts.append((sentence + without_optional(findings), STYLES[level] or "green"))
    for sentence, style in verdicts:
        say(console, sentence, f"bold {style}")


def _examine_board(board: Board, link: str | None) -> list[DoctorFinding]:
    from agent.board.doctor import findings_from_objects
    from xitl_cli.deploy.package import build
    from xitl_cli.deploy.ssh import run_there
    from xitl_cli.errors import UserError

    arguments = ["doctor", "--for-host", *([] if link is None else [f"--link={link}"])]
    outcome = run_there(board, build(), arguments, b"")
    try:
        return findings_from_objects(outcome.get("findings"))
    except ValueError as error:
        raise UserError(f"{board.destination}: the answer of the board is {error}; try again") from None
