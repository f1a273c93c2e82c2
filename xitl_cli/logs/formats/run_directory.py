"""The directory of a run, given in place of a log: its recording, and the log of its autopilot."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

RECORDING = "run.mcap"
OWN_LOG = "autopilot.bin"
"""Of a fleet it is in the folder of its vessel."""


def recording_in(path: Path) -> Path:
    """The recording in the directory of a run; another path as it is."""
    recording = path / RECORDING
    return recording if _is_file(recording) else path


def own_log_in(path: Path, vessel: str) -> Path | None:
    """The autopilot's own log in the directory of a run; None without one, and for another path.

    vessel: of a fleet, empty for a vessel alone.
    """
    log = path / vessel / OWN_LOG
    return log if _is_file(path / RECORDING) and _is_file(log) else None


def logs_in(path: Path, vessel: str = "") -> Iterator[Path]:
    """The recording and the autopilots' logs in the directory of a run; another path as it is.

    vessel: only the log of this one; of all by default.
    """
    yield recording_in(path)
    if _is_file(path / RECORDING):
        patterns = [f"{vessel}/{OWN_LOG}"] if vessel else [OWN_LOG, f"*/{OWN_LOG}"]
        for pattern in patterns:
            yield from sorted(path.glob(pattern))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
