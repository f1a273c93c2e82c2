"""What commands share that print a lot: readers that leave, refusals, damage, vessels and pages."""

from __future__ import annotations

import errno
import io
import os
import sys
import webbrowser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from xitl_cli.commands import output
from xitl_cli.errors import UserError
from xitl_cli.logs.model.log import LogHealth
from xitl_cli.logs.model.sections import Fact, Finding, Section


@pytest.fixture
def discarded(monkeypatch: pytest.MonkeyPatch) -> list[None]:
    """Return an entry for each time that the output is discarded."""
    calls: list[None] = []
    monkeypatch.setattr(output, "discard_output", lambda: calls.append(None))
    return calls


def test_a_pipe_that_is_closed_ends_the_command_well(discarded: list[None]) -> None:
    with pytest.raises(SystemExit) as ended, output.quiet_pipe():
        raise BrokenPipeError
    assert ended.value.code == 0
    assert len(discarded) == 1
    with pytest.raises(ValueError, match="another"), output.quiet_pipe():
        raise ValueError("another")
    with output.quiet_pipe():
        pass
    assert len(discarded) == 1


@pytest.mark.parametrize("code", [errno.EPIPE, errno.EIO])
def test_a_reader_or_terminal_that_is_gone_is_ignored(code: int, discarded: list[None]) -> None:
    with output.still_read():
        raise OSError(code, "gone")
    assert len(discarded) == 1


def test_another_error_of_the_output_is_told(discarded: list[None]) -> None:
    with pytest.raises(OSError, match="full"), output.still_read():
        raise OSError(errno.ENOSPC, "full")
    assert discarded == []


def test_discarded_output_goes_nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (tmp_path / "out").open("w") as file:
        monkeypatch.setattr(sys, "stdout", file)
        print("before", flush=True)
        output.discard_output()
        print("after", flush=True)
    assert (tmp_path / "out").read_text() == "before\n"


def test_every_refusal_is_printed_and_the_last_one_raised(capsys: pytest.CaptureFixture[str]) -> None:
    output.refuse(())
    with pytest.raises(UserError, match=r"^c$"):
        output.refuse(["a\x1b", "b", "c"])
    lines = capsys.readouterr().err.splitlines()
    assert lines[1:] == ["error: b"]
    assert lines[0].startswith("error: a")
    assert "\x1b" not in lines[0]


def test_only_degraded_logs_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    sound = SimpleNamespace(path=Path("a.bin"), health=LogHealth(0, 10))
    damaged = SimpleNamespace(path=Path("b.bin"), health=LogHealth(0, 10, truncated_bytes=7))
    output.tell_damage(sound, damaged)  # type: ignore[arg-type]
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("b.bin: degraded: ")
    assert "7 bytes" in line


def test_vessels_of_a_recording_are_named_up_to_eight(capsys: pytest.CaptureFixture[str]) -> None:
    one = ("one.mcap", "", ("a", "b"))
    eight = tuple("abcdefgh")
    output.tell_vessels((Path(one[0]), one[1], one[2]), (Path("f"), "b", eight), (Path("g"), "a", (*eight, "i", "j")))
    assert capsys.readouterr().err.splitlines() == [
        "f contains a, b, c, d, e, f, g, h; this is b, --vessel NAME selects another",
        "g contains a, b, c, d, e, f, g, h and 2 more; this is a, --vessel NAME selects another",
    ]


@pytest.mark.parametrize("variable", ["DISPLAY", "WAYLAND_DISPLAY", None])
def test_a_page_is_opened_where_there_is_a_desktop(
    variable: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: not opened.append(address))  # type: ignore[func-returns-value]
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if variable:
        monkeypatch.setenv(variable, ":0")
    page = tmp_path / "a page.html"
    output.open_in_browser(page)
    assert opened == ([page.as_uri()] if variable else [])
    said = "" if variable else f"no web browser could be opened; open {page} yourself\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize("error", [webbrowser.Error("none"), OSError("none"), None])
def test_a_browser_that_fails_is_told(
    error: Exception | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(address: str) -> bool:
        if error is not None:
            raise error
        return False

    monkeypatch.setattr(webbrowser, "open", fails)
    monkeypatch.setenv("DISPLAY", ":0")
    output.open_in_browser(Path("p.html"))
    assert capsys.readouterr().err == "no web browser could be opened; open p.html yourself\n"


def test_sections_of_a_campaign_show_findings_with_next_steps_and_facts() -> None:
    findings: tuple[Any, ...] = (
        Finding.critical("x.bad", "It is bad", (), "Mend it."),
        Finding.ok("x.good", "It is good"),
    )
    section = Section("x", "Its title", (Fact("runs", "Runs made", 12),), findings)
    stream = io.StringIO()
    output.show_sections(Console(file=stream, width=80, markup=False, highlight=False), [section])
    lines = [line.strip() for line in stream.getvalue().splitlines() if line.strip()]
    assert lines[:3] == ["It is bad.", "Mend it.", "It is good."]
    document = output.sections_document([section])
    assert list(document) == ["x"]
    assert document["x"]["facts"]["runs"] == 12
    assert os.linesep not in document["x"]["title"]
