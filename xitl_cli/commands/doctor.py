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
            metavar="USER@HOST", help="A board, over ssh (board:NAME: an emulated one); this machine if left out."
        ),
    ] = None,
    link: Annotated[
        str | None, typer.Option(metavar="URL", help="Link to try as well: its port, device or interface.")
    ] = None,
    as_json: Json = False,
    port: Port = None,
    identity: Identity = None,
    ssh_config: SshConfig = None,
) -> None:
    """Check this machine: extras, firmware, ports; it or a board: kernel, permissions, clocks, devices.

    Exit code 1 when something will not work.
    """
    from agent.board.doctor import examine, exit_code, findings_to_json

    simulating: list[DoctorFinding] = []
    if destination is None:
        from xitl_cli.readiness import examine_simulating

        simulating, machine = examine_simulating(), examine(link, HOST_PYTHON)
    else:
        machine = _examined_there(reached(destination, port, identity, ssh_config), link)
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
    for title, what, findings in (
        ("Simulating", "simulating on this machine", simulating),
        ("Agent and hardware in the loop", "agent and hardware in the loop", machine),
    ):
        if not findings:
            continue
        say(console, title, "bold")
        show_facts(console, [(finding.check, _text(finding), STYLES[finding.level]) for finding in findings])
        console.print()
        level, sentence = verdict(what, findings)
        verdicts.append((sentence + without_optional(findings), STYLES[level] or "green"))
    for sentence, style in verdicts:
        say(console, sentence, f"bold {style}")


def _text(finding: DoctorFinding) -> str:
    level = "" if finding.level == "ok" else f"{finding.level}: "
    return f"{level}{finding.found}" + (f"\n→ {finding.advice}" if finding.advice else "")


def _examined_there(board: Board, link: str | None) -> list[DoctorFinding]:
    from agent.board.doctor import findings_from_objects
    from xitl_cli.deploy.package import build
    from xitl_cli.deploy.ssh import run_there
    from xitl_cli.errors import UserError

    arguments = ["doctor", "--for-host", *([] if link is None else [f"--link={link}"])]
    outcome = run_there(board, build(), arguments, b"")
    try:
        return findings_from_objects(outcome.get("findings"))
    except ValueError as error:
        raise UserError(f"{board.destination}: the answer is {error}; try again") from None
