"""Catalogue of the analyses of one log, in the order of the report, and the record of an analysis that failed."""

from __future__ import annotations

import importlib
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Section

Analysis = Callable[[Log], Section | None]

NAMES = (
    "vehicle",
    "px4",
    "modes",
    "arming",
    "events",
    "missions",
    "attitude",
    "control",
    "parameters",
    "real_time",
    "scheduler",
    "tasks",
    "time_bases",
    "links",
    "faults",
    "estimator",
    "sensors",
    "gnss",
    "vibration",
    "radio",
    "power",
    "actuation",
)
"""Modules of this package, each with a function `analyse`."""


def load_analysis(name: str) -> Analysis:
    analyse: Analysis = importlib.import_module(f"xitl_cli.logs.analyses.{name}").analyse

    def analysed(log: Log) -> Section | None:
        found = analyse(log)
        return found if found is None or log.format != "ulog" else _of_px4(found)

    return analysed


def _of_px4(found: Section) -> Section | None:
    """The section without its lacks, which name ArduPilot's messages; None if nothing else is left."""
    told = found.facts or found.findings or found.grids or found.plots
    return replace(found, lacks=()) if told else None


def sections(log: Log) -> list[Section]:
    return [found for name in NAMES if (found := load_analysis(name)(log)) is not None]


_PACKAGE = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True)
class AddedAnalysis:
    """An analysis that another package adds. name: of its section. package: with its version."""

    name: str
    package: str
    analyse: Analysis


@dataclass(frozen=True, slots=True)
class AnalysisFailure:
    """An analysis that failed: an error of this program, not of the log."""

    analysis: str
    error: str
    place: str
    """File and line of the program."""
    package: str = ""
    """Package of an added analysis, empty for a built-in one."""

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
