"""One run as one subprocess within limits, and its result as a plain row. A Dask worker calls `run_point`.

All processes that a run starts end with it, in any session: all carry a mark in their environment. A warden process for
each worker process ends the runs of a killed worker.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeAlias

from xitl_cli.plugins.campaign import warden
from xitl_cli.plugins.campaign.figures import figures
from xitl_cli.plugins.campaign.warden import MARK, TEMPORARY, end_marked

Row: TypeAlias = dict[str, Any]

COMPLETED, INCOMPLETE, FAILED = "completed", "incomplete", "failed"
CRASHED, TIMEOUT, MEMORY, KILLED = "crashed", "timeout", "memory", "killed"
RAN = (COMPLETED, INCOMPLETE)
"""Statuses of runs that ended by themselves."""
RETRIED = (CRASHED, TIMEOUT, MEMORY, KILLED)
"""Statuses after which another attempt may succeed."""

SUMMARY, ERRORS, BASE_FILE = "summary.json", "stderr.txt", "base.yaml"
_POLL_S = 0.2
_LONGEST_ERROR = 500  # characters
_EXIT_STATUS = {0: COMPLETED, 1: INCOMPLETE, 2: FAILED, 130: KILLED}
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class RunTask:
    """Everything that a worker on any machine needs for a run."""

    number: int
    profile: str
    """Text of the profile without the axes."""
    name: str
    """Name of the profile."""
    arguments: tuple[str, ...]
    """Arguments of `xitl sim` after the profile."""
    keep: tuple[str, ...]
    """Figures to keep, by path."""
    time_s: float
    memory_mb: float | None
    directory: str | None
    """Folder of the run if it is kept, None for a temporary one."""
    campaign: str
    """Campaign of the run, by which its runs can be stopped."""
    whole: bool = False
    """The row also contains the whole summary."""


def run_point(task: RunTask) -> Row:
    """Carry out one run. Return its result with the requested figures.

    Keys of the result: number, status, exit_code (negative: a signal), error (a problem or an incomplete task, as a
    sentence), began (it left a summary), the figures by path, wall_s, and `summary` if requested. Raises OSError if the
    run's folder cannot be made.
    """
    begun_s = time.monotonic()
    folder = Path(tempfile.mkdtemp(prefix=TEMPORARY)) if task.directory is None else Path(task.directory)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        ended = _carried_out(task, folder)
        summary = _summary(folder)
        status, error = _judged(ended, summary, folder)
        row = {
            "number": task.number,
            "status": status,
            "exit_code": ended.code,
            "error": error,
            "began": summary is not None,
            **({"summary": summary} if task.whole else {}),
            **figures(summary, task.keep),
            "wall_s": round(time.monotonic() - begun_s, 3),
        }
    finally:
        if task.directory is None:
            shutil.rmtree(folder, ignore_errors=True)
    return row


@dataclass(frozen=True, slots=True)
class _Ended:
    """End of a run's process."""

    code: int
    """Exit code, negative for a signal."""
    limit: str | None
    """Status of the exceeded limit, None for none."""


def _carried_out(task: RunTask, folder: Path) -> _Ended:
    """Start the run and wait for its end, or end it at a limit."""
    source = folder / BASE_FILE
    source.write_text(task.profile, encoding="utf-8")
    command = [sys.executable, "-m", "xitl_cli.main", "sim", str(source), *task.arguments]
    command += ["--out", str(folder), "--overwrite"]
    mark = f"{task.campaign}-{uuid.uuid4().hex}"
    environment = {**os.environ, **dict.fromkeys(_THREADS, "1"), MARK: mark}
    with (folder / ERRORS).open("wb") as errors, _watched_over(mark, str(folder)):
        process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
        )
        try:
            limit = _waited_for(process, task.time_s, task.memory_mb)
        finally:
            end_marked(mark)
            process.wait()
    source.unlink(missing_ok=True)
    return _Ended(process.returncode, limit)


def _waited_for(process: subprocess.Popen[bytes], time_s: float, memory_mb: float | None) -> str | None:
    """Return the status of the exceeded limit, None if the process ended by itself."""
    until_s = time.monotonic() + time_s
    with _exit_notice(process) as notice:
        while not notice(min(_POLL_S, max(until_s - time.monotonic(), 0.0))):
            if time.monotonic() >= until_s:
                return TIMEOUT
            if memory_mb is not None and memory_of_tree_mb(process.pid) > memory_mb:
                return MEMORY
    return None


@contextlib.contextmanager
def _exit_notice(process: subprocess.Popen[bytes]) -> Iterator[Callable[[float], bool]]:
    """Yield a function that returns True if the process ends within a number of seconds. It returns at once at the end,
    if the kernel supports this.
    """
    try:
        handle = os.pidfd_open(process.pid)
    except (AttributeError, OSError):

        def poll(seconds: float) -> bool:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(seconds)
            return process.poll() is not None

        yield poll
        return
    watcher = select.poll()
    watcher.register(handle, select.POLLIN)
    try:
        yield lambda seconds: bool(watcher.poll(seconds * 1e3))
    finally:
        os.close(handle)


def memory_of_tree_mb(pid: int) -> float:
    """Return the resident memory of a process and its descendants, in megabytes (10^6 bytes)."""
    pages, left = 0, [pid]
    while left:
        one = left.pop()
        with contextlib.suppress(OSError, ValueError, IndexError):
            size = Path(f"/proc/{one}/statm").read_text().split()
            pages += int(size[1]) - int(size[2]) if one != pid else int(size[1])
            for thread in os.listdir(f"/proc/{one}/task"):  # noqa: PTH208 - names alone
                left += map(int, Path(f"/proc/{one}/task/{thread}/children").read_text().split())
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _summary(folder: Path) -> dict[str, Any] | None:
    try:
        found = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def _judged(ended: _Ended, summary: dict[str, Any] | None, folder: Path) -> tuple[str, str | None]:
    """Return the status, and a sentence about a problem or an incomplete task."""
    if ended.limit is not None:
        return ended.limit, {TIMEOUT: "over its time limit", MEMORY: "over its memory limit"}[ended.limit]
    if ended.code < 0:
        name = signal.Signals(-ended.code).name if -ended.code in set(signal.Signals) else str(-ended.code)
        outside = -ended.code in (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
        return KILLED if outside else CRASHED, f"ended by {name}"
    error = None if summary is None else summary.get("error")
    said = error or _last_line(folder / ERRORS).removeprefix("error: ")
    if ended.code in (0, 1) and summary is not None and error is None:
        return _EXIT_STATUS[ended.code], left_undone(summary) if ended.code else None
    if ended.code == 1 or ended.code not in _EXIT_STATUS or (ended.code == 0 and summary is None):
        return CRASHED, said or f"exit code {ended.code}"
    return _EXIT_STATUS[ended.code], said or "interrupted"


def left_undone(summary: dict[str, Any]) -> str:
    """Return the progress of an incomplete run, and the warnings of the run and its companion."""
    came, companion = summary.get("verdict") or {}, summary.get("companion") or {}
    said = [came.get("why"), *(summary.get("warnings") or ()), *(companion.get("warnings") or ())]
    return "; ".join(str(each) for each in said if each)[:_LONGEST_ERROR]


def _last_line(path: Path) -> str:
    try:
        lines = path.read_bytes()[-4096:].decode(errors="replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1].strip()[:_LONGEST_ERROR] if lines else ""


class _Warden:
    """A separate process that ends the marked runs when this process ends, also by kill -9."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pipe: IO[str] | None = None
        self._owner = 0

    def tell(self, line: str) -> None:
        with self._lock:
            if self._owner != os.getpid():
                process = subprocess.Popen(
                    [sys.executable, "-I", "-S", warden.__file__],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    text=True,
                    start_new_session=True,
                    env={key: value for key, value in os.environ.items() if key != MARK},
                )
                self._pipe, self._owner = process.stdin, os.getpid()
            assert self._pipe is not None
            with contextlib.suppress(OSError):
                self._pipe.write(line + "\n")
                self._pipe.flush()


_warden = _Warden()
_running: set[str] = set()


@contextlib.contextmanager
def _watched_over(mark: str, folder: str) -> Iterator[None]:
    _warden.tell(f"+ {mark} {folder}")
    _running.add(mark)
    try:
        yield
    finally:
        _running.discard(mark)
        _warden.tell(f"- {mark} {folder}")


def stop_runs(campaign: str) -> int:
    """End the runs of a campaign that this process carries out. Return the number of ended processes."""
    return sum(end_marked(mark) for mark in list(_running) if mark.startswith(f"{campaign}-"))
