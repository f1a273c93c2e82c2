"""Other Pythons than the one that runs the tests."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest


def python(version: str) -> str:
    """A program of this Python version, for instance 3.9, from the PATH or from pyenv; skips the test without one."""
    named = shutil.which(f"python{version}")
    kept = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python{version}"))
    for candidate in ([named] if named else []) + [str(path) for path in kept]:
        told = subprocess.run(
            [candidate, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"],
            capture_output=True,
            text=True,
            check=False,
        )
        if told.stdout.strip() == version:
            return candidate
    pytest.skip(f"needs a Python {version} (on the PATH as python{version}, or in pyenv)")
