"""`xitl doctor`: what it checks, prints and refuses, with checks and measurements that are made for the test."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import pytest

from agent.board import doctor, latency
from agent.board.doctor import OK, PROBLEM, WARNING, DoctorFinding, findings_to_objects
from tests.command_line import xitl
from tests.golden import Golden
from xitl_cli import readiness
from xitl_cli.deploy import package, ssh
from xitl_cli.deploy.package import Package
from xitl_cli.deploy.ssh import Board

FINE = DoctorFinding("packages", OK, "all that a run needs")
SLOW = DoctorFinding("kernel", WARNING, "6.1, not PREEMPT_RT", "install one")
BROKEN = DoctorFinding("link", PROBLEM, "udp://x cannot be opened", "free the port")
REPORT = {"loops": [], "links": [{"url": "its own"}]}
HELD = "it holds them"


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the arguments of the checks of this machine. They find nothing wrong but the kernel."""
    asked: list[Any] = []

    def examine(*arguments: Any) -> list[DoctorFinding]:
        asked.append(arguments)
        return [SLOW]

    monkeypatch.setattr(readiness, "examine_simulating", lambda: [FINE])
    monkeypatch.setattr(doctor, "examine", examine)
    return asked


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return board, arguments and time limit of each call over ssh. Its first entry is the answer."""
    called: list[Any] = [{"findings": findings_to_objects([SLOW])}]

    def run_there(
        there: Board, sent: Package, arguments: list[str], stdin: bytes, longest_s: float = ssh.LONGEST_S
    ) -> Any:
        assert (sent, stdin) == ("the archive", b"")
        called.append((there, arguments, longest_s))
        return called[0]

    monkeypatch.setattr(ssh, "run_there", run_there)
    monkeypatch.setattr(package, "build", lambda: "the archive")
    return called


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the plans that were measured on this machine."""
    plans: list[Any] = []

    def measure(plan: Any, tell: Any) -> dict[str, Any]:
        plans.append(plan)
        return {**REPORT, "machine": "this"}

    monkeypatch.setattr(latency, "measure", measure)
    monkeypatch.setattr(latency, "measure_link", lambda url, duration_s: {"url": url, "s": duration_s})
    monkeypatch.setattr(latency, "holds_all", lambda report: report.get("holds", True))
    monkeypatch.setattr(latency, "report_text", lambda report: HELD)
    return plans


def xitl_doctor(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = xitl("doctor", *arguments)
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_this_machine_is_checked_for_both_purposes(
    machine: list[Any], capsys: pytest.CaptureFixture[str], golden: Golden
) -> None:
    code, out, _ = xitl_doctor(capsys, "--link", "udp://127.0.0.1:9")
    assert machine == [("udp://127.0.0.1:9", (3, 11))]
    assert code == 0
    golden("stdout", out)


def test_a_problem_is_exit_code_1_and_json_has_both_parts(
    machine: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(readiness, "examine_simulating", lambda: [FINE, BROKEN])
    code, out, _ = xitl_doctor(capsys, "--json")
    assert code == 1
    assert json.loads(out) == findings_to_objects([FINE, BROKEN, SLOW])
    code, out, _ = xitl_doctor(capsys)
    assert code == 1
    assert "problem: udp://x cannot be opened\n" in out
    assert "→ free the port\n" in out


@pytest.mark.parametrize("named", [("debian@b",), ("debian@b", "--link", "udp://:9", "--port", "2222")])
def test_a_board_is_checked_over_ssh_alone(
    named: Sequence[str], board: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = xitl_doctor(capsys, *named)
    assert code == 0
    ((there, arguments, _),) = board[1:]
    assert there == Board("debian@b", 2222 if "--port" in named else None)
    assert arguments == ["doctor", "--for-host", *(["--link=udp://:9"] if "--link" in named else [])]
    assert "Simulating" not in out
    assert "warning: 6.1, not PREEMPT_RT" in out


@pytest.mark.parametrize("answer", [{}, {"findings": [{"check": "a", "level": "worse", "found": "b"}]}])
def test_an_answer_that_is_none_is_refused(answer: Any, board: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    board[0] = answer
    code, _, err = xitl_doctor(capsys, "debian@b")
    assert code == 2
    assert "debian@b: the answer of the board is not findings of a doctor; try again" in err


@pytest.mark.medium
def test_latency_takes_the_rates_of_the_profile(measured: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert xitl_doctor(capsys, "--latency") == (0, f"{HELD}\n", "")
    assert xitl_doctor(capsys, "--latency", "--profile", "mitl", "--load", "--duration", "3")[0] == 0
    first, second = measured
    assert (first.rates_hz, first.duration_s, first.loaded, first.agent_url) == ((400.0, 50.0), 10.0, False, "")
    assert (second.duration_s, second.loaded) == (3.0, True)


def test_latency_of_given_rates_and_one_that_is_not_held(
    measured: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(latency, "holds_all", lambda report: False)
    code, out, _ = xitl_doctor(capsys, "--latency", "--rate", "100", "--rate", "50", "--rate", "100", "--json")
    assert code == 1
    assert json.loads(out) == {**REPORT, "machine": "this"}
    assert measured[0].rates_hz == (100.0, 50.0)


def test_latency_of_a_board_with_the_link_measured_from_here(
    measured: list[Any], board: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    board[0] = {"latency": {"links": [{"url": "its own"}]}}
    words = ("debian@b", "--latency", "--rate", "100", "--duration", "2", "--load", "--agent", "udp://c:1", "--json")
    code, out, _ = xitl_doctor(capsys, *words)
    assert code == 0
    ((_, arguments, longest_s),) = board[1:]
    assert arguments == ["doctor", "--for-host", "--latency", "--duration=2.0", "--rate=100.0", "--load"]
    plan = latency.LatencyPlan((100.0,), 2.0, True, "udp://c:1")
    assert longest_s == ssh.LONGEST_S + 2.0 * plan.total_s
    assert json.loads(out) == {"links": [{"url": "its own"}, {"url": "udp://c:1", "s": 2.0}]}
    assert measured == []
    board[0] = {"latency": []}
    code, _, err = xitl_doctor(capsys, *words)
    assert code == 2
    assert "debian@b: the answer of the board is no report of a latency; try again" in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("debian@b", "--board", "bbb"), "--board bbb: debian@b is a board too; give one of them"),
        (("--latency", "--link", "udp://x:1"), "--link: --latency opens no link of an agent"),
        (("--profile", "sitl"), "--profile is an option of the latency measurement; add --latency"),
        (("--rate", "10"), "--rate is an option of the latency measurement"),
        (("--duration", "10"), "--duration is an option of the latency measurement"),
        (("--load",), "--load is an option of the latency measurement"),
        (("--agent", "udp://x:1"), "--agent is an option of the latency measurement"),
        (("--latency", "--rate", "10", "--profile", "sitl"), "--rate: the profile sitl already sets the rates"),
        (("--latency", "--rate", "0"), "rate"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    words: Sequence[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = xitl_doctor(capsys, *words)
    assert code == 2
    assert said in err
