"""The core without its plug-ins: a copy of the tree in which they are deleted, one at a time and all of them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("agent", "sim_core", "xitl", "xitl_cli", "profiles", "campaigns", "firmware_params", "examples")
PLUGINS = sorted(folder.name for folder in (ROOT / "xitl_cli/plugins").iterdir() if (folder / "__init__.py").is_file())
COMMAND_OF = {"mapping": "map", "studies": "paper"}
"""A command of each plug-in whose command has another name."""
CORE_TESTS = ("graph", "record/test_recorder.py", "run/core", "run/links", "run/nodes")
pytestmark = pytest.mark.slow


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the packages. Compiled files come along: Python uses none whose source is not there."""
    for package in PACKAGES:
        shutil.copytree(ROOT / package, tmp_path / package)
    for name in ("pyproject.toml", "CONTRIBUTING.md", "README.md", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def python(tree: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Python with the packages of the tree."""
    return subprocess.run(
        [sys.executable, *words],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(tree), os.environ.get("PYTHONPATH"))))},
        capture_output=True,
        text=True,
        check=False,
    )


def xitl(tree: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return python(tree, "-m", "xitl_cli.main", *words)


@pytest.mark.nightly
@pytest.mark.parametrize("plugin", PLUGINS)
def test_a_run_does_without_a_plug_in(tree: Path, plugin: str) -> None:
    shutil.rmtree(tree / "xitl_cli/plugins" / plugin)
    ran = xitl(tree, "sim", "sitl", "--duration", "2", "--out", "run")
    assert ran.returncode == 0, ran.stderr
    assert (tree / "run/run.mcap").is_file()
    if plugin == "learning":  # has functions of Python only
        refused = python(tree, "-c", "import xitl\nxitl.make_env('sitl')")
        assert "PluginError: xitl.make_env: the plug-in is not installed; pip install --force-rein" in refused.stderr
        return
    listed = xitl(tree, "plugins")
    assert listed.returncode == 1
    assert f"No module named 'xitl_cli.plugins.{plugin}'" in " ".join(listed.stdout.split())
    if plugin != "ros":  # has no command
        refused = xitl(tree, COMMAND_OF.get(plugin, plugin))
        assert refused.returncode == 2
        assert "pip install --force-reinstall xitl" in " ".join(refused.stderr.split())


def test_without_the_plug_in_of_logs_an_analysis_is_refused_in_one_sentence(tree: Path) -> None:
    shutil.rmtree(tree / "xitl_cli/plugins/logs")
    refused = python(tree, "-c", "import xitl\nxitl.analyze('run.mcap')")
    assert "PluginError: vehicle: the plug-in of xitl" in refused.stderr
    assert "pip install --force-reinstall xitl" in refused.stderr
    opened = python(tree, "-c", "import xitl\nxitl.open_log('run.mcap')")
    assert "LogError: run.mcap: does not exist" in opened.stderr


def test_the_core_does_without_all_plug_ins(tree: Path) -> None:
    for plugin in PLUGINS:
        shutil.rmtree(tree / "xitl_cli/plugins" / plugin)
    leave_out = shutil.ignore_patterns("data", "plugins")
    shutil.copytree(ROOT / "tests", tree / "tests", ignore=leave_out)
    (tree / "tests/data").symlink_to(ROOT / "tests/data")
    ran = xitl(tree, "sim", "sitl", "--duration", "2", "--out", "run")
    assert ran.returncode == 0, ran.stderr
    for command in (["wdri", "sitl"], ["profiles", "check", "sitl"], ["doctor", "--json"], ["--help"]):
        done = xitl(tree, *command)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
    refused = xitl(tree, "sim", "sitl", "--view", "--duration", "2", "--out", "seen")
    assert refused.returncode == 2
    assert "view: the plug-in of xitl" in " ".join(refused.stderr.split())
    tested = python(
        tree, "-m", "pytest", "-m", "not medium and not slow and not realtime", *(f"tests/unit/{f}" for f in CORE_TESTS)
    )
    assert tested.returncode == 0, tested.stdout[-4000:]
