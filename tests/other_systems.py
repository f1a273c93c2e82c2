"""Windows and macOS as their standard library differs from that of Linux, for commands of xitl on Linux.

The names that a system lacks come from typeshed, the annotations of the standard library that mypy brings: conditions
on `sys.platform` enclose them there. tests/doubles/other_system hides them from xitl.
"""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import mypy

ROOT = Path(__file__).parents[1]
DOUBLE = ROOT / "tests/doubles/other_system"
ANNOTATIONS = Path(mypy.__file__).parent / "typeshed/stdlib"
WINDOWS, MACOS = "win32", "darwin"
"""Values of `sys.platform`."""


def public_names(platform: str, tree: ast.Module) -> frozenset[str]:
    """Public names that an annotated module defines on a platform."""
    system = SimpleNamespace(platform=platform, version_info=sys.version_info)

    def statements(body: Sequence[ast.stmt]) -> Iterator[ast.stmt]:
        for statement in body:
            if isinstance(statement, ast.If):
                condition = compile(ast.Expression(statement.test), "<typeshed>", "eval")
                chosen = eval(condition, {"sys": system, "TYPE_CHECKING": True})
                yield from statements(statement.body if chosen else statement.orelse)
            else:
                yield statement

    found: set[str] = set()
    for statement in statements(tree.body):
        if isinstance(statement, (ast.FunctionDef, ast.ClassDef)):
            found.add(statement.name)
        elif isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            found.add(statement.target.id)
        elif isinstance(statement, ast.Assign):
            found |= {target.id for target in statement.targets if isinstance(target, ast.Name)}
        elif isinstance(statement, ast.ImportFrom):
            found |= {alias.asname for alias in statement.names if alias.asname}
    return frozenset(name for name in found if not name.startswith("_"))


@cache
def hidden_names(platform: str) -> dict[str, list[str]]:
    """Names of each top module of the standard library that Linux has and a platform lacks; `["*"]`: all of them."""
    hidden = {}
    for path in sorted({*ANNOTATIONS.glob("[a-z]*.pyi"), *ANNOTATIONS.glob("[a-z]*/__init__.pyi")}):
        module = path.parent.name if path.stem == "__init__" else path.stem
        source = path.read_text(encoding="utf-8")
        if "sys.platform" not in source:
            continue
        tree = ast.parse(source)
        here, there = public_names("linux", tree), public_names(platform, tree)
        if here and not there:
            hidden[module] = ["*"]
        elif here - there:
            hidden[module] = sorted(here - there)
    return hidden


def environment_there(platform: str, folder: Path) -> dict[str, str]:
    """Environment of a Python in which modules of xitl see this platform. folder: for its cache.

    On Windows, output is encoded as in Western Europe, and a text file without a stated encoding accepts ASCII only.
    """
    settings = {"platform": platform, "root": str(ROOT), "hidden": hidden_names(platform)}
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join((str(DOUBLE), str(ROOT))),
        "XITL_TEST_OTHER_SYSTEM": json.dumps(settings),
        "XITL_CACHE": str(folder / "cache"),
    }
    if platform == WINDOWS:
        environment |= {"PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    return environment


def python_there(platform: str, words: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Python with `words` in a folder, in the environment of this platform."""
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=environment_there(platform, folder),
        capture_output=True,
        encoding="cp1252" if platform == WINDOWS else "utf-8",
        timeout=300,
        check=False,
    )
