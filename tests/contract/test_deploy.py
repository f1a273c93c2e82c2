"""`xitl agent deploy` and `xitl doctor` through a real ssh server; systemctl is a double that keeps a record."""

from __future__ import annotations

import configparser
import json
import os
import shlex
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pythons import python
from ssh_server import SshServer

from agent.board.install import install_places

pytestmark = pytest.mark.slow

SYSTEMCTL = """\
#!/bin/sh
echo "$@" >> "$RECORD/calls"
[ "$1" = --user ] && shift
case $1 in
    is-active) test -e "$RECORD/active" ;;
    restart) if [ -e "$RECORD/broken" ]; then echo "Job for xitl-agent.service failed" >&2; exit 1; fi
        : > "$RECORD/active" ;;
    daemon-reload) if [ -e "$RECORD/no-systemd" ]; then
        echo "System has not been booted with systemd as init system (PID 1). Can't operate." >&2; exit 1; fi ;;
    status) echo "xitl-agent.service - active (running)" ;;
esac
"""
JOURNALCTL = """\
#!/bin/sh
echo "error: udp://usb0:14660: no such interface"
"""


class BoardDouble:
    """What `user@127.0.0.1` finds: files below `root`, programs in `programs`, the record of systemctl in `record`."""

    def __init__(self, directory: Path) -> None:
        self.root, self.record, self.programs, self.home = (
            directory / name for name in ("board", "record", "programs", "home")
        )
        for path in (self.root, self.record, self.programs, self.home):
            path.mkdir()
        for name, program in (("systemctl", SYSTEMCTL), ("journalctl", JOURNALCTL)):
            (self.programs / name).write_text(program)
            (self.programs / name).chmod(0o755)
        environment = {"DESTDIR": self.root, "RECORD": self.record, "TMPDIR": self.record, "HOME": self.home}
        path = f"{self.programs}:/usr/bin:/bin"
        self.server = SshServer(directory / "ssh", {"PATH": path, **{key: str(it) for key, it in environment.items()}})
        where = install_places(os.geteuid() == 0, self.home, str(self.root))
        self.settings, self.state = where.settings, where.state
        self.archive = where.staged(where.programs) / "xitl-agent.pyz"
        self.configuration = where.staged(where.settings) / "agent.conf"
        self.unit = where.staged(where.units) / "xitl-agent.service"

    @property
    def calls(self) -> list[str]:
        path = self.record / "calls"
        words = path.read_text().splitlines() if path.exists() else []
        return [call.removeprefix("--user ") for call in words]

    def python(self, program: str | None) -> None:
        """What `python3` is over there; none for no such program."""
        path = self.programs / "python3"
        if program is None:
            path.write_text("#!/bin/sh\nexec python3-that-is-not-there\n")
            path.chmod(0o755)
        else:
            path.symlink_to(program)

    def xitl(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        words = [sys.executable, "-m", "xitl_cli.main", *arguments]
        where = [
            f"{self.server.user}@127.0.0.1",
            "--port",
            str(self.server.port),
            "--ssh-config",
            str(self.server.config),
        ]
        environment = {**os.environ, "NO_COLOR": "1", "COLUMNS": "80"}
        return subprocess.run(
            [*words, *where], capture_output=True, text=True, timeout=120, check=False, env=environment
        )

    def deploy(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return self.xitl("agent", "deploy", *arguments)


@pytest.fixture
def board(tmp_path: Path) -> Iterator[BoardDouble]:
    double = BoardDouble(tmp_path)
    try:
        yield double
    finally:
        double.server.close()


def refused(result: subprocess.CompletedProcess[str], *words: str) -> None:
    assert result.returncode == 2, (result.stdout, result.stderr)
    assert len(result.stderr.strip().splitlines()) == 1, result.stderr
    for word in ("error: ", *words):
        assert word in result.stderr, (word, result.stderr)


def test_a_service_is_installed_started_and_left_alone_the_second_time(board: BoardDouble) -> None:
    first = board.deploy("--service", "--link", "udp://127.0.0.1:14670", "--role", "fcu")
    assert first.returncode == 0, first.stderr
    assert board.calls == [
        "daemon-reload",
        "enable xitl-agent.service",
        "restart xitl-agent.service",
        "status --no-pager --full --lines=5 xitl-agent.service",
    ]
    assert "xitl-agent.service - active (running)" in first.stdout
    assert stat.S_IMODE(board.archive.stat().st_mode) == 0o755
    before = {path: path.stat().st_mtime_ns for path in board.root.rglob("*")}

    second = board.deploy("--service", "--link", "udp://127.0.0.1:14670", "--role", "fcu")
    assert second.returncode == 0, second.stderr
    assert "nothing to do" in second.stdout
    assert {path: path.stat().st_mtime_ns for path in board.root.rglob("*")} == before
    assert "restart xitl-agent.service" not in board.calls[4:]
    assert "daemon-reload" not in board.calls[4:]


def test_what_was_installed_starts_as_the_unit_says(board: BoardDouble) -> None:
    assert board.deploy("--service", "--link", "udp://127.0.0.1:0").returncode == 0
    line = next(line for line in board.unit.read_text().splitlines() if line.startswith("ExecStart="))
    python, archive, option, configuration = shlex.split(line.removeprefix("ExecStart="))
    assert (str(board.root) + archive, option) == (str(board.archive), "--config")
    assert str(board.root) + configuration == str(board.configuration)
    agent = subprocess.Popen(
        [python, str(board.archive), "--config", str(board.configuration)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert agent.stdout is not None
        assert "waits at udp://127.0.0.1:" in agent.stdout.readline()
    finally:
        agent.terminate()
        agent.communicate()


def test_the_unit_is_one_that_systemd_reads(board: BoardDouble) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze (apt install systemd)")
    assert board.deploy("--service").returncode == 0
    words = ["systemd-analyze", "verify", "--man=no", *(["--user"] if os.geteuid() else []), str(board.unit)]
    verified = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (verified.returncode, verified.stderr) == (0, "")


def test_no_leftovers_and_nothing_started_without_service(board: BoardDouble) -> None:
    result = board.deploy()
    assert result.returncode == 0, result.stderr
    assert "start the agent on the board: " in result.stdout
    assert board.calls == []
    assert [path.name for path in board.root.rglob("*") if path.is_file()] == ["xitl-agent.pyz"]
    assert list(board.record.iterdir()) == []


def test_files_come_along_and_keys_are_for_their_owner_alone(board: BoardDouble, tmp_path: Path) -> None:
    key, parameters, config = tmp_path / "a key", tmp_path / "p.parm", tmp_path / "own.conf"
    key.write_text("ab" * 32)
    parameters.write_text("CRUISE_SPEED 1.5\n")
    config.write_text("[agent]\nlog-dir = logs\nlink = udp://127.0.0.1:1\n")
    result = board.deploy(
        "--link-key", str(key), "--parameters", str(parameters), "--config", str(config), "--link", "udp://127.0.0.1:2"
    )
    assert result.returncode == 0, result.stderr
    written = configparser.ConfigParser(interpolation=None)
    written.read(board.configuration)
    place = board.settings
    assert dict(written["agent"]) == {
        "link": "udp://127.0.0.1:2",
        "link-key": f"{place}/link.key",
        "log-dir": str(board.state / "logs"),
        "parameters": f"{place}/agent.parm",
    }
    brought = board.configuration.parent / "link.key"
    assert brought.read_text() == key.read_text()
    assert stat.S_IMODE(brought.stat().st_mode) == 0o600
    assert key.read_text() not in result.stdout + result.stderr


def test_no_shell_ever_reads_what_was_typed(board: BoardDouble, tmp_path: Path) -> None:
    config = tmp_path / "own.conf"
    config.write_text("[agent]\nlog-dir = '; touch pwned; '\nmachine = `touch pwned`\ncontroller = %n $x \\\n")
    result = board.deploy(
        "--link", "$(touch pwned)", "--role", '"; touch pwned #', "--config", str(config), "--service"
    )
    assert result.returncode == 0, result.stderr
    written = configparser.ConfigParser(interpolation=None)
    written.read(board.configuration)
    assert dict(written["agent"]) == {
        "controller": "%n $x \\",
        "link": "$(touch pwned)",
        "log-dir": f"{board.state}/'; touch pwned; '",
        "machine": "`touch pwned`",
        "role": '"; touch pwned #',
    }
    assert "pwned" not in board.unit.read_text()
    assert not any((place / "pwned").exists() for place in (board.home, board.root, board.record, Path.cwd()))


@pytest.mark.parametrize(
    "destination", ["-oProxyCommand=touch pwned", "a b@c", "a@b;c", "u@$(id)", "u@h\nx", "ssh://h", ""]
)
def test_what_is_no_destination_never_reaches_ssh(destination: str, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "xitl_cli.main", "agent", "deploy", "--", destination]
    environment = {**os.environ, "PATH": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    refused(
        subprocess.run(words, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment), "user@host"
    )


def test_a_service_that_does_not_start_says_why(board: BoardDouble) -> None:
    (board.record / "broken").touch()
    refused(board.deploy("--service"), "udp://usb0:14660: no such interface", "journalctl")


def test_a_board_without_systemd(board: BoardDouble) -> None:
    (board.record / "no-systemd").touch()
    refused(board.deploy("--service"), "systemd does not run here", "start the agent by hand")


def test_a_board_without_python(board: BoardDouble) -> None:
    board.python(None)
    refused(board.deploy(), "python3 is not installed on the board", "apt install python3")


@pytest.mark.parametrize("version", ["3.6", "3.7", "3.8"])
def test_a_board_with_an_old_python(board: BoardDouble, version: str) -> None:
    board.python(python(version))
    refused(board.deploy(), f"python3 on the board is {version}", "3.9 or newer")


def test_a_board_with_the_oldest_python_that_will_do(board: BoardDouble) -> None:
    board.python(python("3.9"))
    result = board.deploy("--service")
    assert result.returncode == 0, result.stderr
    assert "Python 3.9." in result.stdout


def test_an_unknown_host_key(board: BoardDouble) -> None:
    board.server.forget_host_key()
    refused(board.deploy(), "host key", "log in once with ssh")


def test_a_user_who_is_not_let_in(board: BoardDouble) -> None:
    board.server.forget_user_key()
    refused(board.deploy(), "it refused the login", "--identity")


def test_nobody_listens(board: BoardDouble) -> None:
    board.server.close()
    refused(board.deploy(), "without an ssh server", "--port")


def test_a_place_that_cannot_be_written(board: BoardDouble) -> None:
    place = board.archive.parent
    place.parent.mkdir(parents=True)
    place.write_text("a file where a directory belongs")
    refused(board.deploy(), "cannot be written", "xitl-agent.pyz")


def test_doctor_looks_at_the_board(board: BoardDouble) -> None:
    result = board.xitl("doctor", "--json", "--link", "udp://127.0.0.1:0")
    findings = {finding["check"]: finding for finding in json.loads(result.stdout)}
    assert findings["link"]["found"] == "udp://127.0.0.1:0 can be opened"
    assert {"kernel", "real time", "memory lock", "Python", "clock", "disk"} <= set(findings)
    levels = {finding["level"] for finding in findings.values()}
    assert result.returncode == (1 if "problem" in levels else 0)
    assert list(board.record.iterdir()) == []


def test_doctor_measures_the_latency_of_the_board(board: BoardDouble) -> None:
    words = ("--latency", "--rate", "50", "--duration", "0.1", "--json")
    result = board.xitl("doctor", *words)
    report = json.loads(result.stdout)
    assert result.returncode == (0 if all(rate["holds"] for rate in report["rates"]) else 1)
    here = [sys.executable, "-m", "xitl_cli.main", "doctor", *words]
    own = json.loads(subprocess.run(here, capture_output=True, text=True, check=False).stdout)
    assert shape(report) == shape(own)
    assert list(board.record.iterdir()) == []


def shape(report: Any) -> Any:
    """Keys and kinds of values: figures differ from run to run."""
    if isinstance(report, dict):
        return {key: shape(value) for key, value in report.items()}
    if isinstance(report, list):
        return [shape(report[0])] if report else []
    return type(report).__name__


def test_doctor_refuses_what_the_board_cannot_measure(board: BoardDouble) -> None:
    refused(board.xitl("doctor", "--latency", "--agent", "nowhere://x", "--duration", "0.1"), "nowhere")


def test_doctor_fails_on_a_problem(board: BoardDouble) -> None:
    result = board.xitl("doctor", "--link", "udp://192.0.2.1:14660")
    assert result.returncode == 1
    assert "192.0.2.1" in result.stdout
    assert "problem" in result.stdout
