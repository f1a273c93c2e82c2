"""Status and sentence of a run, from its exit code, its limit, its summary and its last message."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest

from xitl_cli.plugins.campaign.execution import (
    COMPLETED,
    CRASHED,
    ERRORS,
    FAILED,
    INCOMPLETE,
    KILLED,
    MEMORY,
    TIMEOUT,
    _status,
)

DONE: dict[str, Any] = {"error": None, "verdict": {"why": "2 of 6 waypoints"}, "warnings": ["slow"], "companion": None}


@pytest.mark.parametrize(
    ("code", "limit", "summary", "said", "status"),
    [
        (0, None, DONE, "", (COMPLETED, None)),
        (1, None, DONE, "", (INCOMPLETE, "2 of 6 waypoints; slow")),
        (1, None, {**DONE, "companion": {"warnings": ["lost"]}}, "", (INCOMPLETE, "2 of 6 waypoints; slow; lost")),
        (1, None, {}, "", (INCOMPLETE, "")),
        (1, None, {**DONE, "error": "its controller"}, "", (CRASHED, "its controller")),
        (0, None, None, "", (CRASHED, "exit code 0")),
        (1, None, None, "first\nerror: the last line\n\n", (CRASHED, "the last line")),
        (2, None, None, "error: no such profile", (FAILED, "no such profile")),
        (2, None, {**DONE, "error": "in the summary"}, "error: said", (FAILED, "in the summary")),
        (130, None, DONE, "", (KILLED, "interrupted")),
        (3, None, DONE, "", (CRASHED, "exit code 3")),
        (-signal.SIGSEGV, None, None, "", (CRASHED, "ended by SIGSEGV")),
        (-signal.SIGKILL, None, DONE, "", (KILLED, "ended by SIGKILL")),
        (-99, None, None, "", (CRASHED, "ended by 99")),
        (-signal.SIGKILL, TIMEOUT, None, "", (TIMEOUT, "exceeded its time limit")),
        (0, MEMORY, DONE, "", (MEMORY, "exceeded its memory limit")),
    ],
)
def test_the_status_of_a_run(
    code: int, limit: str | None, summary: dict[str, Any] | None, said: str, status: tuple[str, str], tmp_path: Path
) -> None:
    if said:
        (tmp_path / ERRORS).write_text(said)
    assert _status(code, limit, summary, tmp_path) == status
