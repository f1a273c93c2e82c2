"""Location of the files that xitl ships: inside the installed package, or next to it in a source tree."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from xitl_cli.errors import UserError


def profiles_dir() -> Path:
    """Return the folder of the shipped profiles."""
    return _shipped("profiles")


def campaigns_dir() -> Path:
    """Return the folder of the shipped campaign plans."""
    return _shipped("campaigns")


def firmware_params_dir() -> Path:
    """Return the folder of the shipped parameter files (`*.parm`)."""
    return _shipped("firmware_params")


def _shipped(folder: str) -> Path:
    return _beside(__file__, folder)


@cache
def _beside(file: str, folder: str) -> Path:
    package = Path(file).resolve().parent
    for candidate in (package / "shipped" / folder, package.parent / folder):
        if candidate.is_dir():
            return candidate
    raise UserError(f"{package / 'shipped' / folder} is missing; install xitl again")
