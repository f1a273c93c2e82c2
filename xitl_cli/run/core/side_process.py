"""A process that runs next to a run, such as its view or its bridge to ROS, and the pipe to it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import IO, Any

from xitl_cli.errors import UserError
from xitl_cli.pipe import Pipe, PipeClosedError

LONGEST_REASON = 200


def spawn(
    module: str, sockets: Sequence[socket.socket], words: IO[bytes], environment: Mapping[str, str] | None = None
) -> subprocess.Popen[bytes]:
    """Start `python -m module NUMBER…`, with the numbers of the `sockets` that it inherits.

    words: file for its standard error. environment: variables that this process does not set itself.

    The process gets a new session, because Ctrl-C is for the run alone. Raises UserError on Windows, where a process
    inherits no socket.
    """
    if os.name == "nt":
        raise UserError(
            "Windows: the live view, ROS and cameras of a run need Linux or macOS; run without them, then use "
            "`xitl view`"
        )
    numbers = [inherited.fileno() for inherited in sockets]
    return subprocess.Popen(
        [sys.executable, "-m", module, *map(str, numbers)],
        pass_fds=numbers,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=words,
        start_new_session=True,
        env=dict(environment or {})
        | os.environ
        | {"PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
    )


class SideProcess:
    """A process with a pipe. Before its start and after its end, `send` discards messages.

    `receive` returns what the process sent before its end, also if `send` noticed the end first.

    on_loss: called once when the process ends early, with " (why)", or an empty string if the reason is unknown.
    patience_s: time that the process may take to end. environment: see `spawn`.
    """

    def __init__(
        self,
        module: str,
        on_loss: Callable[[str], object],
        patience_s: float,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._module = module
        self._environment = environment
        self._on_loss = on_loss
        self._patience_s = patience_s
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Pipe | None = None
        self._words: IO[bytes] | None = None
        self._unread: list[Any] = []

    def start(self, sockets: Sequence[socket.socket] = ()) -> None:
        """Start the process. Its arguments are the numbers of `sockets` and, last, of its end of the pipe."""
        ours, theirs = socket.socketpair()
        self._words = tempfile.TemporaryFile()  # noqa: SIM115  # read when the process has ended
        with theirs:
            self._process = spawn(self._module, [*sockets, theirs], self._words, self._environment)
        self._pipe = Pipe.of_run(ours)

    @property
    def gone(self) -> bool:
        """Whether the process is not running."""
        return self._pipe is None

    @property
    def waiting_bytes(self) -> int:
        """Bytes that its pipe has not accepted yet."""
        return 0 if self._pipe is None else self._pipe.waiting_bytes

    @property
    def taken_bytes(self) -> int:
        """Bytes that its pipe has accepted so far."""
        return 0 if self._pipe is None else self._pipe.taken_bytes

    def send(self, message: Any) -> None:
        """Send without waiting: see Pipe."""
        if self._pipe is not None:
            try:
                self._pipe.send(message)
            except PipeClosedError:
                self._lose()

    def receive(self, timeout_s: float = 0.0) -> list[Any]:
        """Return all messages that have arrived, after at most `timeout_s`."""
        if self._unread or self._pipe is None:
            unread, self._unread = self._unread, []
            return unread
        try:
            return self._pipe.receive(timeout_s)
        except PipeClosedError:
            self._lose()
            return []

    def receive_last(self) -> Iterator[Any]:
        """Yield the messages that the process sends while it ends, at most until its patience is over."""
        until_s = time.monotonic() + self._patience_s
        while self._pipe is not None and time.monotonic() < until_s:
            try:
                yield from self._pipe.receive(0.05)
            except PipeClosedError:
                self._disconnect()

    def close(self) -> None:
        """Send the remaining messages and give the process time to end; kill it after that.

        A second call does nothing.
        """
        until_s = time.monotonic() + self._patience_s
        process, pipe, self._process = self._process, self._pipe, None
        if process is not None:
            with suppress(PipeClosedError):
                while pipe is not None and process.poll() is None and time.monotonic() < until_s:
                    pipe.receive(0.02)
                    if not pipe.waiting_bytes:
                        pipe.close_sending()
            self._disconnect()
            try:
                process.wait(max(until_s - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if self._words is not None:
            self._words.close()

    def _lose(self) -> None:
        """Report the loss with the signal that ended the process, otherwise with its last line of output."""
        assert self._process is not None
        assert self._words is not None
        assert self._pipe is not None
        with suppress(PipeClosedError):
            self._unread = self._pipe.receive()
        self._disconnect()
        try:
            code = self._process.wait(self._patience_s)
        except subprocess.TimeoutExpired:
            self._on_loss("")
            return
        reason = f"signal {-code}"
        if code >= 0:
            self._words.seek(0)
            lines = self._words.read().decode(errors="replace").strip().splitlines()
            reason = lines[-1].strip()[:LONGEST_REASON] if lines else ""
        self._on_loss(f" ({reason})" if reason else "")

    def _disconnect(self) -> None:
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
