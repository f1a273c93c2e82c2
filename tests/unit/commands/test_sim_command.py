"""`xitl sim`: which profile, which duration, which exit code. A run without an autopilot takes no time."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.command_line import xitl
from tests.golden import Golden


def sim(*arguments: str) -> int:
    return xitl("sim", *arguments)


@pytest.fixture(autouse=True)
def somewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.medium
@pytest.mark.parametrize("named", [("mitl",), ("--profile", "mitl"), ("-p", "mitl")])
def test_the_profile_is_named_by_its_place_or_by_option(named: tuple[str, ...], tmp_path: Path) -> None:
    assert sim(*named, "--duration", "0.1", "--out", "run") == 0
    assert json.loads((tmp_path / "run/summary.json").read_text())["profile"] == "mitl"


def test_two_profiles_are_one_too_many(capsys: pytest.CaptureFixture[str], golden: Golden) -> None:
    assert sim("mitl", "--profile", "sitl") == 2
    golden("stderr", capsys.readouterr().err)


@pytest.mark.medium
def test_a_duration_that_was_asked_for_is_success_and_the_limit_of_a_profile_is_not(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert sim("mitl", "--duration", "0.1", "--out", "asked") == 0
    assert "ended: duration reached" in capsys.readouterr().out
    assert sim("mitl", "--set", "clock.duration_s=0.1", "--out", "limit") == 1
    assert "not completed: duration reached" in capsys.readouterr().out


@pytest.mark.medium
def test_what_is_in_a_path_is_printed_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert sim("mitl", "--duration", "0.1", "--out", "a:x:[x]") == 0
    assert "a:x:[x]/: run.mcap" in capsys.readouterr().out
    assert sim("b:x:[x].yaml") == 2
    assert "b:x:[x].yaml does not exist" in capsys.readouterr().err


@pytest.mark.medium
def test_tables_are_printed_with_verbose(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, shown in (((), False), (("--verbose",), True)):
        assert sim("mitl", "--duration", "0.1", "--overwrite", "--out", "run", *arguments) == 0
        assert ("late p99" in capsys.readouterr().out) is shown


@pytest.mark.medium
@pytest.mark.parametrize("spelling", ["--out", "--output"])
def test_an_option_is_understood_by_its_other_spelling(spelling: str, tmp_path: Path) -> None:
    assert sim("mitl", "--duration", "0.1", spelling, "run") == 0
    assert sim("mitl", "--duration", "0.1", spelling, "run", "--force") == 0
    assert (tmp_path / "run/summary.json").exists()
