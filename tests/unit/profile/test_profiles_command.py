"""`xitl profiles` as a user sees it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import typer

from tests.golden import Golden
from xitl_cli import shipped
from xitl_cli.commands import profiles
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.catalogue import shipped_profiles

Write = Callable[..., Path]


@pytest.fixture(autouse=True)
def _terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.medium
def test_the_list_names_every_profile_within_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    profiles.list_profiles()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].strip() == "runnable"
    assert set(shipped_profiles()) <= {line.split(" ")[0] for line in lines}
    assert max(map(len, lines)) <= 80


def test_what_is_shown_loads_again(capsys: pytest.CaptureFixture[str], write: Write) -> None:
    profiles.show("sitl", overrides=["clock.seed=7"])
    path = write(capsys.readouterr().out)
    assert load_profile(str(path)) == load_profile("sitl", ["clock.seed=7"])


def test_origins_are_shown_one_value_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    profiles.show("sitl", overrides=["clock.seed=7"], origins=True)
    lines = capsys.readouterr().out.splitlines()
    assert "clock.seed = 7  # --set clock.seed" in lines
    assert all("  # " in line for line in lines)


def test_check_lists_every_problem_and_goes_on(
    capsys: pytest.CaptureFixture[str], write: Write, golden: Golden
) -> None:
    path = write("clock: {sed: 1}\nrecording: {scene: 1}\n")
    with pytest.raises(typer.Exit) as caught:
        profiles.check([str(path), "nope", "sitl", "calm", "eq34-full-sitl"])
    assert caught.value.exit_code == 2
    golden("text", capsys.readouterr().out.splitlines())


@pytest.mark.medium
def test_without_names_all_shipped_profiles_are_checked(capsys: pytest.CaptureFixture[str]) -> None:
    profiles.check()
    assert len(capsys.readouterr().out.splitlines()) == len(shipped_profiles())


def test_an_incomplete_installation_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, golden: Golden) -> None:
    monkeypatch.setattr(shipped, "__file__", str(tmp_path / "xitl_cli" / "shipped.py"))
    with pytest.raises(UserError) as refused:
        shipped.profiles_dir()
    golden("error", refused.value)
    installed = tmp_path / "xitl_cli" / "shipped" / "profiles"
    installed.mkdir(parents=True)
    assert shipped.profiles_dir() == installed


@pytest.mark.parametrize("name", ["x" * 5000, "x" * 5000 + ".yaml", "\0.yaml"])
def test_names_that_no_file_can_have(name: str) -> None:
    with pytest.raises(UserError):
        load_profile(name)
