"""A run of ours, recorded once for all tests of a process."""

from __future__ import annotations

import atexit
import functools
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path


@functools.cache
def recorded_run(profile: str = "sitl", duration_s: float = 30.0, *overrides: str) -> Path:
    """The run's directory: run.mcap, autopilot.bin, summary.json. The same arguments give the same directory."""
    folder = Path(tempfile.mkdtemp(prefix="xitl-run-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    command = [sys.executable, "-m", "xitl_cli.main", "sim", "--profile", profile, "--duration", f"{duration_s:g}"]
    for override in overrides:
        command += ["--set", override]
    done = subprocess.run(
        [*command, "--out", str(folder / "run"), "--json"], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder / "run"
