"""The emulated machine: its command line, start, the wait until the board is up, and stop."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from xitl_cli.errors import UserError
from xitl_cli.plugins.board import network, recipe
from xitl_cli.plugins.board.console import ConsoleFile
from xitl_cli.plugins.board.monitor import EmulatorMonitor
from xitl_cli.plugins.board.namespace import emulator_process
from xitl_cli.plugins.board.places import EmulatedBoard, the_board
from xitl_cli.plugins.board.tools import find_program, last_words

PROGRAM = "qemu-system-arm"
START_S, STOP_S = 180.0, 60.0
_LONGEST_SOCKET = 100  # slightly less than the system's limit for the path of a socket
_TRY_S = 0.5
_PANIC = "Kernel panic"
Progress = Callable[[str], None]


def machine_arguments(cores: int, memory_mib: int, kernel: Path, early: Path, kernel_arguments: str) -> list[str]:
    """Return the command of an ARMv7 machine that starts this kernel, without disk, network and console."""
    return [
        PROGRAM, "-machine", "virt,highmem=off", "-accel", "tcg,tb-size=256", "-cpu", "cortex-a15",
        "-smp", str(cores), "-m", str(memory_mib), "-kernel", str(kernel), "-initrd", str(early),
        "-append", kernel_arguments, "-display", "none", "-nodefaults",
    ]  # fmt: skip


def sockets(board: EmulatedBoard) -> tuple[Path, Path]:
    """Return the sockets of the monitor and of the console."""
    return board.folder / "monitor.sock", board.folder / "console.sock"


def board_arguments(board: EmulatedBoard, kernel: Path) -> list[str]:
    """Return the whole command that boots a board in the background, in the namespace of the caller."""
    monitor, console = sockets(board)
    return [
        *machine_arguments(
            board.cores, board.memory_mib, kernel, board.early, f"rw quiet console={recipe.CONSOLE_DEVICE}"
        ),
        "-drive", f"if=none,id=disk,format=qcow2,file={_escaped(board.disk)}",
        "-device", "virtio-blk-device,drive=disk",
        "-netdev", network.backend(board), "-device", "virtio-net-device,netdev=net,id=nic",
        "-device", "virtio-rng-device",
        "-chardev", f"socket,id=console,path={_escaped(console)},server=on,wait=off,logfile={_escaped(board.console)}",
        "-serial", "chardev:console",
        "-chardev", "pty,id=uart", "-device", "pci-serial,chardev=uart",
        "-qmp", f"unix:{_escaped(monitor)},server=on,wait=off",
        "-rtc", "base=utc",
        "-name", f"xitl-board-{board.name}", "-pidfile", str(board.pid_file), "-daemonize",
    ]  # fmt: skip


def _escaped(path: Path) -> str:
    return str(path).replace(",", ",,")


def running(board: EmulatedBoard) -> int | None:
    """Return the process of its emulator, None if it does not run."""
    return emulator_process(board.pid_file)


def the_process(board: EmulatedBoard) -> int:
    """Return the process as `running`. Raises UserError if it does not run."""
    pid = running(board)
    if pid is None:
        raise UserError(f"{board.name}: does not run; start it: xitl board start {board.name}")
    return pid


def the_running_board(name: str) -> EmulatedBoard:
    """Return a running board. Raises UserError if no board has this name, or it does not run."""
    board = the_board(name)
    the_process(board)
    return board


def the_reached_board(name: str, command: str) -> EmulatedBoard:
    """Return a running board with reachable ports. Raises UserError; command: suggested for use in the board's
    namespace.
    """
    board = the_board(name)
    if not network.is_reached(board, the_process(board)):
        raise UserError(f"{name}: is in a network namespace of its own; enter it: xitl board enter {name} {command}")
    return board


def boot(board: EmulatedBoard, kernel: Path) -> None:
    """Start its emulator in the background. Raises UserError, for example for a disk that cannot be opened."""
    monitor, console = sockets(board)
    if len(str(monitor)) > _LONGEST_SOCKET:
        raise UserError(
            f"{monitor}: too long for the path of a socket; set XITL_CACHE to a folder whose path is shorter"
        )
    board.console.write_bytes(b"")
    program, *arguments = board_arguments(board, kernel)
    done = subprocess.run(
        network.started_in(board, [find_program(program) or program, *arguments]),
        stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", check=False,
    )  # fmt: skip
    if done.returncode:
        raise UserError(f"{board.name}: the emulator does not start ({last_words(done.stderr)}); see {board.console}")
    for path in (monitor, console):
        path.chmod(0o600)
    board.serial.unlink(missing_ok=True)
    with EmulatorMonitor(monitor) as asked:
        for device in asked.do("query-chardev"):
            if device["label"] == "uart":
                board.serial.symlink_to(device["filename"].removeprefix("pty:"))


def wait_until_up(board: EmulatedBoard, limit_s: float, progress: Progress) -> float:
    """Wait until the board's ssh server accepts a login. Return the seconds it took.

    Raises UserError with the last lines of its console after the limit, or if the machine stops.
    """
    begun_s = time.monotonic()
    said = ConsoleFile(board.console)
    while (waited_s := time.monotonic() - begun_s) < limit_s:
        if running(board) is None:
            raise UserError(f"{board.name}: its emulator ended after {waited_s:.0f} s; {_console(board)}")
        if _PANIC in said.text():
            cut_power(board)
            raise UserError(f"{board.name}: its kernel gave up after {waited_s:.0f} s; {_console(board)}")
        progress(f"{waited_s:.0f} s  {said.last_line()}")
        if recipe.READY in said.text() and _lets_us_in(board):
            return time.monotonic() - begun_s
        time.sleep(_TRY_S)
    raise UserError(
        f"{board.name}: did not come up within {limit_s:.0f} s; {_console(board)}; give it longer with --timeout, or "
        f"look: xitl board console {board.name}"
    )


def _console(board: EmulatedBoard) -> str:
    return f"its console ended with: {last_words(ConsoleFile(board.console).text()) or 'nothing at all'}"


def _lets_us_in(board: EmulatedBoard) -> bool:
    return run_there(board, ["true"], START_S).returncode == 0


def run_there(board: EmulatedBoard, words: list[str], limit_s: float) -> subprocess.CompletedProcess[str]:
    """Run a command on the board, over ssh. Its exit code is 255 if ssh could not connect or it took too long."""
    command = ["ssh", "-F", str(board.ssh_config), "-o", "ConnectTimeout=10", board.name, *words]
    try:
        return subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace",
            timeout=limit_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 255, "", f"no answer within {limit_s:.0f} s")


def shut_down(board: EmulatedBoard, limit_s: float = STOP_S) -> bool:
    """Shut the board down. After the limit, cut its power and return False."""
    run_there(board, ["systemctl", "poweroff"], limit_s)
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        if running(board) is None:
            return True
        time.sleep(0.1)
    cut_power(board)
    return False


def cut_power(board: EmulatedBoard) -> None:
    """End its emulator at once. Data that the board had not written to its disk is lost."""
    pid = running(board)
    if pid is None:
        return
    os.kill(pid, signal.SIGKILL)
    while running(board) == pid:
        time.sleep(0.02)


@contextmanager
def stopped(board: EmulatedBoard) -> Iterator[None]:
    """Stop the board's processors and clocks inside the context."""
    with EmulatorMonitor(sockets(board)[0]) as monitor:
        monitor.do("stop")
        try:
            yield
        finally:
            monitor.do("cont")


@contextmanager
def unplugged(board: EmulatedBoard) -> Iterator[None]:
    """Unplug the board's network cable inside the context."""
    with EmulatorMonitor(sockets(board)[0]) as monitor:
        monitor.do("set_link", name="nic", up=False)
        try:
            yield
        finally:
            monitor.do("set_link", name="nic", up=True)
