"""Log formats of other packages, which register them in the entry-point group `xitl.log_formats`.

`xitl_cli.logs` imports nothing else of xitl, so it reads this group by itself instead of asking the registry.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log

GROUP = "xitl.log_formats"


@dataclass(frozen=True, slots=True)
class LogFormat:
    """A log format of a package. `xitl.open_log` asks for it when no format of xitl recognises a file."""

    recognises: Callable[[bytes], bool]
    """Returns whether a file is of this format, from its first 64 KiB."""

    open: Callable[[Path], Log]
    """Opens the file. Raises LogError for a file that cannot be read."""


def open_added(path: Path, head: bytes) -> Log | None:
    """Open a log with the first format that recognises it, in the order of the names; None when none does.

    A format that cannot be loaded is left out; `xitl plugins` shows its error. Raises LogError, with the name of the
    format, when it fails to open the file.
    """
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        recognised: LogFormat | None = None
        with suppress(Exception):
            added = entry.load()
            recognised = added if added.recognises(head) else None
        if recognised is None:
            continue
        try:
            return recognised.open(path)
        except (LogError, OSError):
            raise
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise LogError(f"{path}: the log format {entry.name} failed to open it ({reason}); correct it") from error
    return None
