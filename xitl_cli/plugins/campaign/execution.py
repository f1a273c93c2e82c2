"""One run as one process within limits, and its result as a plain row. A Dask worker calls `run_point`.

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
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, BinaryIO, Protocol, TypeAlias

from sim_core.dataclass import dataclass
from xitl_cli.plugins.campaign import warden
from xitl_cli.plugins.campaign.figures import figures
from xitl_cli.plugins.campaign.run_server import RunServers
from xitl_cli.plugins.campaign.warden import MARK, PROC, TEMPORARY, end_marked

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
_OUTSIDE = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT")
"""Signals from outside of a process. The others are its own faults."""
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
        code, limit = _run_process(task, folder)
        try:
            summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            summary = None
        summary = summary if isinstance(summary, dict) else None
        status, error = _status(code, limit, summary, folder)
        row = {
            "number": task.number,
            "status": status,
            "exit_code": code,
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


def _run_process(task: RunTask, folder: Path) -> tuple[int, str | None]:
    """Start the run and wait for its end, or end it at a limit.

    Return its exit code, negative for a signal, and the status of the exceeded limit, None for none.
    """
    source = folder / BASE_FILE
    source.write_text(task.profile, encoding="utf-8")
    arguments = ["sim", str(source), *task.arguments, "--out", str(folder), "--overwrite"]
    mark = f"{task.campaign}-{uuid.uuid4().hex}"
    limit = None
    with (folder / ERRORS).open("wb") as errors, _watched_over(mark, str(folder)):
        process = _started(arguments, {**_environment(), MARK: mark}, errors)
        until_s = time.monotonic() + task.time_s
        try:
            while limit is None and not process.ends_within(min(_POLL_S, max(until_s - time.monotonic(), 0.0))):
                if time.monotonic() >= until_s:
                    limit = TIMEOUT
                elif task.memory_mb is not None and memory_of_tree_mb(process.pid) > task.memory_mb:
                    limit = MEMORY
        finally:
            end_marked(mark)
            code = process.wait()
            process.release()
    source.unlink(missing_ok=True)
    return code, limit


def _environment() -> dict[str, str]:
    return {**os.environ, **dict.fromkeys(_THREADS, "1")}


_servers = RunServers()


def prepare_for_runs() -> None:
    """Import the modules of a run in a process from which runs are forked, if possible, while the caller continues."""
    _servers.begin(_environment())


def end_preparation() -> None:
    """End the processes from which runs are forked, except those with a run."""
    _servers.close()


class RunProcess(Protocol):
    """The process of a run."""

    @property
    def pid(self) -> int:
        """Its number."""

    def ends_within(self, wait_s: float) -> bool:
        """Return True if the process ends within a number of seconds. It returns at once at the end."""

    def wait(self) -> int:
        """Wait for the end of the process. Return its exit code, negative for a signal."""

    def release(self) -> None:
        """Free the resources of an ended process."""


def _started(arguments: Sequence[str], environment: Mapping[str, str], errors: BinaryIO) -> RunProcess:
    """Start `xitl` with these arguments: forked from a prepared process, or as a fresh one where that is impossible."""
    return _servers.start(arguments, environment, errors) or FreshRun(arguments, environment, errors)


class FreshRun:
    """A run in a fresh process."""

    def __init__(self, arguments: Sequence[str], environment: Mapping[str, str], errors: BinaryIO) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "xitl_cli.main", *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
        )
        self.pid = self._process.pid
        self._handle: int | None = None
        with contextlib.suppress(AttributeError, OSError):
            self._handle = os.pidfd_open(self.pid)
            self._watcher = select.poll()
            self._watcher.register(self._handle, select.POLLIN)

    def ends_within(self, wait_s: float) -> bool:
        """See `RunProcess`. Without support of the kernel, it returns a little after the end."""
        if self._handle is not None:
            return bool(self._watcher.poll(wait_s * 1e3))
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(wait_s)
        return self._process.poll() is not None

    def wait(self) -> int:
        """See `RunProcess`."""
        return self._process.wait()

    def release(self) -> None:
        """See `RunProcess`."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


def memory_of_tree_mb(pid: int) -> float:
    """Return the resident memory of a process and its descendants, in megabytes (10^6 bytes)."""
    if not PROC.is_dir():
        import psutil  # type: ignore[import-untyped]

        size_bytes = 0
        with contextlib.suppress(psutil.Error):
            process = psutil.Process(pid)
            for member in (process, *process.children(recursive=True)):
                with contextlib.suppress(psutil.Error):
                    size_bytes += member.memory_info().rss
        return size_bytes / 1e6
    pages, left = 0, [pid]
    while left:
        process = left.pop()
        with contextlib.suppress(OSError, ValueError, IndexError):
            size = (PROC / f"{process}/statm").read_text().split()
            pages += int(size[1]) - int(size[2]) if process != pid else int(size[1])
            for thread in os.listdir(PROC / f"{process}/task"):  # noqa: PTH208 - names alone
                left += map(int, (PROC / f"{process}/task/{thread}/children").read_text().split())
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _status(code: int, limit: str | None, summary: dict[str, Any] | None, folder: Path) -> tuple[str, str | None]:
    """Return the status, and a sentence about a problem or an incomplete task."""
    if limit is not None:
        return limit, {TIMEOUT: "exceeded its time limit", MEMORY: "exceeded its memory limit"}[limit]
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
        return KILLED if name in _OUTSIDE else CRASHED, f"ended by {name}"
    error = None if summary is None else summary.get("error")
    if code in (0, 1) and summary is not None and error is None:
        return _EXIT_STATUS[code], left_undone(summary) if code else None
    if not error:  # the last line of the run's messages
        with contextlib.suppress(OSError):
            lines = (folder / ERRORS).read_bytes()[-4096:].decode(errors="replace").strip().splitlines()
            error = lines[-1].strip()[:_LONGEST_ERROR].removeprefix("error: ") if lines else ""
    if code == 1 or code not in _EXIT_STATUS or (code == 0 and summary is None):
        return CRASHED, error or f"exit code {code}"
    return _EXIT_STATUS[code], error or "interrupted"


def left_undone(summary: dict[str, Any]) -> str:
    """Return the progress of an incomplete run, and the warnings of the run and its companion."""
    verdict, companion = summary.get("verdict") or {}, summary.get("companion") or {}
    sentences = [verdict.get("why"), *(summary.get("warnings") or ()), *(companion.get("warnings") or ())]
    return "; ".join(str(sentence) for sentence in sentences if sentence)[:_LONGEST_ERROR]


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
                    [sys.executable, *(["-I", "-S"] if PROC.is_dir() else ["-I"]), warden.__file__],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    encoding="utf-8",
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
