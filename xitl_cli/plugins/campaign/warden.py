"""The warden of a worker process: ends the runs of a worker that has ended, also by kill -9.

It reads the start and end of each run from its standard input, `+ MARK FOLDER` and `- MARK FOLDER`. When the input
ends, the warden ends every process with the mark of an active run. It starts as a single file and imports only the
standard library on Linux, which shows the environment of each process below /proc. Elsewhere, psutil reads it.
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
PROC = Path("/proc")
"""Linux shows its processes there."""


def end_marked(mark: str) -> int:
    """End every process with this mark in its environment. Return their number."""
    end_all = _end_all if PROC.is_dir() else _end_all_by_psutil
    ended: set[int] = set()
    for _ in range(3):  # processes may start meanwhile, and one that ends is seen for some time
        found = end_all(mark)
        ended |= found
        if not found:
            break
    return len(ended)


def _end_all(mark: str) -> set[int]:
    wanted, ended = f"{MARK}={mark}".encode(), set[int]()
    for name in os.listdir(PROC):  # noqa: PTH208
        if name.isdigit() and int(name) != os.getpid() and _environment_has(int(name), wanted):
            with contextlib.suppress(OSError):
                os.kill(int(name), signal.SIGKILL)
                ended.add(int(name))
    return ended


def _end_all_by_psutil(mark: str) -> set[int]:
    import psutil  # type: ignore[import-untyped]

    ended: set[int] = set()
    for process in psutil.process_iter(["environ", "status"]):  # other users' processes have no environ
        marked = (process.info["environ"] or {}).get(MARK) == mark and process.pid != os.getpid()
        if marked and process.info["status"] != psutil.STATUS_ZOMBIE:
            with contextlib.suppress(psutil.Error):
                process.kill()
                ended.add(process.pid)
    return ended


def _environment_has(pid: int, wanted: bytes) -> bool:
    try:
        if (PROC / f"{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
            return False
        environment = (PROC / f"{pid}/environ").read_bytes()
    except OSError:
        return False
    return environment.startswith(wanted) or b"\0" + wanted in environment


def main() -> None:
    """Wait for the end of the worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    runs: dict[str, str] = {}
    for line in sys.stdin.buffer:
        event, mark, folder = line.decode().rstrip("\r\n").split(" ", 2)
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
