"""The program of an autopilot that runs on this machine: given by path, on the PATH, or in the cache."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import PROGRAMS, SITL, program, runs_here

FIND = "find"


def find_firmware(vehicle: str, build: str, given: str = FIND) -> Path:
    """The program of `vehicle` (`rover`) for `build`, `sitl` or `linux`.

    `given` is its path, or `find` to look on the PATH and then in the cache. On the PATH a Linux build is the one whose
    name ends in `-linux`. Raises UserError when there is none that runs here.
    """
    if given != FIND:
        return _checked(Path(given).expanduser())
    name = PROGRAMS[vehicle] if build == SITL else f"{PROGRAMS[vehicle]}-linux"
    on_path = shutil.which(name)
    found = Path(on_path) if on_path is not None else program(vehicle, build)
    if found is not None:
        return found.absolute()
    if build == SITL:
        raise UserError(
            f"autopilot.firmware: there is no {name} on the PATH or in the cache; "
            f"run `xitl firmware get {vehicle}`, or give its path with --firmware"
        )
    raise UserError(
        f"autopilot.firmware: there is no {name} on the PATH or in the cache; build ArduPilot for the board `linux` "
        "(or for this machine's board) and give the path of its program with --firmware"
    )


def _checked(path: Path) -> Path:
    if not path.is_file():
        raise UserError(f"autopilot.firmware: {path} does not exist; check the path, or use `find`")
    if not os.access(path, os.X_OK):
        raise UserError(f"autopilot.firmware: {path} is not executable; run `chmod +x {path}`")
    if not runs_here(path):
        raise UserError(
            f"autopilot.firmware: {path} is no program for this machine's processor; "
            "use one that is, for instance of `xitl firmware get rover`"
        )
    return path.absolute()
