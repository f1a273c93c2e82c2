"""Long expected texts of all tests, kept in one file: tests/golden.txt.

A test passes a text to the fixture `golden`, which compares it with the stored one. After a change of wording,
`pytest --update-golden` stores the texts that the tests make now, and `git diff tests/golden.txt` shows the change.
An update never changes a number of a stored text. Correct the number in the file by hand, or delete the entry.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from tests.permitted_skips import GUARD

OPTION = "--update-golden"
FILE_NAME = "golden.txt"
IN_CI = ("CI", GUARD)
"""Environment variables that a CI sets; there, an update is refused."""

MARGIN = "| "
TEMPORARY = "/pytest-of-"
"""Part of each folder of tmp_path and tmp_path_factory."""
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def read_texts(file: Path) -> dict[str, str]:
    """Stored texts by key. A key is a line of the file; the lines of its text follow, each with a margin."""
    texts: dict[str, str] = {}
    key = ""
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        if line.startswith(MARGIN.strip()):
            texts[key] += line[len(MARGIN) :] + "\n"
        elif line:
            key = line
            texts[key] = ""
    return {key: text[:-1] for key, text in texts.items()}


def write_texts(file: Path, texts: dict[str, str]) -> None:
    """Write the texts in the order of their keys."""
    parts = []
    for key, text in sorted(texts.items()):
        lines = [(MARGIN + line).rstrip() for line in text.split("\n")]
        parts.append("\n".join([key, *lines]))
    file.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def numbers(text: str) -> list[str]:
    return sorted(NUMBER.findall(text))


def line_with(text: str | Iterable[str], *parts: str) -> str:
    """Return the only line that contains all parts; fails if there is none or more than one."""
    lines = text.splitlines() if isinstance(text, str) else list(text)
    chosen = [line for line in lines if all(part in line for part in parts)]
    assert len(chosen) == 1, f"{len(chosen)} lines contain {parts}:\n" + "\n".join(lines)
    return chosen[0]


class GoldenTexts:
    """The stored texts of a session, and the texts that its tests made."""

    def __init__(self, folder: Path, update: bool) -> None:
        self.file = folder / FILE_NAME
        self.update = update
        self.stored = read_texts(self.file)
        self.made: dict[str, str] = {}
        self.passed: set[str] = set()
        """Tests that ran to their end, by the start of their keys."""

    def check(self, key: str, text: str) -> None:
        """Compare with the stored text, or keep the text for the update."""
        stored = self.stored.get(key)
        if self.update:
            if stored is not None and numbers(stored) != numbers(text):
                pytest.fail(f"the update would change numbers of {key!r}:\n{difference(stored, text)}", pytrace=False)
            self.made[key] = text
        elif stored is None:
            pytest.fail(f"{self.file.name} has no text {key!r}; run pytest {OPTION}. The text is:\n{text}")
        elif text != stored:
            pytest.fail(
                f"{key!r} differs from {self.file.name}:\n{difference(stored, text)}\n"
                f"If the new text is right, run pytest {OPTION} and review the diff of {self.file.name}."
            )

    def merged(self, made: dict[str, str], passed: Iterable[str]) -> dict[str, str]:
        """Texts after an update: those of a passed test are replaced, so that texts it no longer makes go."""
        tests = set(passed)
        kept = {key: text for key, text in self.stored.items() if key.rpartition(": ")[0] not in tests}
        return kept | made


def difference(stored: str, text: str) -> str:
    lines = difflib.unified_diff(stored.split("\n"), text.split("\n"), "stored", "made now", lineterm="")
    return "\n".join(lines)


class Golden:
    """The fixture: compares the texts of one test with the stored ones."""

    def __init__(self, texts: GoldenTexts, test: str, places: dict[str, str]) -> None:
        self._texts = texts
        self._test = test
        self._places = places
        """Names of places by their values."""

    def __call__(self, name: str, text: object, /, *figures: str, **places: object) -> None:
        """Compare a text, or several as lines, with the one that is stored under the test and the name.

        figures: numbers and words that the text must contain in any wording. places: values that differ from run to
        run, such as a port; the stored text has the name of the argument in their place. tmp_path has a place always.
        """
        joined = text if isinstance(text, str) else "\n".join(text) if isinstance(text, (list, tuple)) else str(text)
        for figure in figures:
            assert figure in joined, f"{figure!r} is not in {joined!r}"
        values = {str(value): place for place, value in places.items()} | self._places
        for value in sorted(values, key=len, reverse=True):
            joined = re.sub(rf"(?<!\w){re.escape(value)}(?!\w)", f"{{{values[value]}}}", joined)
        assert TEMPORARY not in joined, f"give the folder a place, such as run=folder: {joined}"
        lines = [line.rstrip() for line in joined.split("\n")]
        self._texts.check(f"{self._test}: {name}", "\n".join(lines).rstrip("\n"))


class GoldenPlugin:
    """Gives the fixture, and writes the file at the end of an update."""

    def __init__(self, folder: Path, update: bool) -> None:
        self.folder = folder
        self.texts = GoldenTexts(folder, update)

    @pytest.fixture
    def golden(self, request: pytest.FixtureRequest) -> Golden:
        places = {str(self.folder.parent): "repository"}
        if "tmp_path" in request.fixturenames:
            places[str(request.getfixturevalue("tmp_path"))] = "tmp_path"
        return Golden(self.texts, self._start_of_key(request.node), places)

    def _start_of_key(self, item: pytest.Item) -> str:
        path, _, test = item.nodeid.partition("::")
        file = Path(item.path)
        return f"{file.relative_to(self.folder).as_posix() if self.folder in file.parents else path}::{test}"

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
        report = yield
        if call.when == "call" and report.passed:
            self.texts.passed.add(self._start_of_key(item))
        return report

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        made, passed = getattr(node, "workeroutput", {}).get("golden", ({}, ()))
        self.texts.made.update(made)
        self.texts.passed.update(passed)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if not self.texts.update:
            return
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput["golden"] = (self.texts.made, sorted(self.texts.passed))
            return
        texts = self.texts.merged(self.texts.made, self.texts.passed)
        if texts != self.texts.stored:
            write_texts(self.texts.file, texts)


def add_option(parser: pytest.Parser) -> None:
    parser.addoption(OPTION, action="store_true", help=f"store the long texts that tests make now in {FILE_NAME}")


def register(config: pytest.Config, folder: Path) -> None:
    """Add the fixture, and refuse an update in CI."""
    update = bool(config.getoption(OPTION))
    if update and any(os.environ.get(name) for name in IN_CI):
        raise pytest.UsageError(f"{OPTION} is refused in CI ({' or '.join(IN_CI)} is set); run it where you work")
    config.pluginmanager.register(GoldenPlugin(folder, update))
