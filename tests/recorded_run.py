"""Runs and values that are made once for all tests, also for those of other processes."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from tests.forked_xitl import run_xitl

FOLDER = "XITL_TEST_RUNS"  # in the environment; tests/conftest.py makes it and removes it
ENOUGH_S = 300.0
FAULTS = """\
extends: hitl-loopback
faults:
  cut: {from_s: 1.0, until_s: 2.0, link: {cut: true}}
  jump: {from_s: 4.0, agent: {clock_offset_s: 0.5}}
"""


def recorded_run(profile: str = "sitl", duration_s: float = 30.0, *overrides: str) -> Path:
    """The run's directory: run.mcap, autopilot.bin, summary.json. The same arguments give the same directory."""
    words = ["sim", "--profile", profile, "--duration", f"{duration_s:g}"]
    for override in overrides:
        words += ["--set", override]
    folder = Path(os.environ[FOLDER]) / sha256(" ".join(words).encode()).hexdigest()[:16]
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "run/summary.json").exists():
            done = run_xitl([*words, "--out", "run", "--json"], folder, os.environ, ENOUGH_S)
            assert done.returncode == 0, done.stderr
    return folder / "run"


def made_once(name: str, make: Callable[[], Any]) -> Any:
    """Return the JSON value that `make` returned to the first process of the tests that asked for this name."""
    file = Path(os.environ[FOLDER]) / f"{name}.json"
    with file.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not file.exists():
            file.write_text(json.dumps(make()), encoding="utf-8")
    return json.loads(file.read_text(encoding="utf-8"))


def recorded_faults() -> Path:
    """6 s in real time: from 1 to 2 s the link to the agent is cut, at 4 s its clock leaps 0.5 s ahead."""
    profile = Path(os.environ[FOLDER]) / "faulty.yaml"
    profile.write_text(FAULTS, encoding="utf-8")
    return recorded_run(str(profile), 6.0)
