"""What the doctor says of a machine that simulates."""

from __future__ import annotations

import json
import socket
import sys
from pathlib import Path

import pytest

from agent.board.doctor import OK, PROBLEM, WARNING, DoctorFinding
from sim_core.tape.library import NoKernelError
from tests.golden import Golden
from xitl_cli import extras, readiness
from xitl_cli.extras import EXTRAS, PERCEPTION
from xitl_cli.main import main
from xitl_cli.readiness import (
    check_extras,
    check_firmware,
    check_physics,
    check_ports,
    check_pseudo_terminals,
    verdict,
    without_optional,
)

ROOT = Path(__file__).parents[2]


def test_every_extra_is_one_of_the_package() -> None:
    text = (ROOT / "pyproject.toml").read_text()
    for extra in EXTRAS:
        assert f"\n{extra.name} = [" in text, extra.name


def test_a_missing_extra_is_no_trouble_and_comes_with_its_pip_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    found = list(check_extras())
    assert [finding.level for finding in found] == [OK] * len(EXTRAS)
    assert found[0].advice == PERCEPTION.pip_line == "pip install 'xitl[perception]'"
    assert verdict("simulating", found) == (OK, "simulating: ready")
    assert without_optional(found).startswith(", without perception, ")


def test_physics_without_a_compiler_is_no_trouble_and_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_kernel() -> None:
        raise NoKernelError("no C compiler (cc, gcc, clang); install gcc or clang")

    monkeypatch.setattr("sim_core.tape.library.load_kernel", no_kernel)
    finding = check_physics()
    assert (finding.level, finding.advice) == (OK, "install gcc or clang")
    assert finding.found == "in numpy, which needs more processor time (no C compiler (cc, gcc, clang))"
    monkeypatch.setattr("sim_core.tape.library.load_kernel", lambda: None)
    assert check_physics().found == "compiled"


def test_firmware_is_found_where_a_run_would_find_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, golden: Golden
) -> None:
    for name in ("XITL_ARDUROVER", "XITL_PX4"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XITL_CACHE", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    golden("text", next(iter(check_firmware())).advice)
    assert len(without_optional(list(check_firmware())).split(",")) == 3
    program = tmp_path / "ardurover"
    program.write_bytes(Path(sys.executable).resolve().read_bytes()[:4096])
    program.chmod(0o755)
    assert next(iter(check_firmware())).found == str(program)
    mine = program.rename(tmp_path / "mine")
    monkeypatch.setenv("XITL_ARDUROVER", str(mine))
    assert next(iter(check_firmware())).found == f"{mine} (from XITL_ARDUROVER)"


@pytest.mark.parametrize(("number", "variable"), [(0, "XITL_ARDUROVER"), (1, "XITL_PX4")])
def test_a_variable_that_names_no_program_is_a_warning(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: int, variable: str
) -> None:
    monkeypatch.setenv(variable, str(tmp_path / "none"))
    finding = list(check_firmware())[number]
    assert finding.level == WARNING
    assert finding.found.startswith(f"{variable}: {tmp_path / 'none'} does not exist")
    assert finding.advice == f"correct {variable}, or unset it"


def test_a_port_that_is_taken_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        held.listen()
        monkeypatch.setattr(readiness, "USUAL", ("udp://127.0.0.1:14550", held.getsockname()[1]))
        taken = next(iter(check_ports()))
    assert (taken.level, "is taken" in taken.found) == (WARNING, True)
    assert next(iter(check_ports())).level == OK


def test_pseudo_terminals_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    assert check_pseudo_terminals().level == OK

    def none() -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(readiness.os, "openpty", none)
    assert "No space left on device" in check_pseudo_terminals().found


def test_the_verdict_names_what_stands_in_the_way() -> None:
    findings = [DoctorFinding("kernel", WARNING, ""), DoctorFinding("Python", PROBLEM, "")]
    assert verdict("x", findings) == (PROBLEM, "x: will not work (Python)")
    assert verdict("x", findings[:1]) == (WARNING, "x: will work with limits (kernel)")


@pytest.mark.parametrize("width", ["80", "40"])
def test_the_command_ends_with_a_verdict_for_each_use(
    width: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", width)
    monkeypatch.setattr(sys, "argv", ["xitl", "doctor", "--link", "udp://127.0.0.1:0"])
    with pytest.raises(SystemExit):
        main()
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= int(width)
    said = " ".join(" ".join(lines).split())
    assert "simulating on this machine: " in said
    assert "agent and hardware in the loop: " in said


def test_as_json_all_findings_are_one_list(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["xitl", "doctor", "--json", "--link", "udp://127.0.0.1:0"])
    with pytest.raises(SystemExit):
        main()
    checks = {finding["check"] for finding in json.loads(capsys.readouterr().out)}
    assert {"packages", "ArduRover", "PX4", "pseudo-terminals", "kernel", "link"} <= checks
