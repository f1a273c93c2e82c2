"""The directory of a run, given in place of a log: its recording, and the log of its autopilot."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

RECORDING = "run.mcap"
OWN_LOGS = ("autopilot.bin", "autopilot.ulg")
"""Logs of ArduPilot and of PX4. In a fleet, each is in the folder of its vessel."""


def recording_in(path: Path) -> Path:
    """Recording in the directory of a run; another path is returned unchanged."""
    recording = path / RECORDING
    return recording if _is_file(recording) else path


def own_log_in(path: Path, vessel: str) -> Path | None:
    """The autopilot's own log in the directory of a run; None if there is none, and for another path.

    vessel: name in a fleet; empty for a single vessel.
    """
    if not _is_file(path / RECORDING):
        return None
    return next((log for name in OWN_LOGS if _is_file(log := path / vessel / name)), None)


def logs_in(path: Path, vessel: str = "") -> Iterator[Path]:
    """The recording and the autopilots' logs in the directory of a run; another path is returned unchanged.

    vessel: only the log of this vessel; by default of all.
    """
    yield recording_in(path)
    if _is_file(path / RECORDING):
        for pattern in (vessel,) if vessel else ("", "*/"):
            for name in OWN_LOGS:
                yield from sorted(path.glob(f"{pattern}/{name}".lstrip("/")))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
