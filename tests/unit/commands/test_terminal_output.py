"""What commands print at any width: nothing cut off, paths as they are, colours at terminals only."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from tests.command_line import xitl
from xitl_cli.commands.terminal import say, show_facts, show_rows, terminal

ROOT = Path(__file__).parents[3]
COMMANDS = (
    ("profiles", "list"),
    ("profiles", "check", "sitl"),
    ("wdri", "hitl-full"),
    ("params", "show", "defaults", "--filter", "ATC_*"),
    ("params", "diff", "defaults", "embedded-asv-full"),
    ("firmware", "list"),
)


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    xitl(*arguments)
    return capsys.readouterr().out


@pytest.mark.medium
@pytest.mark.parametrize("arguments", COMMANDS, ids=" ".join)
def test_no_line_is_longer_than_the_terminal_and_none_is_cut_off(
    arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    texts = {}
    for width in (400, 80, 40):
        monkeypatch.setenv("COLUMNS", str(width))
        texts[width] = printed(capsys, *arguments)
    wide = texts.pop(400)
    for width, text in texts.items():
        assert "…" not in text
        left_to_the_terminal = arguments[0] == "firmware"  # a path stays one word
        assert left_to_the_terminal or max(map(len, text.splitlines())) <= width
        if arguments[0] != "wdri":  # whose matrix is told in words where there is no room for it
            said = {*" ".join(text.split()).replace(",", " ").split(), "name"}  # a paragraph needs no heading
            assert {word for word in wide.replace(",", " ").split() if len(word) <= width} <= said


def made(width: int = 80, colour: bool = False) -> tuple[Console, io.StringIO]:
    stream = io.StringIO()
    return Console(file=stream, width=width, force_terminal=colour, markup=False, emoji=False, highlight=False), stream


def test_a_table_is_one_where_it_fits_and_paragraphs_where_not() -> None:
    rows = [["sensors", "54610", "a sentence that is long enough to be wrapped in its own column"], ["x", "0", ""]]
    heads = ("link", "sent", "what it is")
    console, wide = made(80)
    show_rows(console, heads, rows, text=(0, 2))
    assert wide.getvalue().splitlines() == [
        "link      sent  what it is",
        "sensors  54610  a sentence that is long enough to be wrapped in its own column",
        "x            0",
    ]
    console, narrower = made(50)
    show_rows(console, heads, rows, text=(0, 2))
    assert narrower.getvalue().splitlines()[1:3] == [
        "sensors  54610  a sentence that is long enough to",
        "                be wrapped in its own column",
    ]
    console, narrow = made(24)
    show_rows(console, heads, rows, text=(0, 2))
    assert narrow.getvalue().splitlines()[:2] == ["sensors", "  sent 54610, what it is"]


def test_brackets_and_colons_are_what_they_are() -> None:
    console, stream = made()
    say(console, "runs/a:x:[red]b")
    show_facts(console, [(":smile:", "[bold]c")])
    show_rows(console, ("", ""), [["[x]", ":warning:"]])
    assert stream.getvalue().splitlines() == ["runs/a:x:[red]b", ":smile:  [bold]c", "[x]  :warning:"]


@pytest.mark.parametrize(("no_color", "coloured"), [(None, True), ("1", False)])
def test_colours_are_for_terminals_that_want_them(
    no_color: str | None, coloured: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    if no_color:
        monkeypatch.setenv("NO_COLOR", no_color)
    console, stream = made(colour=True)
    say(console, "completed", "bold green")
    assert ("\033[1;32m" in stream.getvalue()) is coloured
    console, stream = made()
    say(console, "completed", "bold green")
    assert stream.getvalue() == "completed\n"


def test_every_command_prints_through_one_place() -> None:
    makers = [
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "xitl_cli").rglob("*.py")
        if " Console(" in path.read_text(encoding="utf-8")
    ]
    assert makers == ["xitl_cli/commands/terminal.py"]
    assert terminal().width > 0


@pytest.mark.parametrize("arguments", [(), ("logs",), ("sim",)], ids=" ".join)
def test_help_cuts_nothing_off_in_a_narrow_terminal(
    arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for width in ("80", "50"):
        monkeypatch.setenv("COLUMNS", width)
        text = printed(capsys, *arguments, "--help")
        assert "…" not in text
        assert "..." not in text.replace("[ARGS]...", "")
        assert max(len(line.rstrip()) for line in text.splitlines()) <= int(width)
