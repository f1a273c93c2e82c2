"""Property tests here are repeatable and judge no time. On a Python that is a board's alone, no test needs the host."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from hypothesis import settings

settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")

_OF_THE_HOST = re.compile(r"^(?:from|import) (?:sim_core|xitl|tests)", re.MULTILINE)
collect_ignore = [
    str(file)
    for file in sorted(Path(__file__).parent.rglob("test_*.py"))
    if sys.version_info < (3, 11) and _OF_THE_HOST.search(file.read_text(encoding="utf-8"))
]
