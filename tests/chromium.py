"""Chromium as tests use it: without a window, drawing in software, and with no right to go before other processes."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium; apt install chromium")
PROGRAM = Path(__file__).with_name("chromium.sh")
SOFTWARE = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def launch_chromium(driver: Any, flags: tuple[str, ...] = SOFTWARE) -> Any:
    """A browser of playwright's; flags: SOFTWARE draws WebGL."""
    return driver.chromium.launch(executable_path=str(PROGRAM), args=list(flags))
