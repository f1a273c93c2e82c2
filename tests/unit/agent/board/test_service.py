"""Calls of systemctl for the agent's service, at a systemd that the test plays."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from agent.board import install as installing
from agent.board import service, startup
from agent.board.install import InstallError, install_places
from agent.board.service import ServiceError, Systemd


class Commands:
    """Programs of the board: their calls, and the answers to them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[list[str]] = []
        self.environments: list[dict[str, str]] = []
        self.answers: dict[str, tuple[int, str, str]] = {}
        self.raises: Exception | None = None
        self.slept_s: list[float] = []
        monkeypatch.setattr(service.subprocess, "run", self._run)
        monkeypatch.setattr(service.time, "sleep", self.slept_s.append)
        monkeypatch.setattr(service.time, "time", lambda: 1000.75)

    def _run(self, words: list[str], **keys: Any) -> Any:
        if self.raises is not None:
            raise self.raises
        self.calls.append(words)
        self.environments.append(keys["env"])
        assert keys["timeout"] == 120
        key = next((word for word in words[1:] if word in self.answers), words[0])
        code, out, error = self.answers.get(key, (0, "", ""))
        return subprocess.CompletedProcess(words, code, out, error)

    @property
    def verbs(self) -> list[str]:
        return [next(word for word in words[1:] if not word.startswith("--")) for words in self.calls]


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> Commands:
    return Commands(monkeypatch)


def test_a_changed_service_is_loaded_enabled_and_restarted(commands: Commands) -> None:
    assert Systemd(system=True).apply(changed=True)
    assert commands.calls == [
        ["systemctl", "daemon-reload"],
        ["systemctl", "enable", "xitl-agent.service"],
        ["systemctl", "restart", "xitl-agent.service"],
    ]


@pytest.mark.parametrize(("code", "started", "verbs"), [(0, False, []), (3, True, ["restart"])])
def test_an_unchanged_service_is_started_if_it_does_not_run(
    commands: Commands, code: int, started: bool, verbs: list[str]
) -> None:
    commands.answers["is-active"] = (code, "", "")
    assert Systemd(system=True).apply(changed=False) is started
    assert commands.verbs == ["enable", "is-active", *verbs]


def test_a_service_of_a_user_is_one_of_the_user_s_systemd(commands: Commands, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(service.os, "getuid", lambda: 1234, raising=False)
    monkeypatch.setattr(service.Path, "is_dir", lambda path: str(path) == "/run/user/1234")
    commands.answers["status"] = (0, "  active (running)\n", "")
    assert Systemd(system=False).status() == "active (running)"
    assert commands.calls[0][:3] == ["systemctl", "--user", "status"]
    environment = commands.environments[0]
    assert environment["XDG_RUNTIME_DIR"] == "/run/user/1234"
    assert (environment["LC_ALL"], environment["SYSTEMD_COLORS"]) == ("C", "0")
    Systemd(system=True).status()
    assert "XDG_RUNTIME_DIR" not in commands.environments[1]


@pytest.mark.parametrize(
    ("system", "error", "sentence"),
    [
        (
            True,
            "System has not been booted (PID 1)",
            "systemctl enable: systemd does not run here for the system (System",
        ),
        (
            False,
            "Failed to connect to bus: No medium",
            "systemctl enable: systemd does not run here for this user (Fail",
        ),
        (
            True,
            "Host is down",
            "systemctl enable: systemd does not run here for the system (Host is down); start the ag",
        ),
        (
            True,
            "Unit is\n  masked",
            "systemctl enable: Unit is masked; for details, run on the board: journalctl -u xit",
        ),
        (False, "", "systemctl enable: exit code 5; for details, run on the board: journalctl --user -u xitl-agent.se"),
    ],
)
def test_a_refusal_of_systemd_is_explained(commands: Commands, system: bool, error: str, sentence: str) -> None:
    commands.answers["enable"] = (5, "", error)
    with pytest.raises(ServiceError) as refused:
        Systemd(system).apply(changed=False)
    assert str(refused.value).replace("  ", " ").startswith(sentence)
    assert commands.slept_s == []


def test_a_service_that_does_not_start_is_explained_by_its_last_error(commands: Commands) -> None:
    commands.answers["restart"] = (1, "", "Job failed")
    commands.answers["--since=@1000"] = (0, "started\nerror: old\nerror: no such port\nexited\n", "")
    with pytest.raises(ServiceError, match="the service does not start: no such port; for details, run on the board"):
        Systemd(system=True).apply(changed=True)
    assert commands.slept_s == [0.3]
    assert commands.calls[-1][:3] == ["journalctl", "-u", "xitl-agent.service"]


def test_a_journal_without_an_error_is_read_some_times(commands: Commands) -> None:
    commands.answers["restart"] = (1, "", "Job failed")
    commands.answers["journalctl"] = (0, "no error: here\n", "")
    with pytest.raises(ServiceError, match="systemctl restart: Job failed"):
        Systemd(system=True).apply(changed=True)
    assert commands.slept_s == [0.3] * 5


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (FileNotFoundError(), "this board has no systemctl; leave --service out"),
        (
            subprocess.TimeoutExpired("systemctl", 120),
            "systemctl enable did not end; run on the board: systemctl status",
        ),
    ],
)
def test_a_board_without_systemd(commands: Commands, error: Exception, sentence: str) -> None:
    commands.raises = error
    with pytest.raises(ServiceError, match=sentence):
        Systemd(system=True).apply(changed=False)


def test_a_user_that_lingers_gets_no_note(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("USER", "ada")
    monkeypatch.setattr(installing.Path, "exists", lambda path: str(path) == "/var/lib/systemd/linger/ada")
    assert installing._lingering_notes() == []
    monkeypatch.setenv("USER", "eve")
    assert "loginctl enable-linger" in installing._lingering_notes()[0]
    monkeypatch.delenv("USER")
    monkeypatch.setattr(installing.Path, "exists", lambda path: True)
    assert "loginctl enable-linger" in installing._lingering_notes()[0]


def test_an_archive_that_does_not_start_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    where = install_places(True, tmp_path, str(tmp_path))

    def hang(*arguments: Any, **keys: Any) -> None:
        raise subprocess.TimeoutExpired("python3", 60)

    monkeypatch.setattr(installing.subprocess, "run", hang)
    with pytest.raises(InstallError, match="the agent did not start on this board within"):
        installing._write(where.staged(where.programs / "agent.pyz"), b"data", 0o755, tried=True)
    assert list((tmp_path / "usr/local/bin").iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "module", "passed", "program"),
    [
        (["doctor", "--json"], "agent.board.doctor", ["--json"], "xitl-agent.pyz doctor"),
        (["install"], "agent.board.install", [], "xitl-agent.pyz install"),
        (["--link", "udp://:1"], "agent.__main__", ["--link", "udp://:1"], "xitl-agent.pyz"),
        ([], "agent.__main__", [], "xitl-agent.pyz"),
    ],
)
def test_the_first_argument_names_the_command(
    monkeypatch: pytest.MonkeyPatch, arguments: list[str], module: str, passed: list[str], program: str
) -> None:
    called: list[Any] = []

    class Module:
        def __init__(self, name: str) -> None:
            self.name = name

        def main(self, arguments: list[str], program: str) -> int:
            called.append((self.name, arguments, program))
            return 7

    monkeypatch.setattr(startup, "import_module", Module)
    assert startup.main(arguments, "xitl-agent.pyz") == 7
    assert called == [(module, passed, program)]


class Manager:
    """The socket to the service manager."""

    def __init__(self, sent: list[tuple[bytes, str]], fails: bool) -> None:
        self.sent, self.fails = sent, fails

    def __enter__(self) -> Manager:
        return self

    def __exit__(self, *error: object) -> None: ...

    def sendto(self, data: bytes, address: str) -> None:
        if self.fails:
            raise OSError("gone")
        self.sent.append((data, address))


@pytest.mark.parametrize(
    ("address", "expected"), [("/run/notify", "/run/notify"), ("@abstract", "\0abstract"), ("", None), (None, None)]
)
@pytest.mark.parametrize("fails", [False, True])
def test_the_service_manager_is_told_once_that_the_agent_is_ready(
    monkeypatch: pytest.MonkeyPatch, address: str | None, expected: str | None, fails: bool
) -> None:
    sent: list[tuple[bytes, str]] = []
    monkeypatch.setattr(startup.socket, "socket", lambda *kinds: Manager(sent, fails))
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    if address is not None:
        monkeypatch.setenv("NOTIFY_SOCKET", address)
    startup.notify_ready()
    assert sent == ([] if expected is None or fails else [(b"READY=1", expected)])
    assert "NOTIFY_SOCKET" not in startup.os.environ
    startup.notify_ready()
    assert len(sent) <= 1
