"""The network namespace of an emulator: its process holds it, other processes enter it.

ssh starts this file as a program (ProxyCommand in `life.py`) in any environment. It therefore imports only the standard
library.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Sequence
from pathlib import Path

_CONNECT_S = 10.0


def emulator_process(pid_file: Path) -> int | None:
    """Return the process that wrote this file, None if it does not run."""
    try:
        pid = int(pid_file.read_text())
        command = Path(f"/proc/{pid}/cmdline").read_bytes()
    except (OSError, ValueError):
        return None
    return pid if str(pid_file).encode() in command.split(b"\0") else None


def shares_network(pid: int) -> bool:
    """Return True if this process and the given process are in the same network namespace."""
    return _is_same("net", pid)


def entered(pid: int, words: Sequence[str]) -> list[str]:
    """Return a command that runs these words, as this user, in the network namespace of another process."""
    user = () if _is_same("user", pid) else ("--user", "--preserve-credentials")
    return ["nsenter", "--target", str(pid), *user, "--net", "--", *words]


def _is_same(kind: str, pid: int) -> bool:
    return Path(f"/proc/self/ns/{kind}").samefile(f"/proc/{pid}/ns/{kind}")


def main(pid_file: str, host: str, port: str) -> None:
    """Connect to a port in the emulator's network, and pass the connection to ssh at standard output."""
    pid = emulator_process(Path(pid_file))
    if pid is None:
        sys.exit(f"{pid_file}: the emulator does not run")
    if not shares_network(pid):
        words = entered(pid, [sys.executable, "-IS", __file__, pid_file, host, port])
        os.execvp(words[0], words)
    with socket.create_connection((host, int(port)), _CONNECT_S) as connection, socket.socket(fileno=1) as ssh:
        connection.settimeout(None)
        socket.send_fds(ssh, [b"\0"], [connection.fileno()])


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except OSError as error:
        sys.exit(str(error.strerror or error))
