"""Waiting for what is sure to come, on whatever machine and beside whatever else."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

PATIENCE_S = 120.0
"""Only ever waited out by a failure."""
Found = TypeVar("Found")


def wait_until(holds: Callable[[], Found], what: str = "it does not come", patience_s: float = PATIENCE_S) -> Found:
    """What `holds` returns as soon as that is true; fails with `what` when it never is."""
    until_s = time.monotonic() + patience_s
    while not (found := holds()):
        assert time.monotonic() < until_s, what
        time.sleep(0.005)
    return found
