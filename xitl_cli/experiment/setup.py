"""Setup of an experiment, and the runs of its profiles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.experiment.report import ExperimentReport
from xitl_cli.profile import load_profile
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.session import INTERRUPTED, Result, run


class InterruptedRunError(Exception):
    """The user asked to stop. done: results of the runs so far, None without any."""

    def __init__(self, done: ExperimentReport | None = None) -> None:
        super().__init__()
        self.done = done


@dataclass(frozen=True, slots=True)
class ExperimentSetup:
    """Settings of an experiment."""

    out: Path
    """Directory of its runs."""
    seed: int = 1
    duration_s: float | None = None
    """Limit for each run; None for the experiment's duration."""
    overwrite: bool = False
    firmware: str | None = None
    """Path of an ardurover to start; None to search for one."""
    real: Path | None = None
    """Log of a real boat (4.1)."""
    from_s: float | None = None
    """Start of the used part of `real`, in seconds of its clock."""
    until_s: float | None = None
    """End of the used part of `real`, in seconds of its clock."""
    vehicle: str = "vehicles/asv-third"
    """Profile that the recorded outputs drive."""
    board: str | None = None
    """URL of an agent on a board (4.3)."""
    tell: Callable[[str], None] = lambda line: None
    """Called with a line on the progress."""

    def run_profile(
        self, name: str, text: str, overrides: Mapping[str, Any] | None = None, timed: bool = False
    ) -> Result:
        """Run this profile in `out`/`name`, and write the profile next to it.

        timed: a run that reaches its duration has done what was asked. Raises UserError when the run is not possible,
        and InterruptedRunError.
        """
        profile = write_profile(self.out / f"{name}.yaml", text, self.overwrite)
        given = [f"{key}={value}" for key, value in (overrides or {}).items() if value is not None]
        result = run(load_profile(str(profile), given), self.out / name, self.overwrite, NoDisplay, timed)
        if result.exit_code == INTERRUPTED:
            raise InterruptedRunError
        return result


def default_directory(section: str = "") -> Path:
    """Return the default directory for the runs of a section: runs/paper-<section>-<time>."""
    return Path("runs") / "-".join(filter(None, ("paper", section, datetime.now(UTC).strftime("%Y%m%d-%H%M%S"))))


def write_profile(path: Path, text: str, overwrite: bool) -> Path:
    """Write the profile and return `path`. Raises UserError for another profile there, or when it cannot be written."""
    try:
        if not overwrite and path.exists() and path.read_text(encoding="utf-8") != text:
            raise UserError(f"{path}: exists, and is another profile; choose another --out or add --overwrite")
    except OSError as error:
        raise _unwritable(path, error) from error
    return write_file(path, text)


def write_file(path: Path, data: str | bytes) -> Path:
    """Write the file, replace an earlier one, and return `path`. Raises UserError when it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    except OSError as error:
        raise _unwritable(path, error) from error
    return path


def _unwritable(path: Path, error: OSError) -> UserError:
    return UserError(f"{path}: cannot be written ({error.strerror}); choose another --out")
