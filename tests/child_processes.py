"""The child processes of this one, for tests that end a program that the product has started."""

from __future__ import annotations

import os
from pathlib import Path


def child_processes() -> set[int]:
    """Return the process ids."""
    return {int(folder.name) for folder in Path("/proc").glob("[0-9]*") if parent_of(folder) == os.getpid()}


def parent_of(folder: Path) -> int | None:
    """Parent of a process by its folder in /proc, None if it has ended."""
    try:
        stat = (folder / "stat").read_text()
    except OSError:
        return None
    return int(stat.rpartition(")")[2].split()[1])
