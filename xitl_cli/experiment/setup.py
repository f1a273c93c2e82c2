"""How an experiment is to be carried out, and the runs that it makes of profiles of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.experiment.report import ExperimentReport
from xitl_cli.profile import load_profile
from xitl_cli.run.session import INTERRUPTED, Result, run
from xitl_cli.run.status_display import NoDisplay


class InterruptedRunError(Exception):
    """Somebody wants to stop. done: what can be said of the runs until then, None for nothing."""

    def __init__(self, done: ExperimentReport | None = None) -> None:
        super().__init__()
        self.done = done


@dataclass(frozen=True, slots=True)
class ExperimentSetup:
    """out: the directory of its runs. duration_s: of each run at most, None for what the experiment takes.

    firmware: an ardurover to start, None for the one that is found. real: a log of a real boat (4.1), from_s and
    until_s: what of it, in seconds of its own clock. vehicle: a profile, what the recorded outputs drive. board: the
    URL of an agent on a board (4.3). tell: called with a line on what goes on.
    """

    out: Path
    seed: int = 1
    duration_s: float | None = None
    overwrite: bool = False
    firmware: str | None = None
    real: Path | None = None
    from_s: float | None = None
    until_s: float | None = None
    vehicle: str = "vehicles/asv-third"
    board: str | None = None
    tell: Callable[[str], None] = lambda line: None

    def run_profile(
        self, name: str, text: str, overrides: Mapping[str, Any] | None = None, timed: bool = False
    ) -> Result:
        """A run of this profile in `out`/`name`, the profile beside it.

        timed: reaching its duration is what is wanted. Raises UserError where it cannot be made, InterruptedRunError.
        """
        profile = write_profile(self.out / f"{name}.yaml", text, self.overwrite)
        given = [f"{key}={value}" for key, value in (overrides or {}).items() if value is not None]
        result = run(load_profile(str(profile), given), self.out / name, self.overwrite, NoDisplay, timed)
        if result.exit_code == INTERRUPTED:
            raise InterruptedRunError
        return result


def default_directory(section: str = "") -> Path:
    """Where runs of a section go when nobody says: runs/paper-<section>-<time>."""
    return Path("runs") / "-".join(filter(None, ("paper", section, datetime.now(UTC).strftime("%Y%m%d-%H%M%S"))))


def write_profile(path: Path, text: str, overwrite: bool) -> Path:
    """`path`. Raises UserError where another profile is there, or nothing can be written."""
    try:
        if not overwrite and path.exists() and path.read_text(encoding="utf-8") != text:
            raise UserError(f"{path}: exists, and is another profile; choose another --out or add --overwrite")
    except OSError as error:
        raise _unwritable(path, error) from error
    return write_file(path, text)


def write_file(path: Path, data: str | bytes) -> Path:
    """`path`, replaced where it is there. Raises UserError where it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    except OSError as error:
        raise _unwritable(path, error) from error
    return path


def _unwritable(path: Path, error: OSError) -> UserError:
    return UserError(f"{path}: cannot be written ({error.strerror}); choose another --out")
