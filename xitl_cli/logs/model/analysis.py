"""An analysis of one log, as plug-ins register it, and the record of an analysis that failed."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Section

_PACKAGE = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True)
class LogAnalysis:
    """An analysis: a function from a log to one section of the report."""

    name: str
    """Name of its section."""
    analyse: Callable[[Log], Section | None]
    """None if the log cannot answer its question."""
    package: str = ""
    """Package that adds it, with its version; empty for an analysis of xitl."""

    def section(self, log: Log) -> Section | None:
        section = self.analyse(log)
        if section is None or self.package or log.format != "ulog":
            return section
        # The lacks of xitl's analyses name messages of ArduPilot, which say nothing about a log of PX4.
        if section.facts or section.findings or section.grids or section.plots:
            return replace(section, lacks=())
        return None


@dataclass(frozen=True, slots=True)
class AnalysisFailure:
    """An analysis that failed: an error of this program, not of the log."""

    analysis: str
    error: str
    place: str
    """File and line of the program."""
    package: str = ""
    """Package that adds the analysis, empty for an analysis of xitl."""

    @property
    def sentence(self) -> str:
        whose, report = (f" by {self.package}", " to its authors") if self.package else ("", "")
        failed = f"the analysis of {self.analysis}{whose} failed at {self.place} ({self.error})"
        return f"{failed}; please report it{report} with this log"


def analysis_failure(analysis: str, error: Exception, package: str = "") -> AnalysisFailure:
    """Record of a failure, with the last line of this program, or of the package, that the error passed through."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [] if package else [frame for frame in frames if Path(frame.filename).is_relative_to(_PACKAGE)]
    last = (ours or frames)[-1]
    path = Path(last.filename)
    place = path.relative_to(_PACKAGE.parent) if path.is_relative_to(_PACKAGE) else path
    return AnalysisFailure(analysis, f"{type(error).__name__}: {error}", f"{place}:{last.lineno}", package)
