"""Mark tests: `make test-fast PYTEST=--processor-time | python tools/mark_medium.py` marks those that it prints."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
MARK = "pytest.mark.medium"
LISTED = re.compile(r"[\d.]+ s (tests/\S+\.py)::(\w+)(?:::runTest)?$")


def marked(source: str, name: str) -> str:
    """Return the source of a test file with the mark above a test. Raises ValueError if that is not possible."""
    if not re.search(r"(?m)^import pytest$", source):
        raise ValueError("its file does not import pytest")
    lines = source.splitlines(keepends=True)
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name == name:
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            return "".join([*lines[: first - 1], f"@{MARK}\n", *lines[first - 1 :]])
        # A state machine of Hypothesis is a test by `TestMachine = Machine.TestCase`.
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            line = f"{name} = {MARK}({ast.unparse(node.value)})\n"
            return "".join([*lines[: node.lineno - 1], line, *lines[node.end_lineno :]])
    raise ValueError("it is not at the top of its file")


def main(printed: Iterable[str]) -> None:
    """Mark the tests of these lines; print those that could not be marked."""
    for line in printed:
        found = LISTED.match(line.strip())
        if found is not None:
            path = ROOT / found[1]
            try:
                path.write_text(marked(path.read_text(encoding="utf-8"), found[2]), encoding="utf-8")
            except ValueError as error:
                print(f"{found[1]}::{found[2]}: not marked: {error}", file=sys.stderr)


if __name__ == "__main__":
    main(sys.stdin)
