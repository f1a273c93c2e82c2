"""An autopilot as a separate process on this machine: starts, monitors and stops it, and finds its log."""

from __future__ import annotations

import ctypes
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from xitl_cli.errors import UserError

CONSOLE = "console.txt"
STOP_S = 5.0
_POLL_S = 0.02
_LOOK_S = 0.002
_LAST_BYTES = 4096
_MOST_LINES = 2
_ROUTINE = re.compile(
    r"Skipping port|Starting|Setting |Suggested |Using |Home: |bind port|SERIAL\d+ on |JSON control interface|"
    r"Creating model|validate_structures|Loaded defaults|Waiting for |Connection on |Exitting$"
)
"""Output of ArduPilot at every start, and at a normal end."""
_TROUBLE = re.compile(
    r"panic|error|fail|fault\b|abort|assert|exception|unable|cannot|can't|could not|unknown|invalid|unrecogni[sz]ed|"
    r"not found|no such|denied|in use|out of|bad ",
    re.IGNORECASE,
)
_PR_SET_PDEATHSIG = 1


class FirmwareProcess:
    """`program` running in `directory`, with its output in console.txt. It ends with this process at the latest.

    environment: its environment, None for that of this process. Raises UserError when it cannot be started.
    """

    def __init__(
        self, program: Path, arguments: Sequence[str], directory: Path, environment: Mapping[str, str] | None = None
    ) -> None:
        self.program = program
        self.directory = directory
        self._console = directory / CONSOLE
        self._stopped = False
        try:
            with self._console.open("wb") as console:
                self._process = subprocess.Popen(
                    [str(program), *arguments],
                    cwd=directory,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=console,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                    preexec_fn=_dies_with_parent(),
                )
        except OSError as error:
            raise UserError(
                f"autopilot.firmware: {program} cannot be started ({error.strerror}); check that it is a program for "
                "this machine"
            ) from error

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def ended_in_order(self) -> bool:
        """Whether it has ended with exit code 0."""
        return self._process.poll() == 0

    def check(self) -> None:
        """Raise UserError when it has ended by itself, with its last lines on the cause."""
        code = self._process.poll()
        if code is None or self._stopped:
            return
        how = f"signal {-code} ended it" if code < 0 else f"exit code {code}"
        lines = "; ".join(self.telling_lines())
        raise UserError(
            f"{self.program.name} ended by itself ({how})"
            + (f"; its last output: {lines}" if lines else "")
            + f"; see {self._console}"
        )

    def wait_for(self, *words: str, timeout_s: float) -> bool:
        """Return True once one of the words is on its console, False after the timeout.

        Raises UserError if it ends before.
        """
        until_s = time.monotonic() + timeout_s
        while True:
            text = self.console_text()
            if any(word in text for word in words):
                return True
            self.check()
            if time.monotonic() > until_s:
                return False
            time.sleep(_POLL_S)

    def console_text(self) -> str:
        """Return the whole output."""
        return self._console.read_text(errors="replace")

    def last_line(self) -> str:
        """Return the last line of output; empty without any."""
        return next(iter(self._last_lines()), "")

    def telling_lines(self) -> list[str]:
        """Return the last lines that report trouble, oldest first; otherwise the last line that is not routine.

        The very last line seldom has the cause. ArduPilot's standard output reaches the console only at its end, after
        its standard error.
        """
        lines = [line for line in self._last_lines() if not _ROUTINE.match(line)]
        trouble = list(dict.fromkeys(line for line in lines if _TROUBLE.search(line)))[:_MOST_LINES]
        return trouble[::-1] or lines[:1]

    def _last_lines(self) -> list[str]:
        """Return the last lines, newest first, without empty ones."""
        try:
            with self._console.open("rb") as console:
                console.seek(0, os.SEEK_END)
                console.seek(max(console.tell() - _LAST_BYTES, 0))
                lines = console.read().decode(errors="replace").split("\n")
        except OSError:
            return []
        return [line.strip() for line in reversed(lines) if line.strip()]

    def stop(self, patience_s: float = STOP_S, meanwhile: Callable[[float], object] = time.sleep) -> None:
        """End the process, first with SIGTERM, and with SIGKILL after `patience_s`. Safe to call again.

        meanwhile: called with seconds to wait until it has ended, for a program that reacts only while it is served.
        """
        self._stopped = True
        if self._process.poll() is None:
            self._signal(signal.SIGTERM)
            until_s = time.monotonic() + patience_s
            while self._process.poll() is None and time.monotonic() < until_s:
                meanwhile(_LOOK_S)
        self._signal(signal.SIGKILL)  # for its child processes
        self._process.wait()

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)


def newest_log(directory: Path, suffix: str = ".bin") -> Path | None:
    """Return the latest log under the directory, with a number or a time as its name; None when there is none."""
    logs = [path for path in directory.rglob("*") if path.suffix.lower() == suffix and path.stem[:1].isdigit()]
    logs = [path for path in logs if path.stat().st_size]
    return max(logs, key=lambda path: (path.stat().st_mtime_ns, path.name), default=None)


def _dies_with_parent() -> Callable[[], None] | None:
    """Return a function for the new process that ends it when the host ends. None on other systems than Linux."""
    if sys.platform != "linux":
        return None
    prctl = ctypes.CDLL(None).prctl
    parent = os.getpid()

    def bind() -> None:
        prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)

    return bind
