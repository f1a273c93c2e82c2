"""The firmware cache, CACHE/firmware/VEHICLE/VERSION/BOARD/, and the search for a program that runs here.

CACHE is that of xitl_cli.cache. VERSION is the requested version: `stable`, `beta`, `latest` or numbers. A record of
the file's origin is in the same folder. A file that the user copied there counts too.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import shutil
import struct
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.cache import cache_root
from xitl_cli.errors import UserError
from xitl_cli.paths import user_path

PROGRAMS = {"rover": "ardurover", "plane": "arduplane", "copter": "arducopter", "sub": "ardusub"}
"""Name of the firmware as a program, by vehicle. Images for boards add a suffix."""

SITL, SITL_ARMHF = "sitl", "sitl-armhf"
SIMULATED = (SITL, SITL_ARMHF)
RECORD = "firmware.json"
FIND = "find"
PX4_VARIABLE = "XITL_PX4"
ROVER_VARIABLES = {"sitl": "XITL_ARDUROVER", "linux": "XITL_ARDUROVER_LINUX"}
"""Environment variables for the program, by build."""
IMAGE_SUFFIX = ".apj"
_MOVING = {"stable": 3, "beta": 1, "latest": 0}
_NUMBERED = re.compile(r"\d+\.\d+\.\d+")
# ELF machines that a processor runs, by the kernel's name of the processor.
_MACHINES = {"x86_64": (62, 3), "aarch64": (183, 40), "armv7l": (40,), "armv6l": (40,), "i686": (3,)}


@dataclass(frozen=True, slots=True)
class FirmwareRecord:
    """Origin of a file. Empty strings are unknown."""

    url: str = ""
    sha256: str = ""
    size: int = 0
    version: str = ""
    git: str = ""
    verified: tuple[str, ...] = ()
    """Checks that the file passed, in words."""


@dataclass(frozen=True, slots=True)
class CachedFirmware:
    """One firmware in the cache."""

    vehicle: str
    version: str
    board: str
    file: Path
    record: FirmwareRecord

    @property
    def is_program(self) -> bool:
        """Whether it is a program, not an image for a board."""
        return self.file.suffix != IMAGE_SUFFIX


def firmware_root() -> Path:
    """Return the root folder, which need not exist."""
    return cache_root() / "firmware"


def cache_folder(vehicle: str, version: str, board: str) -> Path:
    """Return the folder for a firmware, which need not exist."""
    return firmware_root() / vehicle / version / board


def file_names(vehicle: str, board: str) -> tuple[str, ...]:
    """Return the possible file names: a program, or an image for a board that runs no programs."""
    program_name = PROGRAMS[vehicle]
    return (program_name,) if board in SIMULATED else (program_name + IMAGE_SUFFIX, program_name)


def list_cached(vehicle: str | None = None) -> list[CachedFirmware]:
    """Return all cached firmware of one vehicle or of all. Stable versions are first, then the newest numbers."""

    def rank(version: str) -> tuple[int, int, int, int]:
        """Return a rank, the larger the better: stable, then numbers, then beta and latest."""
        if _NUMBERED.fullmatch(version):
            major, minor, patch = (int(part) for part in version.split("."))
            return (2, major, minor, patch)
        return (_MOVING.get(version, -1), 0, 0, 0)

    cached = []
    for folder in sorted(firmware_root().glob(f"{vehicle or '*'}/*/*")):
        name, version, board = folder.parent.parent.name, folder.parent.name, folder.name
        for file in file_names(name, board) if name in PROGRAMS else ():
            if (folder / file).is_file():
                cached.append(CachedFirmware(name, version, board, folder / file, read_record(folder)))
    return sorted(cached, key=lambda entry: (entry.vehicle, *(-part for part in rank(entry.version)), entry.board))


def find_cached(vehicle: str, version: str, board: str) -> CachedFirmware | None:
    """Return one firmware of the cache, or None."""
    cached = list_cached(vehicle)
    return next((entry for entry in cached if (entry.version, entry.board) == (version, board)), None)


def find_program(vehicle: str, build: str) -> Path | None:
    """Return the program for a build, `sitl` or `linux`, that this machine can run; None when there is none.

    Raises UserError for a program that changed since it was downloaded.
    """
    for entry in list_cached(vehicle):
        if entry.is_program and (entry.board in SIMULATED) == (build == SITL) and runs_here(entry.file):
            if entry.record.sha256 and sha256(entry.file) != entry.record.sha256:
                raise UserError(
                    f"{entry.file} has changed since its download: its SHA-256 differs from {RECORD}; "
                    f"run `xitl firmware get {vehicle} --version {entry.version} --overwrite`"
                )
            return entry.file
    return None


def sha256(file: Path) -> str:
    """Return the hexadecimal digest of a file."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def find_firmware(vehicle: str, build: str, given: str = FIND) -> Path:
    """Return the program of `vehicle` (`rover`) for `build`, `sitl` or `linux`.

    `given` is its path, or `find`. `find` searches XITL_ARDUROVER (XITL_ARDUROVER_LINUX for a Linux build), then the
    PATH, then the cache. On the PATH, the name of a Linux build ends in `-linux`. Raises UserError when no program runs
    here.
    """
    if given != FIND:
        return _checked_program(user_path(given))
    variable = named_by(vehicle, build)
    if variable is not None:
        return _checked_program(user_path(os.environ[variable]), variable)
    name = PROGRAMS[vehicle] if build == SITL else f"{PROGRAMS[vehicle]}-linux"
    on_path = shutil.which(name)
    program = Path(on_path) if on_path is not None else find_program(vehicle, build)
    if program is not None:
        return program.absolute()
    if build == SITL:
        raise UserError(
            f"autopilot.firmware: {name} is neither on the PATH nor in the cache; "
            f"run `xitl firmware get {vehicle}`, or give its path with --firmware or in {ROVER_VARIABLES[build]}"
        )
    raise UserError(
        f"autopilot.firmware: {name} is neither on the PATH nor in the cache; build ArduPilot for the board `linux` "
        "(or for this machine's board) and give the path of its program with --firmware"
    )


def named_by(vehicle: str, build: str) -> str | None:
    """Return the environment variable with the program of `vehicle`; None when none is set."""
    variable = ROVER_VARIABLES[build] if vehicle == "rover" else ""
    return variable if os.environ.get(variable) else None


def find_px4(given: str = FIND) -> tuple[Path, Path]:
    """Return a PX4 for simulation and the folder of its start scripts: `etc`, next to the folder of the program.

    `given` is the program's path, or `find`. `find` searches XITL_PX4, then the PATH. Raises UserError when no program
    runs here.
    """
    variable = os.environ.get(PX4_VARIABLE) if given == FIND else None
    named = variable or shutil.which("px4") if given == FIND else given
    if not named:
        raise UserError(
            f"autopilot.firmware: px4 is not on the PATH, and {PX4_VARIABLE} is not set; build PX4 with "
            "`make px4_sitl_default` and give the path of its bin/px4 with --firmware"
        )
    program = _checked_program(user_path(named), PX4_VARIABLE if variable else _KEY)
    data = program.resolve().parent.parent / "etc"
    if not (data / "init.d-posix" / "rcS").is_file():
        raise UserError(
            f"autopilot.firmware: {data / 'init.d-posix' / 'rcS'} is missing, the start script of {program}; give the "
            "bin/px4 of a PX4 built for simulation, with the folder etc next to bin"
        )
    return program, data


def runs_here(file: Path) -> bool:
    """Whether it is executable and an ELF program for this machine's processor, or a script."""
    try:
        with file.open("rb") as opened:
            head = opened.read(20)
    except OSError:
        return False
    if not os.access(file, os.X_OK):
        return False
    if head[:2] == b"#!":
        return True
    if len(head) < 20 or head[:4] != b"\x7fELF":
        return False
    order = ">" if head[5] == 2 else "<"
    (machine,) = struct.unpack_from(order + "H", head, 18)
    return machine in _MACHINES.get(platform.machine(), (machine,))


def read_record(at: Path) -> FirmwareRecord:
    """Return the record in a folder; an empty record when it is missing or unreadable."""
    try:
        read = json.loads((at / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return FirmwareRecord()
    if not isinstance(read, dict):
        return FirmwareRecord()
    defaults = asdict(FirmwareRecord())
    known = {name: value for name, value in read.items() if name in defaults and type(value) is type(defaults[name])}
    verified = read.get("verified")
    checked = tuple(map(str, verified)) if isinstance(verified, list) else ()
    return FirmwareRecord(**{**known, "verified": checked})


def record_text(record: FirmwareRecord) -> str:
    """Return the text of the record's file."""
    written: dict[str, Any] = asdict(record)
    return json.dumps(written, indent=2, ensure_ascii=False) + "\n"


_KEY = "autopilot.firmware"


def _checked_program(path: Path, key: str = _KEY) -> Path:
    """Return the path of a program.

    key: its source, for errors. Raises UserError for a file that this machine cannot run.
    """
    if path.is_dir():
        raise UserError(f"{key}: {path} is a directory; give the path of the program in it")
    if not path.exists():
        raise UserError(f"{key}: {path} does not exist; check the path, or use `find`")
    try:
        with path.open("rb") as opened:
            is_program = opened.read(4).startswith((b"#!", b"\x7fELF"))
    except OSError:  # an unreadable file may be a program
        is_program = True
    if not path.is_file() or not is_program:
        raise UserError(f"{key}: {path} is not a program; give the path of the program")
    if not os.access(path, os.X_OK):
        raise UserError(f"{key}: {path} is not executable; run `chmod +x {path}`")
    if not runs_here(path):
        raise UserError(
            f"{key}: {path} is a program for another processor; use one for this machine, for instance of "
            "`xitl firmware get rover`"
        )
    return path.absolute()
