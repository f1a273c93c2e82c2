"""A run at a terminal that goes away: it ends like one that is told to, and nothing of it is left."""

from __future__ import annotations

import os
import pty
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from conftest import command, environment, summary

from tests.patience import PATIENCE_S, wait_until

pytestmark = pytest.mark.slow


def test_a_terminal_that_hangs_up_ends_the_run_with_its_summary(tmp_path: Path) -> None:
    words = ("hitl-loopback", "--set", "autopilot.link=udp://127.0.0.1:0", "--set", "autopilot.ground_stations=[]")
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(tmp_path)
        os.execvpe(sys.executable, command("sim", *words, "--duration", "600", "--out", "run"), environment())
    try:
        until_s = time.monotonic() + PATIENCE_S
        text = b""
        while b"cross-track" not in text and time.monotonic() < until_s:  # the panel: it is under way
            text += os.read(terminal, 4096)
        children = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        assert len(children) == 1
        os.close(terminal)
        found = wait_until(lambda: (ended := os.waitpid(pid, os.WNOHANG))[0] and ended)
    finally:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    assert os.waitstatus_to_exitcode(found[1]) == 130
    told = summary(tmp_path / "run")
    assert (told["ended"], told["error"]) == ("interrupted", None)
    assert told["links"][0]["received"] is not None  # the agent was there to the end, and told its counts
    assert not Path(f"/proc/{children[0]}").exists()
