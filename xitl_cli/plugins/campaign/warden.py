"""The warden of a worker process: ends the runs of a worker that has ended, also by kill -9.

It reads the start and end of each run from its standard input, `+ MARK FOLDER` and `- MARK FOLDER`. When the input
ends, the warden ends every process with the mark of an active run. It starts as a single file and imports only the
standard library.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import time
from pathlib import Path

MARK = "XITL_CAMPAIGN_RUN"
"""Variable in the environment of a run and of all its descendants."""
TEMPORARY = "xitl-campaign-run-"
"""Prefix of the folder of a run that is deleted afterwards."""


def end_marked(mark: str) -> int:
    """End every process with this mark in its environment. Return their number."""
    wanted, ended = f"{MARK}={mark}".encode(), 0
    for _ in range(3):  # processes may start meanwhile
        others = [int(name) for name in os.listdir("/proc") if name.isdigit() and int(name) != os.getpid()]  # noqa: PTH208
        marked = [pid for pid in others if _environment_has(pid, wanted)]
        for pid in marked:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
                ended += 1
        if not marked:
            break
    return ended


def _environment_has(pid: int, wanted: bytes) -> bool:
    try:
        if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
            return False
        environment = Path(f"/proc/{pid}/environ").read_bytes()
    except OSError:
        return False
    return environment.startswith(wanted) or b"\0" + wanted in environment


def main() -> None:
    """Wait for the end of the worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    runs: dict[str, str] = {}
    for line in sys.stdin:
        event, mark, folder = line.rstrip("\n").split(" ", 2)
        if event == "+":
            runs[mark] = folder
        else:
            runs.pop(mark, None)
    for mark, folder in runs.items():
        end_marked(mark)
        time.sleep(0.1)
        end_marked(mark)  # processes that a run was starting
        if Path(folder).name.startswith(TEMPORARY):
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
