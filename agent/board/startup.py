"""Start of `xitl-agent.pyz`: serve a host, or run `doctor` or `install` on its board. Also notifies systemd."""

from __future__ import annotations

import os
import socket
from importlib import import_module
from typing import Callable, cast

COMMANDS = {"doctor": "agent.board.doctor", "install": "agent.board.install"}
"""Each module has a function `main(arguments, program)` that returns the exit code."""


def main(arguments: list[str], program: str) -> int:
    """Run the command that the first argument names. Without a command, serve as `python -m agent` does."""
    name = arguments[0] if arguments else ""
    module = COMMANDS.get(name, "agent.__main__")
    run = cast("Callable[[list[str], str], int]", import_module(module).main)
    if module == "agent.__main__":
        return run(arguments, program)
    return run(arguments[1:], f"{program} {name}")


def notify_ready() -> None:
    """Notify the service manager that the agent is ready. Do nothing when no service manager started this process."""
    address = os.environ.pop("NOTIFY_SOCKET", "")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        try:
            manager.sendto(b"READY=1", address)
        except OSError:
            return  # the service manager will report the timeout
