"""Calls of systemctl, with a systemd that the test plays: when the unit is restarted, and what a failure says."""

from __future__ import annotations

import os
import subprocess
from types import SimpleNamespace
from typing import Any

import pytest

from agent.board import service
from agent.board.service import NAME, ServiceError, Systemd


class Manager:
    """Stands in for `subprocess.run`. ran: command lines. answers: exit code, output and error by first word."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **answers: Any) -> None:
        self.ran: list[list[str]] = []
        self.keys: list[dict[str, Any]] = []
        self.answers: dict[str, Any] = answers
        self.slept: list[float] = []
        monkeypatch.setattr(service.subprocess, "run", self._run)
        monkeypatch.setattr(service, "time", SimpleNamespace(time=lambda: 1234.9, sleep=self.slept.append))

    def _run(self, words: list[str], **keys: Any) -> Any:
        self.ran.append(words)
        self.keys.append(keys)
        name = next(word for word in words[1:] if word != "--user").replace("-", "_").strip("_")
        answer = self.answers.get("journal" if words[0] == "journalctl" else name, (0, "", ""))
        if isinstance(answer, list):
            answer = answer.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return subprocess.CompletedProcess(words, *answer)


def test_a_changed_unit_is_read_again_and_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    manager = Manager(monkeypatch)
    assert Systemd(True).apply(changed=True)
    assert manager.ran == [
        ["systemctl", "daemon-reload"],
        ["systemctl", "enable", NAME],
        ["systemctl", "restart", NAME],
    ]
    assert manager.keys[0]["env"]["LC_ALL"] == "C"
    assert manager.keys[0]["timeout"] == 120


def test_an_unchanged_unit_that_runs_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    manager = Manager(monkeypatch)
    assert not Systemd(True).apply(changed=False)
    assert [words[1] for words in manager.ran] == ["enable", "is-active"]


def test_an_unchanged_unit_that_does_not_run_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    manager = Manager(monkeypatch, is_active=(3, "", ""))
    assert Systemd(True).apply(changed=False)
    assert [words[1] for words in manager.ran] == ["enable", "is-active", "restart"]


def test_a_user_service_is_one_of_this_user(monkeypatch: pytest.MonkeyPatch) -> None:
    manager = Manager(monkeypatch, status=(3, " inactive \n", ""))
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(service.Path, "is_dir", lambda path: True)
    assert Systemd(False).status() == "inactive"
    assert manager.ran == [["systemctl", "--user", "status", "--no-pager", "--full", "--lines=5", NAME]]
    assert manager.keys[0]["env"]["XDG_RUNTIME_DIR"] == f"/run/user/{os.getuid()}"
    assert Systemd(True).active()
    assert "XDG_RUNTIME_DIR" not in manager.keys[1]["env"]


@pytest.mark.parametrize(("system", "owner"), [(True, "the system"), (False, "this user")])
@pytest.mark.parametrize("error", ["PID 1 is init", "Failed to connect to bus: No medium found", "Host is down"])
def test_a_board_without_systemd_is_told(monkeypatch: pytest.MonkeyPatch, system: bool, owner: str, error: str) -> None:
    Manager(monkeypatch, daemon_reload=(1, "", f"{error}\n"))
    with pytest.raises(ServiceError) as refused:
        Systemd(system).apply(changed=True)
    assert str(refused.value) == (
        f"systemctl daemon-reload: systemd does not run here for {owner} ({error}); start the agent by hand or with "
        "this board's service manager"
    )


def test_an_agent_that_does_not_start_is_told_with_its_last_error(monkeypatch: pytest.MonkeyPatch) -> None:
    journal = "started\nerror: first\nerror: no such port: 80 error: really\n"
    manager = Manager(monkeypatch, restart=(1, "", "Job failed"), journal=[(0, "", ""), (0, journal, "")])
    with pytest.raises(ServiceError) as refused:
        Systemd(False).apply(changed=True)
    assert str(refused.value) == (
        "the service does not start: no such port: 80 error: really; for details, run on the board: "
        f"journalctl --user -u {NAME}"
    )
    assert manager.ran[-1] == [
        *("journalctl", "--user", "-u", NAME, "-n5", "-ocat", "-q", "--no-pager", "--since=@1234")
    ]
    assert manager.slept == [0.3, 0.3]


def test_without_an_error_in_the_journal_systemds_own_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    manager = Manager(monkeypatch, restart=(1, "", "Job for it\n failed"))
    with pytest.raises(ServiceError) as refused:
        Systemd(True).apply(changed=True)
    assert str(refused.value) == (
        f"systemctl restart: Job for it failed; for details, run on the board: journalctl -u {NAME}"
    )
    assert len(manager.slept) == 5
    manager = Manager(monkeypatch, enable=(4, "", ""))
    with pytest.raises(ServiceError, match=r"^systemctl enable: exit code 4; for details"):
        Systemd(True).apply(changed=True)
    assert manager.slept == []


def test_a_board_without_systemctl_or_with_one_that_hangs_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    Manager(monkeypatch, enable=FileNotFoundError())
    with pytest.raises(ServiceError, match=r"^this board has no systemctl; leave --service out"):
        Systemd(True).apply(changed=False)
    Manager(monkeypatch, enable=subprocess.TimeoutExpired(["systemctl"], 1.0))
    with pytest.raises(
        ServiceError, match=f"^systemctl enable did not end; run on the board: systemctl status {NAME}$"
    ):
        Systemd(True).apply(changed=False)
