"""Ending and measuring the processes of a run, by /proc as on Linux and by psutil as elsewhere."""

from __future__ import annotations

import os
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from xitl_cli.plugins.campaign import execution, warden
from xitl_cli.plugins.campaign.execution import memory_of_tree_mb
from xitl_cli.plugins.campaign.warden import MARK, end_marked

FAMILY = """
import subprocess, sys, time
held = "import time; held = bytearray(80_000_000); print(1, flush=True); time.sleep(600)"
child = subprocess.Popen([sys.executable, "-c", held])
time.sleep(600)
"""
"""A process with a child that holds 80 MB."""


@pytest.fixture(params=["/proc", "psutil"], autouse=True)
def by(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> str:
    if request.param == "psutil":
        pytest.importorskip("psutil")
        for module in (warden, execution):
            monkeypatch.setattr(module, "PROC", tmp_path / "no folder")
    return str(request.param)


@pytest.fixture
def marked() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    mark = f"test-{uuid.uuid4().hex}"
    process = subprocess.Popen(
        [sys.executable, "-c", FAMILY], env={**os.environ, MARK: mark}, stdout=subprocess.PIPE, start_new_session=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"1\n"
    yield mark, process
    process.kill()
    process.wait()
    process.stdout.close()


def test_a_marked_process_ends_with_its_child_and_no_other(marked: tuple[str, subprocess.Popen[bytes]]) -> None:
    mark, process = marked
    assert end_marked(f"other-{mark}") == 0
    assert process.poll() is None
    assert end_marked(mark) == 2
    assert process.wait(60) < 0
    assert end_marked(mark) == 0


def test_the_memory_of_children_counts(marked: tuple[str, subprocess.Popen[bytes]]) -> None:
    _, process = marked
    assert 80.0 < memory_of_tree_mb(process.pid) < 300.0


def test_an_ended_process_has_no_memory(marked: tuple[str, subprocess.Popen[bytes]]) -> None:
    mark, process = marked
    end_marked(mark)
    process.wait(60)
    assert memory_of_tree_mb(process.pid) == 0.0
