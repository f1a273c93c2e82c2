"""Long expected texts: they are compared with one file, which one command renews."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.golden import FILE_NAME, IN_CI, OPTION, line_with, read_texts, write_texts

TESTS = Path(__file__).parents[1]
CONFTEST = """
from pathlib import Path
from tests import golden

def pytest_addoption(parser):
    golden.add_option(parser)

def pytest_configure(config):
    golden.register(config, Path(__file__).parent)
"""
TEST = """
import pytest

@pytest.mark.parametrize("port", [7, 8])
def test_says(golden, tmp_path, port):
    golden("error", f"{tmp_path}: PORT {port} is WORD for 5 s\\n\\n  an indented line", "5 s", port=port)
"""
STORED = """test_it.py::test_says[7]: error
| {tmp_path}: PORT {port} is taken for 5 s
|
|   an indented line
"""
STORED += "\n" + STORED.replace("[7]", "[8]")


def run(folder: Path, word: str, *arguments: str, seconds: int = 5, **environment: str) -> tuple[int, str]:
    """pytest on one file of two tests that make a text of a word and a number."""
    (folder / "conftest.py").write_text(CONFTEST)
    (folder / "test_it.py").write_text(TEST.replace("WORD", word).replace("5 s", f"{seconds} s"))
    others = {key: value for key, value in os.environ.items() if key not in (*IN_CI, "PYTEST_ADDOPTS")}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "xdist.plugin", *arguments, "."]
    done = subprocess.run(
        command,
        cwd=folder,
        env=others | {"PYTHONPATH": str(TESTS.parent), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [(), ("-n", "1")], ids=["alone", "xdist"])
def test_an_update_stores_the_texts_and_a_change_fails_until_the_next(
    tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    file = tmp_path / FILE_NAME
    code, said = run(tmp_path, "taken")
    assert (code, file.exists()) == (1, False)
    assert f"has no text 'test_it.py::test_says[7]: error'; run pytest {OPTION}" in said
    assert run(tmp_path, "taken", OPTION, *arguments)[0] == 0
    assert file.read_text() == STORED
    assert run(tmp_path, "taken", *arguments)[0] == 0
    code, said = run(tmp_path, "busy")
    assert code == 1
    assert "-{tmp_path}: PORT {port} is taken for 5 s" in said
    assert "+{tmp_path}: PORT {port} is busy for 5 s" in said
    assert run(tmp_path, "busy", OPTION, *arguments)[0] == 0
    assert file.read_text() == STORED.replace("taken", "busy")


@pytest.mark.medium
def test_an_update_is_refused_in_ci_and_never_changes_a_number(tmp_path: Path) -> None:
    file = tmp_path / FILE_NAME
    file.write_text(STORED)
    for variable in IN_CI:
        code, said = run(tmp_path, "busy", OPTION, **{variable: "true"})
        assert (code, file.read_text()) == (pytest.ExitCode.USAGE_ERROR, STORED)
        assert "is refused in CI" in said
    code, said = run(tmp_path, "taken", OPTION, seconds=6)
    assert (code, file.read_text()) == (1, STORED)
    assert "the update would change numbers" in said


@pytest.mark.medium
def test_an_update_drops_the_texts_that_a_test_no_longer_makes(tmp_path: Path) -> None:
    file = tmp_path / FILE_NAME
    others = "test_it.py::test_says[7]: older\n| older\n\ntest_other.py::test_it: kept\n| kept\n"
    file.write_text(STORED + "\n" + others)
    assert run(tmp_path, "taken", OPTION)[0] == 0
    assert set(read_texts(file)) == {
        "test_it.py::test_says[7]: error",
        "test_it.py::test_says[8]: error",
        "test_other.py::test_it: kept",
    }


def test_the_file_repeats(tmp_path: Path) -> None:
    texts = {"a.py::test: x": "", "a.py::test: y": "one\n\n  two", "b.py::test[a: b]: z": "| a table |"}
    write_texts(tmp_path / FILE_NAME, texts)
    assert read_texts(tmp_path / FILE_NAME) == texts


def test_the_only_line_with_all_parts() -> None:
    assert line_with("one 1\ntwo 2\nthree 1", "1", "th") == "three 1"
    with pytest.raises(AssertionError, match="2 lines contain"):
        line_with(["one 1", "two 1"], "1")


@pytest.mark.medium
def test_each_stored_text_is_of_a_test_that_exists() -> None:
    for key in read_texts(TESTS / FILE_NAME):
        path, _, test = key.partition("::")
        name = re.split(r"\[|: ", test)[0]
        assert name in functions_of(TESTS / path), f"{key}: no such test; rename the key in {FILE_NAME}, or delete it"


@cache
def functions_of(file: Path) -> frozenset[str]:
    """Names of all functions of a file; none if there is no such file."""
    tree = ast.parse(file.read_text(encoding="utf-8") if file.exists() else "")
    return frozenset(part.name for part in ast.walk(tree) if isinstance(part, ast.FunctionDef))
