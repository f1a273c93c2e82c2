"""What `xitl-agent.pyz` does: serve a host, or `doctor` and `install` for the board it is on."""

from __future__ import annotations

from importlib import import_module
from typing import Callable, cast

COMMANDS = {
    "doctor": "agent.board.doctor",
    "install": "agent.board.install",
}
"""Each module has a `main(arguments, program)` that returns the exit code."""


def main(arguments: list[str], program: str) -> int:
    """Run what the first argument names; without such a name serve, as `python -m agent` does."""
    name = arguments[0] if arguments else ""
    module = COMMANDS.get(name, "agent.__main__")
    run = cast("Callable[[list[str], str], int]", import_module(module).main)
    if module == "agent.__main__":
        return run(arguments, program)
    return run(arguments[1:], f"{program} {name}")
