"""Who may import whom: the leaves know nothing of each other, and the agent runs on a bare Python 3.9."""

from __future__ import annotations

import ast
import struct
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
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
WITHOUT_FCU = tuple(
    f"agent/{folder}/" for folder in ("board", "bridges", "companion", "mavlink", "navigation", "timing", "wire")
)
"""Packages that serve any autopilot: they do not know the embedded one."""
ImportStatement = ast.Import | ast.ImportFrom


@dataclass(frozen=True)
class Import:
    path: str
    line: int
    package: str
    lazy: bool
    module: str = ""


def statements(body: Iterable[ast.AST], lazy: bool = False) -> Iterator[tuple[ImportStatement, bool]]:
    """Those that import, each with whether it is inside a function."""
    for node in body:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield node, lazy
        inside = lazy or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        for part in ("body", "orelse", "handlers", "finalbody", "cases"):
            yield from statements(getattr(node, part, ()), inside)


def imports_of(found: Iterable[tuple[ImportStatement, bool]], path: str) -> Iterator[Import]:
    """Absolute imports, by their first name."""
    for node, lazy in found:
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(path, node.lineno, alias.name.partition(".")[0], lazy, alias.name)
            continue
        name = path.partition("/")[0] if node.level else (node.module or "").partition(".")[0]
        if node.level or node.module in ("agent", "xitl_cli"):  # what is imported may be a module
            parent = ".".join(Path(path).parts[: -node.level]) if node.level else str(node.module)
            module = f"{parent}.{node.module}" if node.level and node.module else parent
            for alias in node.names:
                yield Import(path, node.lineno, name, lazy, f"{module}.{alias.name}")
        else:
            yield Import(path, node.lineno, name, lazy, node.module or "")


def imports_in(source: str, path: str) -> list[Import]:
    return list(imports_of(statements(ast.parse(source).body), path))


def within_logs(module: str) -> bool:
    return module == "xitl_cli.logs" or module.startswith("xitl_cli.logs.")


def within_fcu(module: str) -> bool:
    return module == "agent.fcu" or module.startswith("agent.fcu.")


def plugin_of(module: str) -> str:
    """The plug-in that a module belongs to, empty for the core."""
    parts = module.split(".")
    return parts[2] if parts[:2] == ["xitl_cli", "plugins"] and len(parts) > 2 else ""


def files(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


@cache
def statements_of(file: Path) -> list[tuple[ImportStatement, bool]]:
    return list(statements(ast.parse(file.read_text()).body))


def imports(package: str) -> list[Import]:
    return [
        found for file in files(package) for found in imports_of(statements_of(file), file.relative_to(ROOT).as_posix())
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
        elif within_fcu(one.module) and one.path.startswith(WITHOUT_FCU):
            said.append(f"{one.path}:{one.line}: imports {one.module}: only the agent's own autopilot needs it")
        elif (plugin := plugin_of(one.module)) and plugin != plugin_of(one.path.replace("/", ".")):
            said.append(f"{one.path}:{one.line}: imports {one.module}: only the plug-in {plugin} imports its modules")
        elif package == "agent" and not one.path.startswith("agent/companion/"):
            lazily = one.lazy and one.package in LAZY_ON_BOARD
            if not (on_board or lazily or one.package == "agent"):
                said.append(f"{where}: the agent has the standard library alone (serial, can inside functions)")
        elif package == "sim_core":
            lazily = one.lazy and one.package in SIM_CORE_LAZY
            if not (standard or lazily or one.package in SIM_CORE_AT_IMPORT):
                said.append(f"{where}: sim_core has numpy (scipy, pygeomag, embreex, trimesh inside functions)")
    return said


@pytest.mark.medium
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
        ("agent", "agent/bridges/x.py", "from agent.fcu.parameters import Parameters"),
        ("agent", "agent/bridges/x.py", "from agent import fcu"),
        ("agent", "agent/navigation/x.py", "def f():\n    import agent.fcu.mission"),
        ("agent", "agent/companion/x.py", "from ..fcu import mission"),
        ("sim_core", "sim_core/x.py", "from agent.wire import link"),
        ("sim_core", "sim_core/x.py", "import scipy.signal"),
        ("sim_core", "sim_core/x.py", "def f():\n    import xitl_cli"),
        ("xitl_cli", "xitl_cli/logs/x.py", "from xitl_cli.errors import UserError"),
        ("xitl_cli", "xitl_cli/logs/x.py", "def f():\n    from xitl_cli import main"),
        ("xitl_cli", "xitl_cli/logs/report/x.py", "import xitl_cli.logsearch"),
        ("xitl_cli", "xitl_cli/logs/report/x.py", "from ... import main"),
        ("xitl_cli", "xitl_cli/run/x.py", "def f():\n    from xitl_cli.plugins.view.model import ViewInstant"),
        ("xitl_cli", "xitl_cli/main.py", "import xitl_cli.plugins.ros"),
        ("xitl_cli", "xitl_cli/plugins/board/x.py", "from xitl_cli.plugins.studies import paper_command"),
    ],
)
def test_the_rule_catches(package: str, path: str, source: str) -> None:
    assert len(breaches(package, imports_in(source, path))) == 1


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("agent/x.py", "from . import wire\nimport socket\nfrom agent.wire import link"),
        ("agent/x.py", "def open():\n    import serial\n    import can"),
        ("agent/companion/x.py", "import numpy"),
        ("agent/bridges/x.py", "from agent.navigation.estimator import Estimator"),
        ("agent/roles/x.py", "from agent.fcu.parameters import Parameters"),
        (
            "xitl_cli/logs/x.py",
            "from xitl_cli.logs.model.table import Table\nimport agent.wire",
        ),
        ("xitl_cli/logs/report/x.py", "from xitl_cli import logs\nfrom . import page\nfrom ..table import Table"),
        ("xitl_cli/run/x.py", "from xitl_cli.errors import UserError"),
        ("xitl_cli/plugins/board/x.py", "from xitl_cli.plugins.board.emulator import EmulatedBoard"),
        ("xitl_cli/plugins/board/x.py", "from xitl_cli.experiment.setup import ExperimentSetup"),
    ],
)
def test_the_rule_allows(path: str, source: str) -> None:
    assert breaches(path.partition("/")[0], imports_in(source, path)) == []


@pytest.mark.medium
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


def modules_named(node: ImportStatement, own: list[str]) -> Iterator[str]:
    """Dotted names that an import statement may bring in; own: the folder of the importing file, by its parts."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    else:
        start = own[: len(own) + 1 - node.level] if node.level else []
        base = ".".join([*start, *filter(None, [node.module])])
        yield base
        yield from (f"{base}.{alias.name}" for alias in node.names)


@cache
def file_imports() -> dict[str, set[str]]:
    """Which file imports which others of the packages, also lazily and for types."""
    paths = [file.relative_to(ROOT) for package in PACKAGES for file in files(package)]
    modules = {
        ".".join((path.parent if path.name == "__init__.py" else path.with_suffix("")).parts): path for path in paths
    }
    edges: dict[str, set[str]] = {}
    for path in paths:
        for node, _ in statements_of(ROOT / path):
            for name in modules_named(node, list(path.parent.parts)):
                there = modules.get(name)
                if there is not None and there != path:
                    edges.setdefault(path.as_posix(), set()).add(there.as_posix())
    return edges


def grouped(edges: dict[str, set[str]], group: Callable[[Path], str]) -> dict[str, set[str]]:
    """Imports between groups of files; a file of the group "" is left out."""
    found: dict[str, set[str]] = {}
    for source, targets in edges.items():
        here = group(Path(source))
        for there in {group(Path(target)) for target in targets} - {here, ""}:
            if here:
                found.setdefault(here, set()).add(there)
    return found


def folder_of(path: Path) -> str:
    """The folder of a file. The top files of a package serve all below and are left out."""
    return path.parent.as_posix() if len(path.parent.parts) > 1 else ""


def package_of(path: Path) -> str:
    """The package below `xitl_cli`, `agent` or `sim_core`, with the files in all of its folders."""
    return "/".join(path.parent.parts[:2]) if len(path.parent.parts) > 1 else ""


@cache
def folder_imports() -> dict[str, set[str]]:
    """Which folder imports from which others."""
    return grouped(file_imports(), folder_of)


def reached_from(start: str, edges: dict[str, set[str]]) -> set[str]:
    reached: set[str] = set()
    left = [start]
    while left:
        for other in edges.get(left.pop(), set()) - reached:
            reached.add(other)
            left.append(other)
    return reached


def circles(edges: dict[str, set[str]]) -> list[set[str]]:
    """Folders that import each other, directly or by others."""
    reached = {folder: reached_from(folder, edges) for folder in edges}
    groups = {frozenset(other for other in reached[folder] if folder in reached.get(other, ())) for folder in edges}
    return [set(group) for group in groups if group]


@pytest.mark.medium
def test_no_folders_import_each_other() -> None:
    edges = folder_imports()
    assert "xitl_cli/run/core" in edges["xitl_cli/run/nodes"], "the test looks in the wrong place"
    assert circles(edges) == []


@pytest.mark.medium
def test_no_packages_import_each_other() -> None:
    edges = grouped(file_imports(), package_of)
    assert "xitl_cli/profile" in edges["xitl_cli/run"], "the test looks in the wrong place"
    assert circles(edges) == []


@pytest.mark.medium
def test_no_files_import_each_other() -> None:
    edges = file_imports()
    assert "xitl_cli/errors.py" in edges["xitl_cli/main.py"], "the test looks in the wrong place"
    assert circles(edges) == []


@pytest.mark.medium
def test_nodes_of_a_run_stand_on_links_sensors_and_world_and_these_on_no_node() -> None:
    edges = folder_imports()
    for below in ("core", "links", "sensors", "world"):
        assert not edges[f"xitl_cli/run/{below}"] & {"xitl_cli/run", "xitl_cli/run/nodes"}, below
    assert "xitl_cli/run" not in edges["xitl_cli/run/nodes"]


def test_circles_are_found() -> None:
    edges = {"a/b": {"a/c"}, "a/c": {"a/d"}, "a/d": {"a/b", "a/e"}, "a/e": {"a/f"}, "a/f": set()}
    assert circles(edges) == [{"a/b", "a/c", "a/d"}]
