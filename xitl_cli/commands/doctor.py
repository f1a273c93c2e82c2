"""`xitl doctor`: whether this machine, or a board, is fit for hardware in the loop."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.agent import Identity, Port, SshConfig

if TYPE_CHECKING:
    from agent.board.doctor import DoctorFinding
    from xitl_cli.deploy.ssh import Board

HOST_PYTHON = (3, 11)


def doctor(
    destination: Annotated[
        str | None, typer.Argument(metavar="[USER@HOST]", help="A board, over ssh; this machine if left out.")
    ] = None,
    link: Annotated[
        str | None, typer.Option(metavar="URL", help="Link to try as well: its port, device or interface.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Findings as JSON.")] = False,
    port: Port = None,
    identity: Identity = None,
    ssh_config: SshConfig = None,
) -> None:
    """Check this machine or a board: kernel, permissions, clocks, ports, devices. Exit code 1 on a problem."""
    from agent.board.doctor import examine, exit_code, findings_text, findings_to_json

    if destination is None:
        findings = examine(link, HOST_PYTHON)
    else:
        from xitl_cli.deploy.ssh import Board

        findings = _examined_there(Board(destination, port, identity, ssh_config), link)
    colour = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    print(findings_to_json(findings) if as_json else findings_text(findings, colour))
    raise typer.Exit(exit_code(findings))


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
