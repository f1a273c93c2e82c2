"""`xitl agent package|deploy`: installs the agent on a board. `agent.__main__` runs the agent itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from xitl_cli.deploy.ssh import Board

EMULATED = "board"
Destination = Annotated[
    str, typer.Argument(metavar="USER@HOST", help="The board, as ssh knows it; board:NAME is one of `xitl board`.")
]
Port = Annotated[int | None, typer.Option(min=1, max=65535, help="Port of the board's ssh server.")]
Identity = Annotated[Path | None, typer.Option(metavar="FILE", help="Private key to log in with.")]
SshConfig = Annotated[Path | None, typer.Option(metavar="FILE", help="ssh settings in place of your own ones.")]


def run_agent(context: typer.Context) -> None:
    """Run the agent for a simulation host (`xitl agent --help`), or bring it to a board."""
    if context.invoked_subcommand is None:
        from agent.__main__ import main

        raise typer.Exit(main([], program="xitl agent"))


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
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where to write it.")] = Path("xitl-agent.pyz"),
) -> None:
    """Make one file of the agent for a board: nothing to install there but Python 3.9 or newer."""
    from rich.text import Text

    from xitl_cli.commands.terminal import terminal
    from xitl_cli.deploy.package import build
    from xitl_cli.errors import UserError

    made = build()
    try:
        out.write_bytes(made.data)
        out.chmod(0o755)
    except OSError as error:
        raise UserError(f"{out}: cannot be written ({error.strerror}); choose another place with --out") from error
    console = terminal(soft_wrap=True)
    console.print(Text.assemble((str(out), "cyan"), f"  {len(made.data) / 1024:.0f} KiB"))
    console.print(Text(f"sha256  {made.sha256}", style="dim"))
    console.print(Text(f"in it   {', '.join(made.parts)}", style="dim"))
    for note in made.notes:
        console.print(Text(f"note: {note}", style="yellow"))


def deploy(
    destination: Destination,
    service: Annotated[bool, typer.Option("--service", help="Have systemd start it now and at each boot.")] = False,
    link: Annotated[str | None, typer.Option(metavar="URL", help="Where the agent waits for the host.")] = None,
    role: Annotated[str | None, typer.Option(help="fcu, companion or bridge.")] = None,
    gcs: Annotated[list[str] | None, typer.Option(metavar="URL", help="Ground station of the agent.")] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Options of the agent, see --config there.")
    ] = None,
    realtime: Annotated[int | None, typer.Option(min=1, max=99, help="Priority of SCHED_FIFO, memory locked.")] = None,
    cpu: Annotated[str | None, typer.Option(metavar="N[,N]", help="Processors to keep to.")] = None,
    parameters: Annotated[Path | None, typer.Option(metavar="FILE", help="Parameters to bring along.")] = None,
    link_key: Annotated[Path | None, typer.Option(metavar="FILE", help="Key of the link to bring along.")] = None,
    signing_key: Annotated[Path | None, typer.Option(metavar="FILE", help="Ground stations' key, too.")] = None,
    port: Port = None,
    identity: Identity = None,
    ssh_config: SshConfig = None,
) -> None:
    """Bring the agent to a board over ssh, check it there, and start it as a service. A second time changes nothing."""
    from rich.text import Text

    from agent.board.install import settings_to_json
    from xitl_cli.commands.terminal import terminal
    from xitl_cli.deploy.package import build
    from xitl_cli.deploy.ssh import run_there, settings

    board = reached(destination, port, identity, ssh_config)
    given = {"link": link, "role": role, "cpu": cpu, "realtime": None if realtime is None else str(realtime)}
    options = {key: [value] for key, value in given.items() if value is not None}
    files = {"parameters": parameters, "link-key": link_key, "signing-key": signing_key}
    wanted = settings(
        service,
        config,
        {**options, **({"gcs": gcs} if gcs else {})},
        {key: path for key, path in files.items() if path is not None},
    )
    made = build()
    outcome = run_there(board, made, ["install"], settings_to_json(wanted))
    console = terminal(soft_wrap=True)
    console.print(Text.assemble((destination, "cyan"), f"  {outcome['machine']}, Python {outcome['python']}"))
    console.print(Text(f"sha256  {made.sha256}, checked there", style="dim"))
    for path in outcome["changed"]:
        console.print(Text.assemble("wrote   ", (path, "green")))
    if not outcome["changed"]:
        console.print(Text("nothing to do, it was all there"))
    if outcome["service"] is None:
        console.print(Text(f"start it there with: {' '.join(outcome['command'])}"))
    else:
        console.print(Text(outcome["service"]))
    for note in (*outcome["notes"], *made.notes):
        console.print(Text(f"note: {note}", style="yellow"))
