"""A load on purpose: it is there, it is the share asked for, and it ends."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from agent.faults import CpuLoad
from tests.golden import Golden
from tests.patience import wait_until


def is_alive(pid: int) -> bool:
    """Running, not just waiting to be asked how it ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def cpu_s(pid: int) -> float:
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def gone(pids: list[int]) -> bool:
    return wait_until(lambda: not any(map(is_alive, pids)))


def test_it_starts_one_process_a_processor_and_leaves_none() -> None:
    load = CpuLoad()
    assert load.set(0.1) == ""
    pids = load.processes
    assert len(pids) == os.cpu_count()
    assert load.set(0.1) == ""
    assert load.processes == pids
    assert load.set(0.0) == ""
    assert load.processes == []
    assert gone(pids)


@pytest.mark.slow
def test_it_takes_time() -> None:
    load = CpuLoad()
    try:
        load.set(0.5)
        pids = load.processes
        wait_until(lambda: all(cpu_s(pid) > 0.3 for pid in pids))
    finally:
        load.close()


@pytest.mark.medium
def test_it_ends_with_who_started_it_even_by_a_kill() -> None:
    program = """
import os, signal, sys
from agent.faults import CpuLoad
load = CpuLoad()
load.set(0.2)
print(*load.processes, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    pids = [int(word) for word in told.stdout.split()]
    assert len(pids) == os.cpu_count()
    assert gone(pids)


def test_without_an_interpreter_it_says_so(monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    load = CpuLoad()
    golden("text", load.set(0.5))
    assert (load.share, load.processes) == (0.0, [])
