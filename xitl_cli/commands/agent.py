"""`xitl agent package|deploy`: installs the agent on a board. `agent.__main__` runs the agent itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from xitl_cli.deploy.ssh import Board

EMULATED = "board"
Destination = Annotated[
    str, typer.Argument(metavar="USER@HOST", help="The board, as for ssh; board:NAME is one of `xitl board`.")
]
Port = Annotated[int | None, typer.Option(min=1, max=65535, help="TCP port of the board's ssh server.")]
Identity = Annotated[Path | None, typer.Option(metavar="FILE", help="Private key for ssh.")]
SshConfig = Annotated[Path | None, typer.Option(metavar="FILE", help="ssh configuration instead of your own.")]


def reached(destination: str, port: int | None, identity: Path | None, ssh_config: Path | None) -> Board:
    """Return the board of a command line. The plug-in that registers `KIND` in `xitl.boards` resolves `KIND:NAME`.

    Raises UserError.
    """
    from xitl_cli.deploy.ssh import Board
    from xitl_cli.registry import BOARDS, load, names

    kind, colon, name = destination.partition(":")
    if colon and (kind in names(BOARDS) or kind == EMULATED):
        board: Board = load(BOARDS, kind)(name, port, identity, ssh_config)
        return board
    return Board(destination, port, identity, ssh_config)


def package(
    out: Annotated[Path, typer.Option(metavar="FILE", help="File to write.")] = Path("xitl-agent.pyz"),
) -> None:
    """Write the agent to one file that a board with Python 3.9 or newer can run without installation."""
    from rich.text import Text

    from xitl_cli.commands.terminal import terminal
    from xitl_cli.deploy.package import build
    from xitl_cli.errors import UserError

    made = build()
    try:
        out.write_bytes(made.data)
        out.chmod(0o755)
    except OSError as error:
        raise UserError(f"{out} cannot be written ({error.strerror}); choose another file with --out") from error
    console = terminal(soft_wrap=True)
    console.print(Text.assemble((str(out), "cyan"), f"  {len(made.data) / 1024:.0f} KiB"))
    console.print(Text(f"sha256  {made.sha256}", style="dim"))
    console.print(Text(f"parts   {', '.join(made.parts)}", style="dim"))
    for note in made.notes:
        console.print(Text(f"note: {note}", style="yellow"))


def deploy(
    destination: Destination,
    service: Annotated[
        bool, typer.Option("--service", help="Start the agent now and at each boot, as a service of systemd.")
    ] = False,
    link: Annotated[
        str | None, typer.Option(metavar="URL", help="Address at which the agent waits for the simulation host.")
    ] = None,
    role: Annotated[str | None, typer.Option(help="Role of the agent: fcu, companion or bridge.")] = None,
    gcs: Annotated[
        list[str] | None, typer.Option(metavar="URL", help="Address of a ground station. Repeatable.")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File with options of the agent, as for `xitl agent --config`."),
    ] = None,
    realtime: Annotated[
        int | None,
        typer.Option(min=1, max=99, help="Schedule the agent by SCHED_FIFO at this priority, and lock its memory."),
    ] = None,
    cpu: Annotated[
        str | None, typer.Option(metavar="N[,N]", help="Run the agent only on these processors, counted from 0.")
    ] = None,
    parameters: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Parameter file (.parm), which is copied to the board.")
    ] = None,
    link_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Key of the link to the host, which is copied to the board.")
    ] = None,
    signing_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Key of ground stations, which is copied to the board.")
    ] = None,
    port: Port = None,
    identity: Identity = None,
    ssh_config: SshConfig = None,
) -> None:
    """Install the agent on a board over ssh and check it there; with --service, start it as a service.

    A repeated call changes only files that differ.
    """
    from rich.text import Text

    from agent.board.install import settings_to_json
    from xitl_cli.commands.terminal import terminal
    from xitl_cli.deploy.package import build
    from xitl_cli.deploy.ssh import run_there, settings

    board = reached(destination, port, identity, ssh_config)
    single = {"link": link, "role": role, "cpu": cpu, "realtime": None if realtime is None else str(realtime)}
    options = {key: [value] for key, value in single.items() if value is not None}
    if gcs:
        options["gcs"] = gcs
    files = {"parameters": parameters, "link-key": link_key, "signing-key": signing_key}
    installation = settings(service, config, options, {key: path for key, path in files.items() if path is not None})
    made = build()
    outcome = run_there(board, made, ["install"], settings_to_json(installation))
    console = terminal(soft_wrap=True)
    console.print(Text.assemble((destination, "cyan"), f"  {outcome['machine']}, Python {outcome['python']}"))
    console.print(Text(f"sha256  {made.sha256}, verified on the board", style="dim"))
    for path in outcome["changed"]:
        console.print(Text.assemble("wrote   ", (path, "green")))
    if not outcome["changed"]:
        console.print(Text("nothing to do, all files are up to date"))
    if outcome["service"] is None:
        console.print(Text(f"start the agent on the board: {' '.join(outcome['command'])}"))
    else:
        console.print(Text(outcome["service"]))
    for note in (*outcome["notes"], *made.notes):
        console.print(Text(f"note: {note}", style="yellow"))
