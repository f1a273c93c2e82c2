"""Where firmware that was brought here is kept: CACHE/firmware/VEHICLE/VERSION/BOARD/, one program or image each.

CACHE is XITL_CACHE, else XDG_CACHE_HOME/xitl, else ~/.cache/xitl. VERSION is what was asked for: `stable`, `beta`,
`latest` or numbers. Beside the file lies a record of where it is from. A file that was put there by hand counts too.
"""

from __future__ import annotations

import json
import os
import platform
import re
import struct
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

PROGRAMS = {"rover": "ardurover", "plane": "arduplane", "copter": "arducopter", "sub": "ardusub"}
"""By vehicle, what its firmware is called on machines that run it as a program; images for boards add a suffix."""

SITL, SITL_ARMHF = "sitl", "sitl-armhf"
SIMULATED = (SITL, SITL_ARMHF)
RECORD = "firmware.json"
IMAGE_SUFFIX = ".apj"
_MOVING = {"stable": 3, "beta": 1, "latest": 0}
_NUMBERED = re.compile(r"\d+\.\d+\.\d+")
# ELF: machines that a processor runs, by what the kernel calls the processor.
_MACHINES = {"x86_64": (62, 3), "aarch64": (183, 40), "armv7l": (40,), "armv6l": (40,), "i686": (3,)}


@dataclass(frozen=True, slots=True)
class Record:
    """Where a file is from. Empty strings are unknown; `verified` says in words what was checked."""

    url: str = ""
    etag: str = ""
    sha256: str = ""
    size: int = 0
    version: str = ""
    git: str = ""
    verified: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Kept:
    """One firmware in the cache."""

    vehicle: str
    version: str
    board: str
    file: Path
    record: Record

    @property
    def is_program(self) -> bool:
        """Whether it is a program, not an image for a board."""
        return self.file.suffix != IMAGE_SUFFIX


def firmware_root() -> Path:
    """The folder that holds all; it need not exist."""
    return _cache() / "firmware"


def folder(vehicle: str, version: str, board: str) -> Path:
    """Where the one firmware belongs; it need not exist."""
    return firmware_root() / vehicle / version / board


def names(vehicle: str, board: str) -> tuple[str, ...]:
    """What the file may be called there: a program, or an image for a board that runs no programs."""
    program_name = PROGRAMS[vehicle]
    return (program_name,) if board in SIMULATED else (program_name + IMAGE_SUFFIX, program_name)


def kept(vehicle: str | None = None) -> list[Kept]:
    """All that is there, of one vehicle or of all; a stable version first, then the newest numbers."""
    found = [
        Kept(at.parent.parent.name, at.parent.name, at.name, file, read_record(at))
        for at in sorted(firmware_root().glob(f"{vehicle or '*'}/*/*"))
        for file in _files(at)
    ]
    return sorted(found, key=lambda one: (one.vehicle, *(-part for part in _rank(one.version)), one.board))


def program(vehicle: str, build: str) -> Path | None:
    """The program to start for a build, `sitl` or `linux`, that this machine can run; None when there is none."""
    for one in kept(vehicle):
        if one.is_program and (one.board in SIMULATED) == (build == SITL) and runs_here(one.file):
            return one.file
    return None


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


def read_record(at: Path) -> Record:
    """The record in a folder; an empty one where there is none, or none that can be read."""
    try:
        read = json.loads((at / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return Record()
    if not isinstance(read, dict):
        return Record()
    defaults = asdict(Record())
    known = {name: value for name, value in read.items() if name in defaults and type(value) is type(defaults[name])}
    verified = read.get("verified")
    checked = tuple(map(str, verified)) if isinstance(verified, list) else ()
    return Record(**{**known, "verified": checked})


def record_text(record: Record) -> str:
    """The record as it is written."""
    written: dict[str, Any] = asdict(record)
    return json.dumps(written, indent=2, ensure_ascii=False) + "\n"


def _cache() -> Path:
    own = os.environ.get("XITL_CACHE")
    if own:
        return Path(own).expanduser()
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "xitl"


def _files(at: Path) -> Iterator[Path]:
    vehicle = at.parent.parent.name
    for name in names(vehicle, at.name) if vehicle in PROGRAMS else ():
        if (at / name).is_file():
            yield at / name


def _rank(version: str) -> tuple[int, int, int, int]:
    """The larger the better: stable, then numbers, then what is being tried out."""
    if _NUMBERED.fullmatch(version):
        major, minor, patch = (int(part) for part in version.split("."))
        return (2, major, minor, patch)
    return (_MOVING.get(version, -1), 0, 0, 0)
