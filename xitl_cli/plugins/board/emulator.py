"""The emulated machine: command line, start, the wait until the board is up, monitor, console and stop.

The monitor, QMP, exchanges one JSON object per line over a private socket of this user.
"""

from __future__ import annotations

import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.plugins.board import network, recipe
from xitl_cli.plugins.board.namespace import emulator_process
from xitl_cli.plugins.board.places import EmulatedBoard, the_board
from xitl_cli.plugins.board.tools import find_program, last_words

PROGRAM = "qemu-system-arm"
START_S, STOP_S = 180.0, 60.0
_LONGEST_SOCKET = 100  # slightly less than the system's limit for the path of a socket
_TRY_S = 0.5
_PANIC = "Kernel panic"
Progress = Callable[[str], None]


MONITOR_TIMEOUT_S = 10.0


class EmulatorMonitor:
    """A connection to the monitor of a running emulator. Raises UserError if it does not answer."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(MONITOR_TIMEOUT_S)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise UserError(f"{path}: no emulator answers ({error.strerror}); start the board") from None
        self._file = self._socket.makefile("rwb")
        self._read()
        self.do("qmp_capabilities")

    def do(self, command: str, **arguments: Any) -> Any:
        """Run a command of the monitor and return its result."""
        words: dict[str, Any] = {"execute": command}
        if arguments:
            words["arguments"] = {name.replace("_", "-"): value for name, value in arguments.items()}
        self._file.write(json.dumps(words).encode() + b"\n")
        self._file.flush()
        while True:
            answer = self._read()
            if "error" in answer:
                raise UserError(f"{self._path}: {command}: {answer['error'].get('desc', 'refused')}")
            if "return" in answer:
                return answer["return"]

    def _read(self) -> dict[str, Any]:
        try:
            line = self._file.readline()
            answer = json.loads(line)
        except (OSError, ValueError):
            raise UserError(f"{self._path}: the emulator does not answer any more; check that it runs") from None
        return dict(answer)

    def close(self) -> None:
        """Close the connection. The emulator continues unchanged."""
        self._file.close()
        self._socket.close()

    def __enter__(self) -> EmulatorMonitor:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b[()][A-Z0-9]|\x1b[=>78]|[\x00-\x08\x0b-\x1f]")


class ConsoleFile:
    """The file to which the emulator writes its console."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def text(self) -> str:
        """Return all output without cursor control sequences; empty if there is none."""
        try:
            return _CONTROL.sub("", self._path.read_bytes().decode("utf-8", "replace").replace("\r\n", "\n"))
        except OSError:
            return ""

    def last_line(self) -> str:
        """Return the last line that is not empty."""
        lines = [line.strip() for line in self.text().splitlines() if line.strip()]
        return lines[-1] if lines else ""


LEAVE = b"\x1d"  # Ctrl-]


def attach(path: Path, log: Path) -> None:
    """Attach this terminal to the console until Ctrl-], the end of the input or of the emulator. Raises UserError."""
    connection = socket.socket(socket.AF_UNIX)
    try:
        connection.connect(str(path))
    except OSError as error:
        connection.close()
        raise UserError(f"{path}: the console does not answer ({error.strerror}); close it elsewhere") from None
    source, sink = sys.stdin.fileno(), sys.stdout.fileno()
    os.write(sink, log.read_bytes()[-2000:])
    settings = termios.tcgetattr(source) if os.isatty(source) else None
    try:
        if settings is not None:
            tty.setraw(source)
        with connection:
            while True:
                for ready in select.select([connection, source], [], [])[0]:
                    data = connection.recv(4096) if ready is connection else os.read(source, 4096)
                    if not data or (ready is source and LEAVE in data):
                        return
                    if ready is connection:
                        os.write(sink, data)
                    else:
                        connection.sendall(data)
    finally:
        if settings is not None:
            termios.tcsetattr(source, termios.TCSADRAIN, settings)


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
        raise UserError(f"{name}: is in a separate network namespace; enter it: xitl board enter {name} {command}")
    return board


def boot(board: EmulatedBoard, kernel: Path) -> None:
    """Start its emulator in the background. Raises UserError, for example for a disk that cannot be opened."""
    monitor, console = sockets(board)
    if len(str(monitor)) > _LONGEST_SOCKET:
        raise UserError(
            f"{monitor}: is too long for the path of a socket; set XITL_CACHE to a folder with a shorter path"
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
    with EmulatorMonitor(monitor) as connection:
        for device in connection.do("query-chardev"):
            if device["label"] == "uart":
                board.serial.symlink_to(device["filename"].removeprefix("pty:"))


def wait_until_up(board: EmulatedBoard, limit_s: float, progress: Progress) -> float:
    """Wait until the board's ssh server accepts a login. Return the seconds it took.

    Raises UserError with the last lines of its console after the limit, or if the machine stops.
    """
    begun_s = time.monotonic()
    console = ConsoleFile(board.console)
    while (waited_s := time.monotonic() - begun_s) < limit_s:
        if running(board) is None:
            raise UserError(f"{board.name}: its emulator ended after {waited_s:.0f} s; {_console(board)}")
        if _PANIC in console.text():
            cut_power(board)
            raise UserError(f"{board.name}: its kernel panicked after {waited_s:.0f} s; {_console(board)}")
        progress(f"{waited_s:.0f} s  {console.last_line()}")
        if recipe.READY in console.text() and run_there(board, ["true"], START_S).returncode == 0:
            return time.monotonic() - begun_s
        time.sleep(_TRY_S)
    raise UserError(
        f"{board.name}: did not boot within {limit_s:.0f} s; {_console(board)}; raise --timeout, or see: xitl board "
        f"console {board.name}"
    )


def _console(board: EmulatedBoard) -> str:
    return f"its console ended with: {last_words(ConsoleFile(board.console).text()) or 'nothing'}"


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


def shut_down(board: EmulatedBoard) -> bool:
    """Shut the board down. After STOP_S, cut its power and return False."""
    run_there(board, ["systemctl", "poweroff"], STOP_S)
    end_s = time.monotonic() + STOP_S
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
