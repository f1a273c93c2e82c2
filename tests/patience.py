"""Waiting for what is sure to come, on whatever machine and beside whatever else."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

PATIENCE_S = 120.0
"""Only ever waited out by a failure."""
LOOK_S = 0.005
Found = TypeVar("Found")


def wait_until(
    holds: Callable[[], Found],
    what: str = "it does not come",
    patience_s: float = PATIENCE_S,
    look_s: float = LOOK_S,
) -> Found:
    """What `holds` returns as soon as that is true; fails with `what` when it never is. look_s: pause between looks."""
    until_s = time.monotonic() + patience_s
    while not (found := holds()):
        assert time.monotonic() < until_s, what
        time.sleep(look_s)
    return found


def let_pass(seconds: float) -> None:
    """Let real time pass, where a duration is the input of a test, such as the length of a disturbance.

    It never stands for waiting until something has happened: that is `wait_until`.
    """
    time.sleep(seconds)
