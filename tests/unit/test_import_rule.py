"""Who may import whom: the leaves know nothing of each other, and the agent runs on a bare Python 3.9."""

from __future__ import annotations

import ast
import struct
import subprocess
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


LOGS = "xitl_cli/logs/"


@dataclass(frozen=True)
class Import:
    path: str
    line: int
    package: str
    lazy: bool
    module: str = ""


def imports_of(tree: ast.AST, path: str, lazy: bool = False) -> Iterator[Import]:
    """Absolute imports, by their first name; lazy when inside a function."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(path, node.lineno, alias.name.partition(".")[0], lazy, alias.name)
        elif isinstance(node, ast.ImportFrom):
            name = path.partition("/")[0] if node.level else (node.module or "").partition(".")[0]
            if node.level or node.module == "xitl_cli":  # what is imported may be a module
                parent = ".".join(Path(path).parts[: -node.level]) if node.level else "xitl_cli"
                module = f"{parent}.{node.module}" if node.level and node.module else parent
                for alias in node.names:
                    yield Import(path, node.lineno, name, lazy, f"{module}.{alias.name}")
            else:
                yield Import(path, node.lineno, name, lazy, node.module or "")
        inside = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
        yield from imports_of(node, path, lazy or inside)


def within_logs(module: str) -> bool:
    return module == "xitl_cli.logs" or module.startswith("xitl_cli.logs.")


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
        elif one.path.startswith(LOGS) and one.package == "xitl_cli" and not within_logs(one.module):
            said.append(f"{one.path}:{one.line}: imports {one.module}: the logs know nothing else of xitl_cli")
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
        ("xitl_cli", "xitl_cli/logs/x.py", "from xitl_cli.errors import UserError"),
        ("xitl_cli", "xitl_cli/logs/x.py", "def f():\n    from xitl_cli import main"),
        ("xitl_cli", "xitl_cli/logs/report/x.py", "import xitl_cli.logsearch"),
        ("xitl_cli", "xitl_cli/logs/report/x.py", "from ... import main"),
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
        ("xitl_cli/logs/x.py", "from xitl_cli.logs.table import Table\nfrom sim_core import frames\nimport agent.wire"),
        ("xitl_cli/logs/report/x.py", "from xitl_cli import logs\nfrom . import page\nfrom ..table import Table"),
        ("xitl_cli/run/x.py", "from xitl_cli.errors import UserError"),
    ],
)
def test_the_rule_allows(path: str, source: str) -> None:
    assert breaches(path.partition("/")[0], list(imports_of(ast.parse(source), path))) == []


def test_a_log_is_read_without_the_rest_of_xitl_cli(tmp_path: Path) -> None:
    fmt = struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 0x80, 129, 3 + 8 + 4, b"ATT", b"Qf", b"TimeUS,Roll")
    rows = [struct.pack("<BBBQf", 0xA3, 0x95, 129, number * 1000, 0.5) for number in range(9)]
    path = tmp_path / "log.bin"
    path.write_bytes(fmt + b"".join(rows))
    program = f"""
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.startswith("xitl_cli.") and not (name + ".").startswith("xitl_cli.logs."):
            raise ImportError(name)
sys.meta_path.insert(0, Refuse())
from xitl_cli.logs import open_log
with open_log({str(path)!r}) as log:
    print(log.tables["ATT"].values("Roll").sum())
"""
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr
    assert float(told.stdout) == 4.5


@pytest.mark.parametrize("file", files("agent"), ids=lambda file: file.relative_to(ROOT).as_posix())
def test_the_agent_is_python_3_9(file: Path) -> None:
    ast.parse(file.read_text(), filename=str(file), feature_version=(3, 9))
