"""The `xitl` command in a process of its own, forked from one that has loaded it, which takes longer than most runs."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["xitl_cli.main", "xitl_cli.commands.sim_report", "xitl_cli.plugins.logs.command"])


def run_xitl(
    arguments: Sequence[str], folder: Path, environment: Mapping[str, str], timeout_s: float
) -> subprocess.CompletedProcess[str]:
    """As `subprocess.run` does it, with both streams captured. Raises subprocess.TimeoutExpired."""
    with tempfile.TemporaryDirectory() as kept:
        files = [Path(kept) / name for name in ("out", "errors")]
        words = (list(arguments), str(folder), dict(environment), [str(file) for file in files])
        child = _CONTEXT.Process(target=_begin, args=words)
        child.start()
        child.join(timeout_s)
        if child.exitcode is None:
            child.kill()
            child.join()
            raise subprocess.TimeoutExpired(list(arguments), timeout_s)
        out, errors = (file.read_text(encoding="utf-8") if file.exists() else "" for file in files)
        return subprocess.CompletedProcess(list(arguments), child.exitcode, out, errors)


def _begin(arguments: list[str], folder: str, environment: dict[str, str], streams: list[str]) -> None:
    for number, stream in enumerate(streams, start=1):
        file = os.open(stream, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["xitl", *arguments]
    from xitl_cli.main import main

    main()
