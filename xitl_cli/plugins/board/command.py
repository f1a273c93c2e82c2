"""`xitl board …`: an emulated ARMv7 board on this machine."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.options import Json, Overwrite, RunsDuration, RunsSeed

if TYPE_CHECKING:
    from xitl_cli.plugins.board.places import EmulatedBoard

Name = Annotated[str, typer.Argument(metavar="NAME", help="Name of the board.")]
Seconds = Annotated[float, typer.Option("--for", metavar="S", min=0.0, max=3600.0, help="Duration in seconds.")]
Port = Annotated[
    int | None, typer.Option(min=1024, max=65525, help="First of its ten ports on 127.0.0.1 (default: the first free).")
]
Command = Annotated[list[str] | None, typer.Argument(metavar="[COMMAND]...", help="Command to run.")]


def create(
    name: Name,
    suite: Annotated[str, typer.Option(help="bookworm (Debian 12, Python 3.11) or bullseye (11, 3.9).")] = "bookworm",
    cores: Annotated[int, typer.Option(min=1, max=4, help="Processors of the board.")] = 1,
    memory: Annotated[int, typer.Option(metavar="MIB", min=256, max=2048, help="Memory of the board.")] = 512,
    port: Port = None,
    mirror: Annotated[
        str | None, typer.Option(metavar="URL", help="Debian mirror (default: the mirror of apt on this machine).")
    ] = None,
) -> None:
    """Make an emulated ARMv7 board from Debian's packages. It needs no root, and keeps completed steps."""
    from xitl_cli.plugins.board.life import create as make

    with _telling() as tell:
        board = make(name, suite, cores, memory, port, mirror, tell)
    _say(f"{board.name}: Debian {board.suite} for ARMv7, {board.cores} × Cortex-A15, {board.memory_mib} MiB")
    _say(f"start it with: xitl board start {board.name}")


def start(
    name: Name,
    port: Port = None,
    network: Annotated[
        str | None,
        typer.Option(
            metavar="forwarded|namespace",
            help="Ports of 127.0.0.1, or a separate network namespace with 192.168.7.2 (default: as last time).",
        ),
    ] = None,
    timeout: Annotated[float, typer.Option(metavar="S", min=5, help="Time limit of the boot.")] = 180.0,
) -> None:
    """Boot a board, wait until it accepts ssh, and print its address and the commands that use it."""
    from xitl_cli.plugins.board.life import start as begin

    with _telling() as tell:
        board, took_s = begin(name, port, network, timeout, tell)
    _say(f"{name}: {'runs already' if took_s is None else f'up after {took_s:.0f} s'}")
    for label, command in _commands(board):
        _say(f"  {label:<11}{command}")


def stop(
    name: Name,
    cut: Annotated[bool, typer.Option("--cut", help="Cut its power; data that is not on its disk is lost.")] = False,
) -> None:
    """Shut a board down."""
    from xitl_cli.plugins.board.emulator import cut_power, running, shut_down
    from xitl_cli.plugins.board.places import the_board

    board = the_board(name)
    if running(board) is None:
        _say(f"{name}: does not run")
    elif cut:
        cut_power(board)
        _say(f"{name}: power cut")
    elif shut_down(board):
        _say(f"{name}: shut down")
    else:
        _say(f"{name}: did not shut down by itself, so its power was cut")


def put(
    name: Name,
    program: Annotated[Path, typer.Argument(metavar="ARDUROVER", help="ArduPilot Rover, built for armhf Linux.")],
    parameters: Annotated[
        str, typer.Option(metavar="FILE|PROFILE", help="Initial parameters.")
    ] = "hitl-ardupilot-linux",
) -> None:
    """Copy an ArduPilot to a board, with a unit that starts it. The agent is its bridge."""
    from xitl_cli.plugins.board.autopilot import UNIT, put_autopilot
    from xitl_cli.plugins.board.emulator import the_running_board

    put_autopilot(the_running_board(name), program, parameters)
    _say(f"{name}: {UNIT} starts now and at each boot, and waits for the agent")
    _say(f"  bridge     xitl agent deploy board:{name} --service --config agent.conf (docs/virtual-board.md)")


def pause(name: Name, seconds: Seconds = 2.0) -> None:
    """Stop the emulated machine with its clocks for some time, then continue. A run records the effect."""
    from xitl_cli.plugins.board.emulator import stopped, the_running_board

    with stopped(the_running_board(name)):
        time.sleep(seconds)
    _say(f"{name}: was stopped for {seconds:g} s")


def unplug(name: Name, seconds: Seconds = 2.0) -> None:
    """Unplug a board's network cable for some time, then plug it in again."""
    from xitl_cli.plugins.board.emulator import the_running_board, unplugged

    with unplugged(the_running_board(name)):
        time.sleep(seconds)
    _say(f"{name}: had no network for {seconds:g} s")


def compare(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Running emulated board with a deployed agent.")
    ] = None,
    board: Annotated[str | None, typer.Option(metavar="URL", help="Agent on a real board, as a further run.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of runs and page.")] = Path("runs/four-ways"),
    seed: RunsSeed = 1,
    duration: RunsDuration = None,
    overwrite: Overwrite = False,
) -> None:
    """Run one mission in process, as a loopback, on an emulated and on a real board, and compare all on one page.

    Exit code: 0 all completed the mission; 1 one did not.
    """
    from xitl_cli.commands.terminal import show_rows, terminal
    from xitl_cli.experiment.setup import ExperimentSetup
    from xitl_cli.extras import REPORT
    from xitl_cli.logs.report.html import refuse_other
    from xitl_cli.plugins.board.four_ways import PAGE, sail, table, ways, write_page

    REPORT.require("the page needs")
    refuse_other(out / PAGE)
    chosen = list(ways(name, board))
    sailed = sail(ExperimentSetup(out, seed, duration, overwrite, tell=_say), chosen)
    write_page(sailed, out / PAGE)
    columns = tuple(range(len(sailed) + 1))
    show_rows(terminal(), ("", *(way.title for way in sailed)), table(sailed), text=columns)
    _say(str(out / PAGE))
    if not all(((way.summary or {}).get("mission") or {}).get("completed") for way in sailed):
        raise typer.Exit(1)


def remove(
    name: Name,
    images: Annotated[bool, typer.Option("--images", help="Also remove the images that no other board uses.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Cut the power of a running board.")] = False,
) -> None:
    """Remove a stopped board with its disk and keys; its image stays for other boards."""
    from xitl_cli.plugins.board.life import remove as remove_board

    for path in remove_board(name, images, force):
        _say(f"removed {path}")


def list_boards(as_json: Json = False) -> None:
    """List all boards with their state."""
    from xitl_cli.commands.terminal import show_rows, terminal
    from xitl_cli.plugins.board.emulator import running
    from xitl_cli.plugins.board.places import FORWARDED, board_names, the_board

    boards = [the_board(name) for name in board_names()]
    if as_json:
        rows = [
            {
                "name": board.name,
                "suite": board.suite,
                "cores": board.cores,
                "memory_mib": board.memory_mib,
                "running": running(board) is not None,
                "network": board.network,
                "ssh": f"{board.address}:{board.ssh_port}",
                "autopilot": f"{board.address}:{board.autopilot_port}",
                "companion": f"{board.address}:{board.companion_port}",
                "mavlink": f"{board.address}:{board.mavlink_port}",
                "serial": str(board.serial),
                "folder": str(board.folder),
            }
            for board in boards
        ]
        typer.echo(json.dumps({"boards": rows}, indent=2))
        return
    if not boards:
        _say("no board yet; make one: xitl board create virtual")
        return
    table = []
    for board in boards:
        state = "runs" if running(board) is not None else "off"
        network = f"{board.address}, {board.network}"
        if board.network == FORWARDED:
            network = f"{board.address}:{board.port}–{board.mavlink_port}"
        try:
            used = sum(path.stat().st_blocks * 512 for path in board.folder.iterdir() if path.is_file()) >> 20
        except OSError:
            used = 0
        memory = f"{board.memory_mib} MiB"
        table.append([board.name, state, board.suite, str(board.cores), memory, network, f"{used} MiB"])
    columns = ("board", "", "suite", "cores", "memory", "network", "on disk")
    show_rows(terminal(), columns, table, text=(0, 1, 2, 5))


def ssh(name: Name, command: Command = None) -> None:
    """Log in to a board as root, or run a command there."""
    from xitl_cli.plugins.board.emulator import the_running_board
    from xitl_cli.plugins.board.tools import FOR_RUNNING, require

    board = the_running_board(name)
    require(FOR_RUNNING)
    _become(["ssh", "-F", str(board.ssh_config), board.name, *_words(command)])


def enter(name: Name, command: Command = None) -> None:
    """Run a command of this machine, or a shell, in the network namespace of a board. Exit code: of the command."""
    from xitl_cli.errors import UserError
    from xitl_cli.plugins.board.emulator import the_process
    from xitl_cli.plugins.board.network import entering
    from xitl_cli.plugins.board.places import the_board

    board = the_board(name)
    words = _words(command) or [os.environ.get("SHELL", "/bin/sh")]
    entered = entering(board, the_process(board), words)
    if shutil.which(words[0]) is None:
        raise UserError(f"{words[0]}: this machine has no such command; check its name, or use its path")
    if not command:
        _say(f"in the network of {name}, with the address {board.address}; leave with exit")
    _become(entered)


def _words(command: list[str] | None) -> list[str]:
    """Return the command without a leading `--`."""
    words = command or []
    return words[1:] if words[:1] == ["--"] else words


def _become(words: list[str]) -> None:
    sys.stdout.flush()
    os.execvp(words[0], words)


def console(name: Name) -> None:
    """Attach to the board's console, which shows the messages of its boot. Leave with Ctrl-]."""
    from xitl_cli.plugins.board.emulator import attach, sockets, the_running_board

    board = the_running_board(name)
    _say(f"console of {name}; leave with Ctrl-]")
    attach(sockets(board)[1], board.console)


def _commands(board: EmulatedBoard) -> Iterator[tuple[str, str]]:
    from xitl_cli.plugins.board.places import FIRST_PORT, NAMESPACE
    from xitl_cli.plugins.board.recipe import BOARD_ADDRESS, BOARD_PORTS, HOST_ADDRESS, INTERFACE

    name = board.name
    if board.network == NAMESPACE:
        address = f"{BOARD_ADDRESS} in a separate network namespace, with {HOST_ADDRESS} for this machine"
        sail = f"xitl board enter {name} xitl sim --profile hitl-beaglebone"
    else:
        address = f"{board.address}, ssh port {board.ssh_port}; {BOARD_ADDRESS} in its own network"
        link = f" --set autopilot.link=udp://{board.address}:{board.autopilot_port}"
        sail = f"xitl sim --profile hitl-virtual-board{'' if board.port == FIRST_PORT else link}"
    yield "address", address
    yield "log in", f"xitl board ssh {name}"
    yield "deploy", f"xitl agent deploy board:{name} --service --link udp://{INTERFACE}:{BOARD_PORTS[0]}"
    yield "sail", sail
    yield "check", f"xitl doctor board:{name}"
    yield "serial", f"serial://{board.serial}?baud=921600 here, serial:///dev/ttyS0?baud=921600 there"
    yield "stop", f"xitl board stop {name}"


@contextmanager
def _telling() -> Iterator[Callable[[str], None]]:
    """Return a function that shows progress: one changing line at a terminal, otherwise a line for each new text."""
    from xitl_cli.commands.terminal import progress, terminal

    if terminal(stderr=True).is_terminal:
        with progress("…") as shown:
            yield shown
        return
    last = ""

    def tell(text: str) -> None:
        nonlocal last
        kind = "".join(letter for letter in text if not letter.isdigit())
        if kind != last and not kind.startswith(" s"):
            typer.echo(text, err=True)
            last = kind

    yield tell


def _say(text: str) -> None:
    from xitl_cli.commands.terminal import terminal

    terminal(soft_wrap=True).print(text)
