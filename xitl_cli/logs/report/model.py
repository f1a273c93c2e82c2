"""The report model: results of the analyses of some logs. It needs no file any more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xitl_cli.logs.analyses.catalogue import AnalysisFailure
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.log import Base, Format, LogHealth
from xitl_cli.logs.model.sections import Finding, Mark, Plot, Section, Severity
from xitl_cli.logs.model.table import Floats
from xitl_cli.logs.report.signal_data import HeldLog
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


@dataclass(frozen=True, slots=True)
class MapTrack:
    """A path over ground."""

    name: str
    at_s: Floats
    """(N,) on the report's time line."""
    east_m: Floats
    """(N,)"""
    north_m: Floats
    """(N,)"""
    speed_mps: Floats | None = None
    """(N,)"""


@dataclass(frozen=True, slots=True)
class MapWaypoint:
    name: str
    east_m: float
    north_m: float


@dataclass(frozen=True, slots=True)
class Overview:
    """First part of every report: track, speed, yaw, outputs and states of all files on one time line."""

    plots: tuple[Plot, ...] = ()
    """x in nanoseconds on the report's time line."""
    tracks: tuple[MapTrack, ...] = ()
    waypoints: tuple[MapWaypoint, ...] = ()
    modes: tuple[Mark, ...] = ()
    """Spans on the report's time line, of the first file that has them."""
    armed: tuple[Mark, ...] = ()
    """Spans on the report's time line, of the first file that has them."""
    origin: tuple[float, float, float] | None = None
    """Latitude (deg), longitude (deg) and altitude (m) of the map's zero; None if unknown."""
    lacks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """All analyses of one or several logs.

    files: the logs that could be opened, in the given order. refusals: the others, with the reason. signals: signals of
    each log, for the selection list of a page.
    """

    files: tuple[FileReport, ...]
    refusals: tuple[RefusedFile, ...] = ()
    overview: Overview = Overview()
    signals: tuple[HeldLog, ...] = ()

    @property
    def findings(self) -> list[FileFinding]:
        """All findings, the most severe first, then in the order of files and sections."""
        every = [
            FileFinding(finding, section, file)
            for file in self.files
            for section in file.sections
            for finding in section.findings
        ]
        return sorted(every, key=lambda each: -each.finding.severity)

    @property
    def sections(self) -> list[FileSection]:
        """Every section of every file."""
        return [FileSection(section, file) for file in self.files for section in file.sections]

    @property
    def worst(self) -> Severity:
        """Highest severity of all findings."""
        return max((section.worst for file in self.files for section in file.sections), default=Severity.OK)

    @property
    def failures(self) -> list[AnalysisFailure]:
        """Analyses that failed."""
        return [failure for file in self.files for failure in file.failures]

    def as_json(self) -> dict[str, Any]:
        """The output of `xitl logs analyze --json`: stable keys, no NaN, without plots."""
        from xitl_cli.logs.report.json import document

        return document(self)
