"""`xitl agent package` and `deploy`: what they print and send, with an archive and a board made for the test."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from agent.board.install import DeploySettings, settings_to_json
from tests.command_line import xitl
from xitl_cli import registry
from xitl_cli.commands.agent import reached
from xitl_cli.deploy import package, ssh
from xitl_cli.deploy.package import Package
from xitl_cli.deploy.ssh import Board
from xitl_cli.errors import UserError

MADE = Package(b"x" * 3000, "abc123", ("xitl agent 1", "wrapt 2"), ("can:// links need Python >=3.10",))


@pytest.fixture(autouse=True)
def archive(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(package, "build", lambda: MADE)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return what was sent to boards. Its first entry is the outcome there."""
    outcome: dict[str, Any] = {"machine": "armv7l", "python": "3.11.2", "changed": [], "service": None, "notes": []}
    sent: list[Any] = [{**outcome, "command": ["python3", "xitl-agent.pyz"]}]

    def run_there(there: Board, made: Package, arguments: list[str], stdin: bytes) -> Any:
        assert made is MADE
        sent.append((there, arguments, stdin))
        return sent[0]

    monkeypatch.setattr(ssh, "run_there", run_there)
    return sent


def xitl_agent(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = xitl("agent", *arguments)
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_a_package_is_written_and_can_be_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = xitl_agent(capsys, "package")
    assert code == 0
    assert (tmp_path / "xitl-agent.pyz").read_bytes() == MADE.data
    assert (tmp_path / "xitl-agent.pyz").stat().st_mode & 0o777 == 0o755
    assert out.splitlines() == [
        "xitl-agent.pyz  3 KiB",
        "sha256  abc123",
        "parts   xitl agent 1, wrapt 2",
        "note: can:// links need Python >=3.10",
    ]


def test_a_file_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = xitl_agent(capsys, "package", "--out", "none/a.pyz")
    assert code == 2
    assert "none/a.pyz cannot be written (No such file or directory); choose another file with --out" in err


def test_a_board_that_has_all(board: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = xitl_agent(capsys, "deploy", "debian@b")
    assert code == 0
    assert board[1:] == [(Board("debian@b"), ["install"], settings_to_json(DeploySettings(False, None, {})))]
    assert out.splitlines() == [
        "debian@b  armv7l, Python 3.11.2",
        "sha256  abc123, verified on the board",
        "nothing to do, all files are up to date",
        "start the agent on the board: python3 xitl-agent.pyz",
        "note: can:// links need Python >=3.10",
    ]


def test_a_service_with_options_and_files(board: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a.parm", "link.key", "sign.key", "id"):
        (tmp_path / name).write_text(f"of {name}")
    board[0].update(changed=["/opt/a", "/etc/b"], service="the service runs", notes=["a note"])
    words = ["--service", "--link", "udp://:9", "--role", "companion", "--gcs", "udp://c:1", "--gcs", "udp://d:2"]
    words += ["--realtime", "50", "--cpu", "0,1", "--parameters", "a.parm", "--link-key", "link.key"]
    words += ["--signing-key", "sign.key", "--port", "2222", "--identity", "id"]
    code, out, _ = xitl_agent(capsys, "deploy", "debian@b", *words)
    assert code == 0
    ((there, arguments, stdin),) = board[1:]
    assert (there, arguments) == (Board("debian@b", 2222, Path("id")), ["install"])
    options = {"link": ("udp://:9",), "role": ("companion",), "cpu": ("0,1",), "realtime": ("50",)}
    files = {"parameters": "of a.parm", "link-key": "of link.key", "signing-key": "of sign.key"}
    wanted = DeploySettings(True, {**options, "gcs": ("udp://c:1", "udp://d:2")}, files)
    assert json.loads(stdin) == json.loads(settings_to_json(wanted))
    assert out.splitlines()[2:] == [
        "wrote   /opt/a",
        "wrote   /etc/b",
        "the service runs",
        "note: a note",
        "note: can:// links need Python >=3.10",
    ]


def test_a_plugin_resolves_its_kind_of_board(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def load(group: str, kind: str) -> Any:
        asked.append((group, kind))
        return lambda *board: board

    monkeypatch.setattr(registry, "names", lambda group: ["lab"])
    monkeypatch.setattr(registry, "load", load)
    assert reached("lab:3", 22, None, None) == ("3", 22, None, None)
    assert reached("board:arm", None, Path("id"), None) == ("arm", None, Path("id"), None)  # also when none has it
    assert asked == [(registry.BOARDS, "lab"), (registry.BOARDS, "board")]
    assert reached("fe80:1", None, None, None) == Board("fe80:1")
    assert reached("lab", None, None, None) == Board("lab")
    with pytest.raises(UserError, match="is no address of a board"):
        reached("-lab:3", None, None, None)
