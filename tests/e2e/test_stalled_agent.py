"""A run in lockstep whose agent is late again and again, as on a machine that is busy, is the run that it always is."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path

import pytest
from conftest import Xitl, differences, payloads, running

from tests.patience import let_pass

pytestmark = pytest.mark.slow
RUN = ("sitl", "--duration", "2", "--set", "autopilot.runs=process", "--set", "autopilot.link=tcp://127.0.0.1:0")
STALL_S = 0.8  # more than after which a tick or the end is said again on a link that may lose it
STALLS = 12


def agent_of(run: int) -> int | None:
    """The process of a run's agent, None once it has ended."""
    for child in Path(f"/proc/{run}/task/{run}/children").read_text().split():
        if b"--attached" in Path(f"/proc/{child}/cmdline").read_bytes():
            return int(child)
    return None


def test_a_stalled_agent_changes_nothing(xitl: Xitl, tmp_path: Path) -> None:
    assert xitl("sim", *RUN, "--out", "smooth").returncode == 0
    stalls = 0
    with running(tmp_path, *RUN) as run:
        while stalls < STALLS and run.poll() is None and (agent := agent_of(run.pid)) is not None:
            with suppress(ProcessLookupError):  # it was about to end
                os.kill(agent, signal.SIGSTOP)
                let_pass(STALL_S)
                os.kill(agent, signal.SIGCONT)
                stalls += 1
            let_pass(0.05)
        run.communicate()
    assert run.returncode == 0
    assert stalls > 0
    smooth, stalled = (payloads(tmp_path / name / "run.mcap") for name in ("smooth", "run"))
    assert smooth.keys() == stalled.keys()
    assert differences(smooth, stalled) == {}
