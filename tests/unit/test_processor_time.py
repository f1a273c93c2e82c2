"""The stage of a test by its processor time, and the marks for it."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.processor_time import LIMIT_S, unmarked

sys.path.append(str(Path(__file__).parents[2]))  # tools/ is no part of the package

from tools.mark_medium import LISTED, marked


@dataclass
class Report:
    nodeid: str
    processor_s: float
    keywords: dict[str, int] = field(default_factory=dict)

    @property
    def user_properties(self) -> list[tuple[str, object]]:
        return [("processor_s", self.processor_s)]


def test_functions_above_the_limit_without_a_mark_are_listed_by_their_mean() -> None:
    reports = [
        Report("a.py::test_long", 2.0 * LIMIT_S),
        Report("a.py::test_short", 0.5 * LIMIT_S),
        Report("a.py::test_both[1]", 2.5 * LIMIT_S),
        Report("a.py::test_both[2]", 0.5 * LIMIT_S),
        Report("a.py::test_seldom[1]", 1.5 * LIMIT_S),
        Report("a.py::test_seldom[2]", 0.0),
        *(Report(f"a.py::test_{mark}", 9.0, {mark: 1}) for mark in ("medium", "slow", "realtime")),
    ]
    assert unmarked(reports) == [
        (pytest.approx(2.0 * LIMIT_S), "a.py::test_long"),
        (pytest.approx(1.5 * LIMIT_S), "a.py::test_both"),
    ]


SOURCE = """\
import pytest


@pytest.mark.parametrize(
    "value",
    [

        1,
    ],
)
def test_one(value): ...


def test_two(): ...


TestMachine = Machine.TestCase
TestMachine.settings = settings()
"""


@pytest.mark.parametrize(
    ("name", "above", "line"),
    [
        ("test_one", "@pytest.mark.parametrize(", "@pytest.mark.medium"),
        ("test_two", "def test_two(): ...", "@pytest.mark.medium"),
        ("TestMachine", "TestMachine.settings = settings()", "TestMachine = pytest.mark.medium(Machine.TestCase)"),
    ],
)
def test_a_mark_is_above_all_decorators(name: str, above: str, line: str) -> None:
    lines = marked(SOURCE, name).splitlines()
    assert lines[lines.index(above) - 1] == line
    assert set(lines) - {line} <= set(SOURCE.splitlines())


def test_what_cannot_be_marked_is_an_error() -> None:
    with pytest.raises(ValueError, match="not at the top"):
        marked(SOURCE, "test_three")
    with pytest.raises(ValueError, match="does not import pytest"):
        marked("def test_one(): ...\n", "test_one")


@pytest.mark.parametrize("name", ["test_one", "TestMachine::runTest"])
def test_a_printed_line_is_read(name: str) -> None:
    found = LISTED.match(f"0.31 s tests/unit/test_x.py::{name}")
    assert found is not None
    assert found.groups() == ("tests/unit/test_x.py", name.partition("::")[0])
