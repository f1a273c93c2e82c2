"""An analysis that broke: the user still gets what the others found, and this said."""

from __future__ import annotations

import traceback
from dataclasses import dataclass
from pathlib import Path

_PACKAGE = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True)
class Failure:
    """An analysis that broke: a fault of this program, not of the log. place: file and line of the program."""

    analysis: str
    error: str
    place: str

    @property
    def sentence(self) -> str:
        return f"the analysis of {self.analysis} failed at {self.place} ({self.error}); please report it with this log"


def failure(analysis: str, error: Exception) -> Failure:
    """With the last place of this program that the error went through."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if Path(frame.filename).is_relative_to(_PACKAGE)]
    last = (ours or frames)[-1]
    path = Path(last.filename)
    place = path.relative_to(_PACKAGE.parent) if path.is_relative_to(_PACKAGE) else path
    return Failure(analysis, f"{type(error).__name__}: {error}", f"{place}:{last.lineno}")
