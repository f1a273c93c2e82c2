"""Entry points of the plug-in `board`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from xitl_cli.errors import UserError
from xitl_cli.plugin import Command

if TYPE_CHECKING:
    import typer

    from xitl_cli.deploy.ssh import Board


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.board import command

    app.callback()(refuse_windows)
    app.command("create")(command.create)
    app.command("start")(command.start)
    app.command("stop")(command.stop)
    app.command("list")(command.list_boards)
    for of_the_board in (command.ssh, command.enter):  # options after the name belong to the board's command
        app.command(of_the_board.__name__, context_settings={"allow_interspersed_args": False})(of_the_board)
    app.command("console")(command.console)
    app.command("put")(command.put)
    app.command("compare")(command.compare)
    app.command("pause")(command.pause)
    app.command("unplug")(command.unplug)
    app.command("remove")(command.remove)


COMMAND = Command("Make and run emulated ARMv7 boards with Debian.", _add, group=True)


def refuse_windows() -> None:
    """Raise UserError on Windows, which has neither the terminals nor the sockets that an emulated board uses."""
    if os.name == "nt":
        raise UserError("xitl board: an emulated board needs Linux; use WSL")


def running_board(name: str, port: int | None, identity: Path | None, ssh_config: Path | None) -> Board:
    """Return the running emulated board `name`, for access over ssh. Raises UserError if it does not run."""
    refuse_windows()
    from xitl_cli.deploy.ssh import Board
    from xitl_cli.plugins.board.emulator import the_running_board

    board = the_running_board(name)
    return Board(board.name, port, identity, ssh_config or board.ssh_config)
