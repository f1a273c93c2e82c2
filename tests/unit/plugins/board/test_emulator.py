"""The emulated machine, with a monitor, consoles and processes that the test plays. No emulator runs here."""

from __future__ import annotations

import json
import os
import pty
import signal
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from xitl_cli.errors import UserError
from xitl_cli.plugins.board import emulator, namespace, recipe
from xitl_cli.plugins.board.emulator import ConsoleFile, EmulatorMonitor
from xitl_cli.plugins.board.places import EmulatedBoard, write_record


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> EmulatedBoard:
    monkeypatch.setenv("XITL_CACHE", str(tmp_path))
    made = EmulatedBoard("boat", "bookworm", recipe.recipe_version(), 2, 768, 14700)
    made.folder.mkdir(parents=True)
    write_record(made)
    return made


class Monitor:
    """The emulator's end of its monitor. asked: commands in order. answers: further lines before the result of each."""

    def __init__(self, path: Path) -> None:
        self.asked: list[dict[str, Any]] = []
        self.results: dict[str, Any] = {}
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection, connection.makefile("rwb") as file:
                file.write(b'{"QMP": {"version": {}}}\n')
                file.flush()
                for line in file:
                    words = json.loads(line)
                    self.asked.append(words)
                    result = self.results.get(words["execute"], {"return": {}})
                    if result is None:
                        break
                    file.write(b'{"event": "RESUME"}\n' + json.dumps(result).encode() + b"\n")
                    file.flush()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()


@pytest.fixture
def monitor(board: EmulatedBoard) -> Iterator[Monitor]:
    made = Monitor(emulator.sockets(board)[0])
    yield made
    made.close()


def test_the_monitor_is_asked_in_its_words_and_events_are_passed_over(board: EmulatedBoard, monitor: Monitor) -> None:
    monitor.results["query-status"] = {"return": {"running": True}}
    with EmulatorMonitor(emulator.sockets(board)[0]) as connection:
        assert connection.do("query-status") == {"running": True}
        connection.do("blockdev_add", node_name="disk", read_only=False)
    assert monitor.asked == [
        {"execute": "qmp_capabilities"},
        {"execute": "query-status"},
        {"execute": "blockdev_add", "arguments": {"node-name": "disk", "read-only": False}},
    ]


def test_a_refusal_of_the_monitor_is_told_with_its_reason(board: EmulatedBoard, monitor: Monitor) -> None:
    path = emulator.sockets(board)[0]
    monitor.results = {"stop": {"error": {"desc": "not now"}}, "cont": {"error": {}}, "quit": None}
    with EmulatorMonitor(path) as connection:
        with pytest.raises(UserError, match=f"^{path}: stop: not now$"):
            connection.do("stop")
        with pytest.raises(UserError, match=f"^{path}: cont: refused$"):
            connection.do("cont")
        with pytest.raises(UserError, match="the emulator does not answer any more; check that it runs"):
            connection.do("quit")


def test_a_monitor_that_is_not_there(board: EmulatedBoard) -> None:
    with pytest.raises(UserError, match=r"monitor.sock: no emulator answers \(No such file or directory\)"):
        EmulatorMonitor(emulator.sockets(board)[0])


def test_a_board_is_stopped_and_unplugged_for_a_while_also_after_an_error(
    board: EmulatedBoard, monitor: Monitor
) -> None:
    def fail(asked: dict[str, Any]) -> None:
        assert monitor.asked[-1] == asked
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), emulator.stopped(board):
        fail({"execute": "stop"})
    assert monitor.asked[-1] == {"execute": "cont"}
    with pytest.raises(ZeroDivisionError), emulator.unplugged(board):
        fail({"execute": "set_link", "arguments": {"name": "nic", "up": False}})
    assert monitor.asked[-1] == {"execute": "set_link", "arguments": {"name": "nic", "up": True}}


def test_the_text_of_a_console_has_no_control_sequences(tmp_path: Path) -> None:
    file = tmp_path / "console.log"
    console = ConsoleFile(file)
    assert (console.text(), console.last_line()) == ("", "")
    file.write_bytes(b"\x1b[2J\x1b[0;1mbooting\x1b[m\r\n  login: \x07\xff \r\n\x1b(B\n \n")
    assert console.text() == "booting\n  login: \ufffd \n\n \n"
    assert console.last_line() == "login: \ufffd"


def test_the_machine_has_the_size_disk_and_lines_of_the_board(board: EmulatedBoard) -> None:
    words = emulator.board_arguments(board, Path("/k/vmlinuz"))

    def of(option: str) -> list[str]:
        return [words[number + 1] for number, word in enumerate(words) if word == option]

    assert words[0] == "qemu-system-arm"
    assert (of("-smp"), of("-m"), of("-kernel")) == (["2"], ["768"], ["/k/vmlinuz"])
    assert of("-initrd") == [str(board.early)]
    assert of("-append") == ["rw quiet console=ttyAMA0"]
    assert of("-drive") == [f"if=none,id=disk,format=qcow2,file={board.disk}"]
    monitor, console = emulator.sockets(board)
    assert of("-qmp") == [f"unix:{monitor},server=on,wait=off"]
    assert of("-chardev") == [
        f"socket,id=console,path={console},server=on,wait=off,logfile={board.console}",
        "pty,id=uart",
    ]
    assert of("-pidfile") == [str(board.pid_file)]


def test_a_comma_in_a_path_is_doubled_as_the_emulator_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "a,b"))
    made = EmulatedBoard("boat", "bookworm", "1", 1, 512, 14700)
    words = emulator.board_arguments(made, Path("vmlinuz"))
    assert f"if=none,id=disk,format=qcow2,file={tmp_path}/a,,b/boards/boat/disk.qcow2" in words


class Programs:
    """Stands in for `subprocess.run`. ran: commands. sockets are there after the emulator started."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, returncode: int = 0, words: str = "") -> None:
        self.ran: list[list[str]] = []
        self.keys: list[dict[str, Any]] = []
        self._returncode, self._words = returncode, words
        run = SimpleNamespace(
            run=self._run,
            DEVNULL=subprocess.DEVNULL,
            TimeoutExpired=subprocess.TimeoutExpired,
            CompletedProcess=subprocess.CompletedProcess,
        )
        monkeypatch.setattr(emulator, "subprocess", run)

    def _run(self, words: list[str], **keys: Any) -> Any:
        self.ran.append(words)
        self.keys.append(keys)
        return subprocess.CompletedProcess(words, self._returncode, "", self._words)


def test_a_boot_makes_private_sockets_and_a_link_to_the_serial_line(
    board: EmulatedBoard, monitor: Monitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs = Programs(monkeypatch)
    paths = emulator.sockets(board)
    paths[1].write_bytes(b"")
    board.console.write_bytes(b"of the boot before")
    board.serial.symlink_to("/dev/pts/1")
    monkeypatch.setattr(emulator, "find_program", lambda name: None)
    monitor.results["query-chardev"] = {
        "return": [{"label": "console", "filename": "pty:/dev/pts/8"}, {"label": "uart", "filename": "pty:/dev/pts/9"}]
    }
    emulator.boot(board, Path("vmlinuz"))
    assert programs.ran == [emulator.board_arguments(board, Path("vmlinuz"))]
    assert board.console.read_bytes() == b""
    assert [stat.S_IMODE(path.stat().st_mode) for path in paths] == [0o600, 0o600]
    assert board.serial.readlink() == Path("/dev/pts/9")


def test_an_emulator_that_does_not_start_is_told_with_its_last_words(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    Programs(monkeypatch, 1, "qemu: no disk\n")
    with pytest.raises(UserError, match=f"boat: the emulator does not start \\(qemu: no disk\\); see {board.console}"):
        emulator.boot(board, Path("vmlinuz"))


def test_a_command_on_the_board_goes_over_its_ssh_and_has_a_limit(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs = Programs(monkeypatch)
    assert emulator.run_there(board, ["uname", "-r"], 7.0).returncode == 0
    assert programs.ran == [["ssh", "-F", str(board.ssh_config), "-o", "ConnectTimeout=10", "boat", "uname", "-r"]]
    assert programs.keys[0]["timeout"] == 7.0

    def expire(words: list[str], **keys: Any) -> Any:
        raise subprocess.TimeoutExpired(words, 7.0)

    monkeypatch.setattr(programs, "_run", expire)
    monkeypatch.setattr(emulator.subprocess, "run", expire)
    done = emulator.run_there(board, ["uname"], 7.4)
    assert (done.returncode, done.stderr) == (255, "no answer within 7 s")


class Clock:
    """Time that passes with each sleep. slept: seconds of each."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s, self.slept = 100.0, list[float]()
        monkeypatch.setattr(emulator, "time", SimpleNamespace(monotonic=lambda: self.now_s, sleep=self._sleep))

    def _sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now_s += seconds


def test_a_board_is_up_when_its_console_says_so_and_ssh_answers(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock(monkeypatch)
    consoles = iter(["", "starting\n", f"{recipe.READY}\n", f"{recipe.READY}\n"])
    monkeypatch.setattr(emulator, "running", lambda board: board.console.write_text(next(consoles)) + 1)
    codes = iter([255, 0])
    asked: list[list[str]] = []

    def answer(board: EmulatedBoard, words: list[str], limit_s: float) -> Any:
        asked.append(words)
        return SimpleNamespace(returncode=next(codes))

    monkeypatch.setattr(emulator, "run_there", answer)
    told: list[str] = []
    assert emulator.wait_until_up(board, 60.0, told.append) == 1.5
    assert clock.slept == [0.5, 0.5, 0.5]
    assert asked == [["true"], ["true"]]
    assert told == ["0 s  ", "0 s  starting", f"1 s  {recipe.READY}", f"2 s  {recipe.READY}"]


def test_a_panic_cuts_the_power(board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    Clock(monkeypatch)
    board.console.write_text("Kernel panic - not syncing: no init\n")
    cut: list[EmulatedBoard] = []
    monkeypatch.setattr(emulator, "running", lambda board: 7)
    monkeypatch.setattr(emulator, "cut_power", cut.append)
    with pytest.raises(UserError, match="boat: its kernel panicked after 0 s; its console ended with: Kernel panic"):
        emulator.wait_until_up(board, 60.0, lambda doing: None)
    assert cut == [board]


@pytest.mark.parametrize(("ends_after", "alone"), [(3, True), (10_000, False)])
def test_a_board_that_does_not_shut_down_loses_its_power(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, ends_after: int, alone: bool
) -> None:
    clock = Clock(monkeypatch)
    asked: list[list[str]] = []
    cut: list[EmulatedBoard] = []
    monkeypatch.setattr(emulator, "run_there", lambda board, words, limit_s: asked.append(words))
    monkeypatch.setattr(emulator, "running", lambda board: 7 if len(clock.slept) < ends_after else None)
    monkeypatch.setattr(emulator, "cut_power", cut.append)
    assert emulator.shut_down(board) is alone
    assert asked == [["systemctl", "poweroff"]]
    assert cut == ([] if alone else [board])
    assert clock.now_s - 100.0 == pytest.approx(0.3 if alone else 60.0, abs=0.11)


def emulator_double(board: EmulatedBoard) -> subprocess.Popen[bytes]:
    """A process with the board's file among its arguments, as the emulator has it."""
    ran = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)", str(board.pid_file)])
    board.pid_file.write_text(f"{ran.pid}\n")
    return ran


@pytest.mark.medium
def test_the_process_of_a_board_is_known_by_its_file_and_ended_at_once(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert emulator.running(board) is None
    emulator.cut_power(board)
    with emulator_double(board) as ran:
        try:
            command = Path(f"/proc/{ran.pid}/cmdline")
            while str(board.pid_file).encode() not in command.read_bytes():
                pass  # between fork and exec
            assert emulator.running(board) == ran.pid
            assert emulator.the_process(board) == ran.pid
            assert emulator.the_running_board("boat") == board
            kill = os.kill
            monkeypatch.setattr(os, "kill", lambda pid, number: (kill(pid, number), ran.wait()))
            emulator.cut_power(board)
            assert ran.returncode == -signal.SIGKILL
        finally:
            ran.kill()
    assert emulator.running(board) is None
    with pytest.raises(UserError, match="boat: does not run; start it: xitl board start boat"):
        emulator.the_process(board)


def test_a_process_with_the_number_of_an_earlier_emulator_is_another(board: EmulatedBoard) -> None:
    board.pid_file.write_text(str(os.getpid()))
    assert emulator.running(board) is None
    board.pid_file.write_text("no number")
    assert emulator.running(board) is None


def test_the_console_is_attached_until_it_is_left(board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    path = emulator.sockets(board)[1]
    board.console.write_bytes(b"." + 1999 * b"x" + b"end")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        near, far = pty.openpty()  # a terminal, which is raw meanwhile
        shown_end, shown = os.pipe()
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: far))
        monkeypatch.setattr(sys, "stdout", SimpleNamespace(fileno=lambda: shown))
        before = emulator.termios.tcgetattr(far)
        attached = threading.Thread(target=emulator.attach, args=(path, board.console))
        attached.start()
        peer, _ = listener.accept()
        with peer:
            peer.sendall(b"login: ")
            text = b""
            while not text.endswith(b"login: "):
                text += os.read(shown_end, 4096)
            assert text == 1997 * b"x" + b"endlogin: "
            os.write(near, b"root\r")
            assert peer.recv(100) == b"root\r"
            os.write(near, b"\x1d")
            attached.join()
            assert peer.recv(100) == b""
        assert emulator.termios.tcgetattr(far) == before
        for end in (near, far, shown_end, shown):
            os.close(end)
    with pytest.raises(UserError, match=r"the console does not answer \(Connection refused\); close it elsewhere"):
        emulator.attach(path, board.console)


def test_the_console_of_an_emulator_that_ends_is_left(board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    path = emulator.sockets(board)[1]
    board.console.write_bytes(b"")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        source, typed = os.pipe()
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: source))
        with open(os.devnull, "wb") as sink:  # noqa: PTH123 - a descriptor
            monkeypatch.setattr(sys, "stdout", sink)
            attached = threading.Thread(target=emulator.attach, args=(path, board.console))
            attached.start()
            peer, _ = listener.accept()
            peer.close()
            attached.join()
        os.close(source)
        os.close(typed)


# -- its namespace


def test_ssh_gets_a_connection_in_the_network_of_the_emulator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(namespace, "emulator_process", lambda pid_file: os.getpid())
    server = socket.create_server(("127.0.0.1", 0))
    ours, theirs = socket.socketpair()
    kept = os.dup(1)
    try:
        os.dup2(theirs.fileno(), 1)
        namespace.main(str(tmp_path), "127.0.0.1", str(server.getsockname()[1]))
    finally:
        os.dup2(kept, 1)
        os.close(kept)
    accepted, _ = server.accept()
    message, (number,), _, _ = socket.recv_fds(ours, 10, 4)
    with accepted, server, ours, theirs, socket.socket(fileno=number) as passed:
        assert message == b"\0"
        assert passed.gettimeout() is None
        passed.sendall(b"ssh")
        assert accepted.recv(10) == b"ssh"


def test_ssh_enters_the_network_of_an_emulator_in_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    became: list[list[str]] = []

    class LeftError(Exception):
        """The process is another program now."""

    def become(program: str, words: list[str]) -> None:
        became.append(words)
        raise LeftError

    monkeypatch.setattr(namespace, "emulator_process", lambda pid_file: 7)
    monkeypatch.setattr(namespace, "_is_same", lambda kind, pid: kind == "user")
    monkeypatch.setattr(os, "execvp", become)
    given = ("board.pid", "192.168.7.2", "22")
    with pytest.raises(LeftError):
        namespace.main(*given)
    own = [sys.executable, "-IS", namespace.__file__, *given]
    assert became == [["nsenter", "--target", "7", "--net", "--", *own]]
    monkeypatch.setattr(namespace, "_is_same", lambda kind, pid: False)
    assert namespace.entered(7, ["true"]) == [
        *("nsenter", "--target", "7", "--user", "--preserve-credentials", "--net", "--", "true")
    ]


def test_ssh_to_a_board_that_does_not_run_says_so(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=f"{tmp_path}: the emulator does not run"):
        namespace.main(str(tmp_path), "192.168.7.2", "22")


def test_this_process_shares_its_network_with_itself_alone() -> None:
    assert namespace.shares_network(os.getpid())
    with pytest.raises(FileNotFoundError):
        namespace.shares_network(2**30)
