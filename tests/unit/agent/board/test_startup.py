"""The start of the agent's archive: which program runs, and the notice to the service manager."""

from __future__ import annotations

import socket
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from agent.board import startup


@pytest.mark.parametrize(
    ("arguments", "module", "given", "program"),
    [
        (["doctor", "--json"], "agent.board.doctor", ["--json"], "agent doctor"),
        (["install"], "agent.board.install", [], "agent install"),
        (["--link", "udp://x"], "agent.__main__", ["--link", "udp://x"], "agent"),
        ([], "agent.__main__", [], "agent"),
        (["doctors"], "agent.__main__", ["doctors"], "agent"),
    ],
)
def test_the_first_argument_names_the_program(
    monkeypatch: pytest.MonkeyPatch, arguments: list[str], module: str, given: list[str], program: str
) -> None:
    ran: list[tuple[list[str], str]] = []

    def main(arguments: list[str], program: str) -> int:
        ran.append((arguments, program))
        return 7

    monkeypatch.setitem(sys.modules, module, SimpleNamespace(main=main))  # type: ignore[arg-type]
    assert startup.main(arguments, "agent") == 7
    assert ran == [(given, program)]


@pytest.mark.parametrize("abstract", [False, True])
def test_the_service_manager_is_notified_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, abstract: bool) -> None:
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + path if abstract else path)
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", f"@{path}" if abstract else path)
        startup.notify_ready()
        assert manager.recv(100) == b"READY=1"
        startup.notify_ready()  # a process that it starts does not notify again
        with pytest.raises(BlockingIOError):
            manager.recv(100)


def test_without_a_service_manager_nothing_is_notified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    startup.notify_ready()
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "none"))
    startup.notify_ready()  # the manager is gone
