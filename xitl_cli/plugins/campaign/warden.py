"""The warden beside a worker process: ends the runs of one that is gone, also by kill -9.

It is told of each run at its standard input, `+ MARK FOLDER` and `- MARK FOLDER`; when that ends, so does every process
that carries the mark of a run under way. Started as a file by itself: it has the standard library alone.
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
"""In the environment of a run and of all that it starts."""
TEMPORARY = "xitl-campaign-run-"
"""How the folder of a run begins that nobody needs afterwards."""


def end_marked(mark: str) -> int:
    """End every process whose environment carries this mark; how many there were."""
    wanted, ended = f"{MARK}={mark}".encode(), 0
    for _ in range(3):  # what is being started meanwhile
        found = [pid for pid in _other_processes() if _environment_has(pid, wanted)]
        for pid in found:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
                ended += 1
        if not found:
            break
    return ended


def _other_processes() -> list[int]:
    return [int(name) for name in os.listdir("/proc") if name.isdigit() and int(name) != os.getpid()]  # noqa: PTH208


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
        what, mark, folder = line.rstrip("\n").split(" ", 2)
        if what == "+":
            runs[mark] = folder
        else:
            runs.pop(mark, None)
    for mark, folder in runs.items():
        end_marked(mark)
        time.sleep(0.1)
        end_marked(mark)  # what one of them was starting
        if Path(folder).name.startswith(TEMPORARY):
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
