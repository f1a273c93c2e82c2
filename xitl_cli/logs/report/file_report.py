"""Results of one log: its sections, findings and failures. They need no file any more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.analysis import AnalysisFailure
from xitl_cli.logs.model.log import Base, Format, LogHealth
from xitl_cli.logs.model.sections import Finding, Section, Severity
from xitl_cli.logs.report.wording import damage_sentences


@dataclass(frozen=True, slots=True)
class FileReport:
    """Results of one log."""

    name: str
    """Short, and unique among the files of a report."""
    path: Path
    format: Format
    base: Base
    span_ns: tuple[int, int] | None
    """None without a stamped row."""
    health: LogHealth
    facts: Mapping[str, str]
    sections: tuple[Section, ...]
    time_line: TimeLine
    vehicle: str = ""
    """Vehicle and firmware in words; "" if unknown."""
    failures: tuple[AnalysisFailure, ...] = ()
    vessel: str = ""
    """The analysed vessel of `vessels`, if the log has several."""
    vessels: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Missing and doubtful data, each a sentence without its full stop."""
        return damage_sentences(self.health)

    @property
    def duration_s(self) -> float | None:
        return None if self.span_ns is None else (self.span_ns[1] - self.span_ns[0]) * 1e-9


@dataclass(frozen=True, slots=True)
class RefusedFile:
    """A file that could not be opened, and the reason as a sentence."""

    path: Path
    sentence: str


@dataclass(frozen=True, slots=True)
class FileSection:
    """A section and its file."""

    section: Section
    file: FileReport


@dataclass(frozen=True, slots=True)
class FileFinding:
    """A finding with its section and file."""

    finding: Finding
    section: Section
    file: FileReport


class ReportedFiles(Protocol):
    """Part of a report that the grouping of findings and the JSON document need."""

    @property
    def files(self) -> tuple[FileReport, ...]:
        """Logs that could be opened."""

    @property
    def refusals(self) -> tuple[RefusedFile, ...]:
        """Logs that could not be opened."""

    @property
    def findings(self) -> list[FileFinding]:
        """All findings, the most severe first."""

    @property
    def worst(self) -> Severity:
        """Highest severity of all findings."""
