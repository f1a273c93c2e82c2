"""The pages that users read, taken apart: what they have typed, written to files, run and expected.

What a block is follows from what is in it. Where it cannot, a comment above it, which readers of the page do not see,
says so:

    <!-- needs: board -->       commands that need what a test has not (`NEEDS`): parsed, not run
    <!-- output of: COMMAND --> what it prints; `…` stands for what is left out
    <!-- shape of: COMMAND -->  the same, with other numbers
    <!-- file: NAME -->         the content of a file; profiles say their name in their first line
    <!-- typed: PROGRAM -->     what is typed into another program
    <!-- drawing -->            a drawing
"""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "CONTRIBUTING.md", *sorted(f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md")))
NEEDS = (
    "board",
    "firmware",
    "network",
    "ground station",
    "vehicle",
    "perception",
    "superuser",
    "a running simulation",
    "browser",
    "plug-in",
    "minutes",
)
PROGRAMS = (
    *("xitl", "make", "pip", "git", "cd", "echo", "chmod", "ip", "python", "python3"),
    *("ardurover", "mavproxy.py", "podman", "px4"),
)
COMMANDS, CONSOLE, FILE, CODE, SIGNATURE, PATCH = "commands", "console", "file", "code", "signature", "patch"
OUTPUT, SHAPE, TYPED, DRAWING = "output of", "shape of", "typed", "drawing"
KINDS = (COMMANDS, CONSOLE, FILE, CODE, SIGNATURE, PATCH, OUTPUT, SHAPE, TYPED, DRAWING)
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NOTE = re.compile(r"<!-- (needs|output of|shape of|file|typed|drawing)(?:: (.+?))? -->\n+\Z")
_INLINE = re.compile(r"(?<!`)`((?:xitl|make|pip) [^`]+)`(?!`)")


@dataclass(frozen=True, slots=True)
class Block:
    """One between fences. note, about: of the comment above it."""

    page: str
    line: int
    language: str
    text: str
    note: str = ""
    about: str = ""

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def kind(self) -> str:
        """One of `KINDS`. Raises ValueError for a block that nothing is known of."""
        first = self.text.partition("\n")[0]
        if self.note in (OUTPUT, SHAPE, FILE, TYPED, DRAWING):
            return self.note
        if self.language == "diff":
            return PATCH
        if self.language in ("yaml", "ini") and self.file:
            return FILE
        if self.language == "python":
            return SIGNATURE if re.fullmatch(r"\w+\(.*\) -> [\w |]+\n", self.text, re.DOTALL) else CODE
        if self.language in ("", "sh", "console") and first.startswith("$ "):
            return CONSOLE
        if self.language in ("", "sh") and all(command.program in PROGRAMS for command in self.commands):
            return COMMANDS
        raise ValueError(
            f"{self}: a block of unknown kind; say above it what it is, see tests/documentation.py; or name in its "
            f"first line, as a comment, the file that a profile is written to"
        )

    @property
    def file(self) -> str:
        """Where its text belongs; empty for nowhere."""
        if self.note == FILE:
            return self.about
        named = re.match(r"# ([\w.-]+\.(?:yaml|conf))\b", self.text)
        return named[1] if named else ""

    @property
    def is_plan(self) -> bool:
        """Whether it is the plan of a campaign, and not a profile."""
        return (
            self.kind == FILE and self.language == "yaml" and re.search(r"^base:", self.text, re.MULTILINE) is not None
        )

    @property
    def commands(self) -> list[Command]:
        """Its lines; of a console those after `$`."""
        lines = list(enumerate(self.text.splitlines(), self.line + 1))
        if self.text.startswith("$ "):
            lines = [(number, line[2:]) for number, line in lines if line.startswith("$ ")]
        needs = self.about if self.note == "needs" else ""
        return [Command(self.page, number, line, needs) for number, line in lines if line.strip()]


@dataclass(frozen=True, slots=True)
class Command:
    """A line to type. needs: what a test has not, empty for nothing."""

    page: str
    line: int
    text: str
    needs: str = ""

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"

    @property
    def words(self) -> list[str]:
        """Without the comment after it."""
        return shlex.split(self.text.removeprefix("board$ "), comments=True)

    @property
    def program(self) -> str:
        """What is called."""
        return (self.words or [""])[0]


def blocks(page: str) -> list[Block]:
    """Of a page, in its order."""
    return list(_blocks(page))


def _blocks(page: str) -> Iterator[Block]:
    text = (ROOT / page).read_text(encoding="utf-8")
    for fence in _FENCE.finditer(text):
        line = text.count("\n", 0, fence.start()) + 1
        note = _NOTE.search(text, 0, fence.start())
        yield Block(page, line, fence[1], fence[2], *((note[1], note[2] or "") if note else ()))


def inline_commands(page: str) -> list[Command]:
    """Those in the prose of a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    prose = _FENCE.sub(lambda fence: "\n" * fence[0].count("\n"), text)
    return [
        Command(page, number, found)
        for number, line in enumerate(prose.splitlines(), 1)
        for found in _INLINE.findall(line)
    ]


def profile_header_commands() -> list[Command]:
    """Those at the top of the shipped profiles and plans."""
    found = []
    for file in sorted([*(ROOT / "profiles").rglob("*.yaml"), *(ROOT / "campaigns").glob("*.yaml")]):
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
            if line.startswith("#   "):
                found.append(Command(str(file.relative_to(ROOT)), number, line[4:]))
    return found


SUPPOSED = {
    "mine.csv": "",
    "boat.bag": "",
    "pool-test.csv": "",
    "00000042.BIN": "",
    "runs/mine/autopilot.bin": "",
    "boat.key": "a-long-passphrase",
    "tuned.parm": "",
    "reach.geojson": '{"type": "Point", "coordinates": [-63.951, -8.8055]}',  # where the profile sitl is
}
"""Files of the reader's own that pages name, with their texts."""


def suppose(directory: Path) -> None:
    """Make the files of the reader's own there, and what comes with the sources."""
    (directory / "examples").symlink_to(ROOT / "examples")
    for name, text in SUPPOSED.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_text(text)
        if name.endswith(".key"):
            (directory / name).chmod(0o600)


def is_python(text: str) -> bool:
    """Whether it compiles."""
    try:
        ast.parse(text)
    except SyntaxError:
        return False
    return True


def holds(expected: str, printed: str, shape: bool = False) -> str:
    """The first part of `expected` that `printed` does not hold, in this order; empty when it holds all.

    White space and what wall-clock time brings are left out; with `shape` all numbers.
    """
    text, at = " ".join(printed.split()), 0
    for part in re.split(r"\s*…\s*", expected.strip()):
        pattern = re.escape(" ".join(part.split()))
        if shape:
            pattern = re.sub(r"(?:\\[-+])?\d+(?:\\\.\d+)?", r"[-+]?[\\d.]+", pattern)
        else:  # "153.7 s in 8.2 s, 18.7× real time"
            pattern = re.sub(r"in\\ [\d\\.]+\\ s,\\ [\d\\.]+×", r"in\\ [\\d.]+\\ s,\\ [\\d.]+×", pattern)
        found = re.compile(pattern).search(text, at)
        if found is None:
            return part
        at = found.end()
    return ""
