"""Who may import whom: the two leaves know nothing of each other, and the agent runs on a bare Python 3.9."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("sim_core", "agent", "xitl_cli")
FORBIDDEN = {"sim_core": {"agent", "xitl_cli"}, "agent": {"sim_core", "xitl_cli"}, "xitl_cli": set()}
NEWER_THAN_3_9 = {"annotationlib", "compression", "tomllib"}
LAZY_ON_BOARD = {"serial", "can"}  # pyserial and python-can: only where that transport is opened
SIM_CORE_AT_IMPORT = {"numpy", "sim_core"}
SIM_CORE_LAZY = {"scipy", "pygeomag", "embreex", "trimesh"}


@dataclass(frozen=True)
class Import:
    path: str
    line: int
    package: str
    lazy: bool


def imports_of(tree: ast.AST, path: str, lazy: bool = False) -> Iterator[Import]:
    """Absolute imports, by their first name; lazy when inside a function."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(path, node.lineno, alias.name.partition(".")[0], lazy)
        elif isinstance(node, ast.ImportFrom):
            name = path.partition("/")[0] if node.level else (node.module or "").partition(".")[0]
            yield Import(path, node.lineno, name, lazy)
        inside = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
        yield from imports_of(node, path, lazy or inside)


def files(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imports(package: str) -> list[Import]:
    return [
        found
        for file in files(package)
        for found in imports_of(ast.parse(file.read_text()), file.relative_to(ROOT).as_posix())
    ]


def breaches(package: str, found: list[Import]) -> list[str]:
    """One line per import against the rule."""
    said = []
    for one in found:
        where = f"{one.path}:{one.line}: imports {one.package}"
        standard = one.package in sys.stdlib_module_names
        on_board = standard and one.package not in NEWER_THAN_3_9
        if one.package in FORBIDDEN[package]:
            said.append(f"{where}: {package} knows nothing of it")
        elif package == "agent" and not one.path.startswith("agent/companion/"):
            lazily = one.lazy and one.package in LAZY_ON_BOARD
            if not (on_board or lazily or one.package == "agent"):
                said.append(f"{where}: the agent has the standard library alone (serial, can inside functions)")
        elif package == "sim_core":
            lazily = one.lazy and one.package in SIM_CORE_LAZY
            if not (standard or lazily or one.package in SIM_CORE_AT_IMPORT):
                said.append(f"{where}: sim_core has numpy (scipy, pygeomag, embreex, trimesh inside functions)")
    return said


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_keep_the_rule(package: str) -> None:
    found = imports(package)
    assert found, f"no imports read in {package}: the test looks in the wrong place"
    assert breaches(package, found) == []


@pytest.mark.parametrize(
    ("package", "path", "source"),
    [
        ("agent", "agent/x.py", "import sim_core.frames"),
        ("agent", "agent/x.py", "from xitl_cli import main"),
        ("agent", "agent/x.py", "import numpy"),
        ("agent", "agent/x.py", "import tomllib"),
        ("agent", "agent/x.py", "import serial"),
        ("agent", "agent/x.py", "if True:\n    from can import Bus"),
        ("agent", "agent/companion/x.py", "def f():\n    import sim_core"),
        ("sim_core", "sim_core/x.py", "from agent.wire import link"),
        ("sim_core", "sim_core/x.py", "import scipy.signal"),
        ("sim_core", "sim_core/x.py", "def f():\n    import xitl_cli"),
    ],
)
def test_the_rule_catches(package: str, path: str, source: str) -> None:
    assert len(breaches(package, list(imports_of(ast.parse(source), path)))) == 1


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("agent/x.py", "from . import wire\nimport socket\nfrom agent.wire import link"),
        ("agent/x.py", "def open():\n    import serial\n    import can"),
        ("agent/companion/x.py", "import numpy"),
    ],
)
def test_the_rule_allows(path: str, source: str) -> None:
    assert breaches("agent", list(imports_of(ast.parse(source), path))) == []


@pytest.mark.parametrize("file", files("agent"), ids=lambda file: file.relative_to(ROOT).as_posix())
def test_the_agent_is_python_3_9(file: Path) -> None:
    ast.parse(file.read_text(), filename=str(file), feature_version=(3, 9))
