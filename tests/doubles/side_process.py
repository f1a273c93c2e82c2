"""A process beside a run whose part the test plays."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import IO

import pytest

from xitl_cli.pipe import Pipe
from xitl_cli.run.core import side_process


class SideProcessDouble:
    """Stands where one is spawned. at_start: what it does with its end of the pipe. words: on its standard error."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, at_start: Callable[[Pipe], object] = id, words: str = ""
    ) -> None:
        self._at_start = at_start
        self._words = words
        self._pipe: Pipe | None = None
        monkeypatch.setattr(side_process, "spawn", self._spawn)

    def _spawn(
        self,
        module: str,
        sockets: Sequence[socket.socket],
        words: IO[bytes],
        environment: Mapping[str, str] | None = None,
    ) -> subprocess.Popen[bytes]:
        self._pipe = Pipe.of_process(sockets[-1].dup())
        self._at_start(self._pipe)
        words.write(self._words.encode())
        return subprocess.Popen([sys.executable, "-S", "-c", ""])

    @property
    def pipe(self) -> Pipe:
        """The process's end."""
        assert self._pipe is not None
        return self._pipe

    def close(self) -> None:
        if self._pipe is not None:
            self._pipe.close()
