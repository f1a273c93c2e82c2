"""A skip in CI fails the run, unless the list permits it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.permitted_skips import GUARD

ROOT = Path(__file__).parents[2]


def run(directory: Path, reason: str, guarded: bool, *arguments: str) -> subprocess.CompletedProcess[str]:
    """pytest on one file whose only test skips, with the guard of this suite."""
    (directory / "conftest.py").write_text("from tests.permitted_skips import register as pytest_configure\n")
    (directory / "test_it.py").write_text(
        f"import pytest\n\ndef test_passes():\n    pass\n\ndef test_skips():\n    pytest.skip({reason!r})\n"
    )
    environment = {key: value for key, value in os.environ.items() if key not in (GUARD, "PYTEST_ADDOPTS")}
    environment |= {"PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"} | ({GUARD: "1"} if guarded else {})
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "xdist.plugin", *arguments, "."]
    return subprocess.run(command, cwd=directory, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.medium
@pytest.mark.parametrize("arguments", [(), ("-n", "1")], ids=["alone", "xdist"])
def test_a_skip_that_is_not_permitted_fails_in_ci(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    done = run(tmp_path, "needs a Lua interpreter", True, *arguments)
    assert done.returncode == 1, done.stdout
    assert "test_it.py::test_skips: needs a Lua interpreter" in done.stdout
    assert "permitted_skips.py" in done.stdout


@pytest.mark.medium
def test_a_permitted_skip_and_a_developer_s_skip_pass(tmp_path: Path) -> None:
    assert run(tmp_path, "needs a real PX4 (XITL_PX4=PATH): no px4", True).returncode == 0
    assert run(tmp_path, "needs a Lua interpreter", False).returncode == 0
