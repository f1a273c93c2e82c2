"""The run directory: run.mcap, summary.json, the resolved profile, the autopilot's log and a companion's map."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

from xitl_cli.errors import UserError

RECORDING = "run.mcap"
SUMMARY = "summary.json"
PROFILE = "profile.yaml"
DATAFLASH = "autopilot.bin"
ULOG = "autopilot.ulg"
MISSION = "mission.waypoints"  # mission that a ground station uploaded
MAP, TRAJECTORY, TRUTH = "map.ply", "trajectory.tum", "truth.tum"  # files of a companion, and the true trajectory
AUTOPILOT = "autopilot"  # a folder: the working directory of an autopilot that the run started
RESERVED_BYTES = 256 * 1024
_OF_A_VESSEL = (DATAFLASH, ULOG, MISSION, MAP, TRAJECTORY, TRUTH, AUTOPILOT)
_FILES = (RECORDING, SUMMARY, PROFILE, *_OF_A_VESSEL)
"""A fleet has one folder for each vessel, with the files of that vessel."""
_NEXT_RECORDING = re.compile(r"run-[0-9]{3,}\.mcap")
"""Later files of a split recording."""


def check_writable(path: Path) -> None:
    """Raise UserError when a run cannot be kept in `path`; create nothing."""
    folder = path
    while not _exists(folder):
        folder = folder.parent
    if not folder.is_dir():
        raise UserError(f"{folder} is a file, not a directory; choose another --out")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UserError(f"{folder} is not writable; choose another --out or change its permissions")


def _exists(path: Path) -> bool:
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except (OSError, ValueError) as error:  # not a valid file name, or a path that this user may not read
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise UserError(f"{_shown(path)} cannot be used ({reason}); choose another --out") from error
    return True


def _shown(path: Path) -> str:
    text = str(path)
    return text if len(text) <= 120 else f"{text[:80]}… ({len(text)} characters)"


def check_free(path: Path, overwrite: bool, vessels: Sequence[str] = ()) -> list[str]:
    """Return the names of an earlier run in `path` that may be deleted; create nothing.

    Raises UserError when a run cannot be kept there, or when `path` holds an earlier run and `overwrite` is False.
    """
    check_writable(path)
    for name in vessels:
        if _exists(path / name) and not _is_of_a_vessel(path / name):
            raise UserError(f"{path / name} contains files that are not of a vessel's run; choose another --out")
    present = [name for name in _FILES if _exists(path / name)] + next_recordings(path)
    folders = set(vessels)
    if _exists(path / PROFILE):  # an earlier run, perhaps of other vessels
        folders |= {entry.name for entry in path.iterdir() if entry.name not in _FILES and _is_of_a_vessel(entry)}
    present += sorted(name for name in folders if _exists(path / name))
    if present and not overwrite:
        raise UserError(
            f"{path} already contains a run ({', '.join(present)}); choose another --out or add --overwrite"
        )
    return present


def next_recordings(path: Path) -> list[str]:
    """Return the names of the later files of a split recording in the directory of a run, in order."""
    try:
        names = [entry.name for entry in path.iterdir() if _NEXT_RECORDING.fullmatch(entry.name)]
    except OSError:
        return []
    return sorted(names, key=lambda name: (len(name), name))


def create(path: Path, overwrite: bool, vessels: Sequence[str] = ()) -> Path:
    """Create `path`, and delete an earlier run in it when `overwrite` is True.

    vessels: names of the folders to create in it.
    """
    present = check_free(path, overwrite, vessels)
    try:
        path.mkdir(parents=True, exist_ok=True)
        for name in present:
            if (path / name).is_dir():
                shutil.rmtree(path / name)
            else:
                (path / name).unlink()
        for name in vessels:
            (path / name).mkdir()
    except OSError as error:
        raise UserError(f"{_shown(path)} cannot be created ({error.strerror}); choose another --out") from error
    return path


def _is_of_a_vessel(folder: Path) -> bool:
    """Whether the folder holds only files that a vessel of a run leaves."""
    try:
        return {entry.name for entry in folder.iterdir()} <= set(_OF_A_VESSEL)
    except OSError:
        return False


def write_profile(path: Path, text: str) -> None:
    """Write the resolved profile. Raises UserError when there is no space for it."""
    try:
        (path / PROFILE).write_text(text, encoding="utf-8")
    except OSError as error:
        raise _no_room(path, error) from error


def reserve(path: Path) -> IO[bytes]:
    """Reserve space for the summary, in case the disk fills up.

    Closing the file frees it. Raises UserError when there is none.
    """
    try:
        reserve = TemporaryFile(dir=path, buffering=0)  # noqa: SIM115  the caller closes it
        reserve.write(bytes(RESERVED_BYTES))
    except OSError as error:
        raise _no_room(path, error) from error
    return reserve


def _no_room(path: Path, error: OSError) -> UserError:
    return UserError(f"{path} has no space for a run ({error.strerror}); free space, or choose another --out")


def keep_dataflash(path: Path) -> None:
    """Rename the newest DataFlash log in the directory, which the agent numbered."""
    (path / "LASTLOG.TXT").unlink(missing_ok=True)
    logs = [log for log in path.iterdir() if log.suffix.lower() == ".bin" and log.stem.isdigit()]
    if logs:
        max(logs, key=lambda log: (log.stat().st_mtime_ns, log.name)).replace(path / DATAFLASH)


def default_path(profile: str, started: datetime | None = None) -> Path:
    """Return `runs/<profile>-<UTC time>`, with a number appended when that path exists."""
    stamp = (started or datetime.now(UTC)).strftime("%Y%m%dT%H%M%SZ")
    base = Path("runs") / f"{Path(profile).name}-{stamp}"
    path, number = base, 1
    while _exists(path):
        number += 1
        path = base.with_name(f"{base.name}-{number}")
    return path


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file whole or not at all. Raises UserError when there is no space for it."""
    write_whole(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_whole(path: Path, text: str) -> None:
    """Write a text file whole or not at all. Raises UserError when there is no space for it."""
    temporary = path.with_suffix(".tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        raise UserError(f"{path} cannot be written ({error.strerror}); free space, or choose another --out") from error
