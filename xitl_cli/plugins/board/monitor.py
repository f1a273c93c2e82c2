"""The emulator's monitor, QMP: one JSON object per line over a private socket of this user."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from types import TracebackType
from typing import Any

from xitl_cli.errors import UserError

TIMEOUT_S = 10.0


class EmulatorMonitor:
    """A connection to the monitor of a running emulator. Raises UserError if it does not answer."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(TIMEOUT_S)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise UserError(f"{path}: no emulator answers there ({error.strerror}); is the board started?") from None
        self._file = self._socket.makefile("rwb")
        self._read()
        self.do("qmp_capabilities")

    def do(self, command: str, **arguments: Any) -> Any:
        """Run a command of the monitor and return its result."""
        words: dict[str, Any] = {"execute": command}
        if arguments:
            words["arguments"] = {name.replace("_", "-"): value for name, value in arguments.items()}
        self._file.write(json.dumps(words).encode() + b"\n")
        self._file.flush()
        while True:
            answer = self._read()
            if "error" in answer:
                raise UserError(f"{self._path}: {command}: {answer['error'].get('desc', 'refused')}")
            if "return" in answer:
                return answer["return"]

    def _read(self) -> dict[str, Any]:
        try:
            line = self._file.readline()
            answer = json.loads(line)
        except (OSError, ValueError):
            raise UserError(f"{self._path}: the emulator stopped answering; is it still running?") from None
        return dict(answer)

    def close(self) -> None:
        """Close the connection. The emulator continues unchanged."""
        self._file.close()
        self._socket.close()

    def __enter__(self) -> EmulatorMonitor:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
